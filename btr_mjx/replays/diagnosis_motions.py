"""Motions of a diagnosed robot: a held-out recording, the believed model and the mended one."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, Recording, open_dataset
from btr_mjx.gap.effects import of_forces, selected_effects
from btr_mjx.gap.preflight import checked
from btr_mjx.gap.results import effect_title, found_effects, resolve_effect
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.models import difference, parse_path
from btr_mjx.replays.coevolution_motions import sampled
from btr_mjx.replays.replay_records import Replay, ReplayedMotion, frame_times, hold_last_valid
from btr_mjx.runs import check_inputs, content_digest, read_config_json, read_json


def diagnosis_replay(folder: Path, frames: int, seconds: float) -> Replay:
    """The first held-out recording beside the believed and the mended model, which get its command from its start.

    At most `seconds` of it are shown, with as many `frames`, fewer of a shorter recording. The mended model is there
    where an effect was named.

    Raises:
      InputError: a table of fitness, a dataset that is gone or changed since, effects that the library does not have.
    """
    result = read_json(folder / "result.json")
    dataset, recording, worlds = compared_worlds(folder)
    model = recording.model
    length = min(seconds, float(recording.time[-1] - recording.time[0]))
    frames = max(2, round(frames * length / seconds))
    times = np.concatenate([[0.0], frame_times(length, frames, float(model.opt.timestep))])
    measured = sampled(recording, times)
    details = ["as in the dataset"]
    if found := found_effects(result):
        first = (result["effects"] or result.get("unnamed") or result["calibration"])[0]
        details.append(f"with {effect_title(first['effect'])}" + (" and more" if len(found) > 1 else ""))
    unit = (result.get("open_loop") or {}).get("unit", "")
    drawn = _drawn_model(dataset, model)
    row = [ReplayedMotion("recording", recording.name, "", drawn, measured, measured=True)]
    for (title, world), detail in zip(worlds.items(), details, strict=True):
        qpos = open_loop_positions(world, recording, times)
        error = np.abs(difference(model, measured, qpos)).mean()
        number = f"off by {error:.2g} {unit}".rstrip() if np.isfinite(error) else "diverged"
        row.append(ReplayedMotion(title, detail, number, drawn, hold_last_valid(qpos)))
    return Replay(times, [row])


def compared_worlds(folder: Path) -> tuple[Dataset, Recording, dict[str, World]]:
    """What a diagnosis compares: its dataset, the first held-out recording, and the worlds that follow it.

    Args:
      folder: the run folder of a diagnosis that has ended.

    Returns:
      The dataset, the recording, and the worlds by title: "believed model" and, where there is one, "mended
      model".

    Raises:
      InputError: see `diagnosis_replay`.
    """
    config, result = read_config_json(folder), read_json(folder / "result.json")
    if config.get("signal", "trajectory") != "trajectory":
        raise InputError(f"{folder}: a table of fitness was diagnosed, which holds no motion that could be shown")
    used = [Path(path) for path in ((config["dataset"], *(config.get("logs") or ())) if not config.get("demo") else ())]
    if gone := [str(path) for path in used if not path.exists()]:
        raise InputError(
            f"{folder}: {', '.join(gone)} is not there any more, which this diagnosis read and a replay draws; put it "
            "back, or start the command in the folder in which it was started first"
        )
    dataset = open_dataset(
        folder / "demo" if config.get("demo") else Path(config["dataset"]), logs=config.get("logs") or ()
    )
    assert isinstance(dataset, Dataset)
    dataset, _ = checked(dataset)
    if not config.get("demo"):
        check_inputs(folder, {"the dataset": content_digest(dataset)})
    recording = (dataset.test or dataset.recordings)[0]
    worlds = {"believed model": World.of(recording.model)}
    if found_effects(result):
        worlds["mended model"] = _mended_world(dataset, recording, result, config.get("effects", ("all",)))
    return dataset, recording, worlds


def open_loop_positions(world: World, recording: Recording, times: np.ndarray) -> np.ndarray:
    """Positions (F, nq) of a world that starts as a recording and gets its command; NaN once it diverged.

    Times (F,) are after its first sample [s].
    """
    command = Command(*recording.commands, recording.interpolation)
    start = Segments(
        recording.time[:1], recording.qpos[:1], recording.qvel[:1], times[None], (command,), np.array([0])
    )  # fmt: skip
    return simulate([(world, start)])[0][0, :, : recording.model.nq]


def _drawn_model(dataset: Dataset, model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with the surfaces of its meshes, which a dataset leaves out of large models."""
    if model is not dataset.model or not model.nmesh:
        return model
    return mujoco.MjModel.from_xml_path(str(dataset.model_file))


def _mended_world(dataset: Dataset, recording: Recording, result: Mapping[str, Any], names: Sequence[str]) -> World:
    """The world of a recording's model with refitted parameters and the named effects."""
    model = copy.copy(recording.model)
    final = {row["name"]: float(row["final"]) for row in result.get("believed") or []}
    for parameter in dataset.parameters:
        if parameter.name in final:
            for path in parameter.paths:
                part = parse_path(model, path)
                factor = part.read(model) if parameter.relative else 1.0
                part.write(model, final[parameter.name] * factor)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    world = World.of(model)
    for found in found_effects(result):
        effect, place, numbers = resolve_effect(
            recording.model, found, sum(of_forces(selected_effects(tuple(names))), ())
        )
        effect.apply(world, place, numbers)
    return world
