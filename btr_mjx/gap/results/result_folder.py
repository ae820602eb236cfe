"""The files of a diagnosis: result.json, tables, arrays and the mended model. The page is drawn from them alone."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, driven_joint
from btr_mjx.gap.effects import KNOWN_EFFECTS, Effect
from btr_mjx.gap.results.diagnosis import Diagnosis
from btr_mjx.gap.results.drawn import force_arrays, map_arrays, overlay_arrays, place_of_disagreement
from btr_mjx.gap.results.exported import export_diagnosis
from btr_mjx.gap.results.mended_model import MendedModel, acts_through_actuators, mend, with_residual
from btr_mjx.gap.results.records import FoundEffect, NamedEffect
from btr_mjx.gap.results.tables import NextExperiment, name_entry, write_command, write_tables
from btr_mjx.gap.results.words.details import detail_sentences
from btr_mjx.gap.results.words.mended import FINER_STEP, MENDED_FILE, header_comment
from btr_mjx.gap.results.words.verdict import verdict_sentence
from btr_mjx.models import parse_path, part_names
from btr_mjx.runs import write_arrays, write_json, write_text

RESULT = "result.json"
"""File name of the result for scripts."""

_WINDOWS = ("fit", "held_out", "samples", "length")
"""Keys of `Diagnosis.windows` in it."""


def save_diagnosis(
    diagnosis: Diagnosis,
    dataset: Dataset,
    folder: str | Path,
    *,
    effects: Sequence[Effect] = KNOWN_EFFECTS,
    next_experiment: NextExperiment | None = None,
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write a diagnosis.

    Args:
      diagnosis: the outcome of the search.
      dataset: the dataset that was searched.
      folder: folder for result.json, ranking.csv, disagreement.csv, disagreement.npz, overlays.npz, believed.csv;
        where the robot touches nothing, joint_forces.npz; where a model predicts better than the believed one,
        mended.xml, whose first line says what it is, mended.json, parameters.csv, parameters.json and
        randomisation.json.
      effects: the library that was searched.
      next_experiment: proposal for next_command.csv; None if there is none.
      more: further entries of result.json.

    Returns:
      Content of result.json.

    Raises:
      OSError: the folder cannot be written to.
    """
    folder = Path(folder)
    result = as_result(diagnosis, dataset) | {"next_experiment": None} | dict(more or {})
    if next_experiment is not None:
        result["next_experiment"] = write_command(next_experiment, dataset.model, folder)

    def mended(found: Sequence[FoundEffect]) -> MendedModel:
        return _mend(found, diagnosis, dataset, effects)

    if result["mended"]:
        whole = with_residual(mended([effect.found() for effect in diagnosis.found]), diagnosis.residual)
        write_text(folder / MENDED_FILE, header_comment(result) + whole.xml)
        write_json(folder / "mended.json", whole.as_json())
    result["sentence"], result["details"] = verdict_sentence(result), detail_sentences(result)
    write_tables(result, diagnosis.disagreement, folder)
    if diagnosis.disagreement is not None:
        write_arrays(folder / "disagreement.npz", map_arrays(diagnosis.disagreement))
    write_arrays(folder / "overlays.npz", overlay_arrays(diagnosis.overlays, dataset.model))
    if diagnosis.joint_forces:
        write_arrays(folder / "joint_forces.npz", force_arrays(diagnosis.joint_forces))
    export_diagnosis(diagnosis, dataset, folder, mended)
    write_json(folder / RESULT, result)
    return result


def _position_unit(model: mujoco.MjModel) -> str:
    """Unit of a mean over the positions of all degrees of freedom."""
    kinds = set(model.jnt_type.tolist())
    turns = kinds - {int(mujoco.mjtJoint.mjJNT_SLIDE)}
    shifts = kinds & {int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_FREE)}
    return " and ".join((["rad"] if turns else []) + (["m"] if shifts else []))


def as_result(diagnosis: Diagnosis, dataset: Dataset) -> dict[str, Any]:
    """Entries of result.json.

    Args:
      diagnosis: the outcome of the search.
      dataset: the dataset that was searched.

    Returns:
      Entries for JSON, in SI units with angles in rad.
    """
    close = set(diagnosis.equivalent)
    ranking = [
        asdict(row) | {"equivalent": f"{row.effect}@{row.location}" in close and not row.beside}
        for row in diagnosis.ranking
    ]
    misfit, open_loop = diagnosis.misfit, diagnosis.open_loop
    kind = diagnosis.mended_kind or (FINER_STEP if dataset.coarse_step is not None else None)
    return {
        "verdict": diagnosis.verdict,
        "dataset": dataset.folder.name or str(dataset.folder),
        "interpolation": {one.name: one.interpolation for one in dataset.recordings},
        "timestep": {"model": dataset.coarse_step or dataset.model.opt.timestep, "search": dataset.model.opt.timestep},
        "where": place_of_disagreement(diagnosis.disagreement) if diagnosis.disagreement else "",
        "effects": [_named_entry(effect, dataset.model) for effect in diagnosis.effects],
        "unnamed": [_named_entry(effect, dataset.model) for effect in diagnosis.unnamed],
        "calibration": [_effect_entry(effect) for effect in diagnosis.calibration],
        "ranking": ranking,
        "equivalent": [name_entry(name) for name in diagnosis.equivalent],
        "mended": {"file": MENDED_FILE, "kind": kind} if kind else None,
        "misfit": misfit and asdict(misfit) | {"noise_reached": misfit.noise_reached, "explained": misfit.explained},
        "joint_errors": [asdict(error) | {"floor": error.floor} for error in diagnosis.joint_errors],
        "open_loop": open_loop and asdict(open_loop) | {"unit": _position_unit(dataset.model)},
        "chi2": diagnosis.chi2 and asdict(diagnosis.chi2),
        "unexplained": list(diagnosis.unexplained) if diagnosis.verdict == "unexplained" else [],
        "residual": [table.joint for table in diagnosis.residual],
        "believed": [asdict(refit) for refit in diagnosis.believed],
        "confounds": [asdict(confound) for confound in diagnosis.confounds],
        "share": diagnosis.share,
        "lack_of_fit": diagnosis.lack_of_fit and dict(zip(("before", "after"), diagnosis.lack_of_fit, strict=True)),
        "threshold": diagnosis.threshold,
        "dispersion": diagnosis.dispersion,
        "noise": diagnosis.sigma,
        "windows": diagnosis.windows and dict(zip(_WINDOWS, diagnosis.windows, strict=True)),
        "steps": diagnosis.steps,
        "seconds": diagnosis.seconds,
        "notes": [*dataset.notes, *diagnosis.notes],
    }


def _driven_joint(model: mujoco.MjModel, location: str) -> str:
    """Name of the joint that the actuator of a place drives; "" for other places."""
    kind, _, name = location.partition(":")
    actuators = part_names(model, "actuator")
    if kind != "actuator" or name not in actuators:
        return ""
    joint = driven_joint(model, actuators.index(name))
    return "" if joint is None else part_names(model, "joint")[joint]


def before_entry(diagnosis: Diagnosis, dataset: Dataset, before: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What a diagnosis of earlier recordings said, for result.json.

    Args:
      diagnosis: of the earlier recordings.
      dataset: the earlier recordings.
      before: the entry of the recordings before those, if what they say is a change.
    """
    result = as_result(diagnosis, dataset) | {"before": before}
    keys = ("dataset", "verdict", "effects", "calibration", "believed", "unexplained", "equivalent", "notes")
    return {key: result[key] for key in keys} | {
        "sentence": verdict_sentence(result),
        "recordings": len(dataset.recordings),
    }


def _named_entry(effect: NamedEffect, model: mujoco.MjModel) -> dict[str, Any]:
    """An effect of the mended model that is no calibration."""
    return (
        {key: value for key, value in asdict(effect).items() if key != "tolerances" and (key != "latex" or value)}
        | {"equivalent": [name_entry(name) for name in effect.equivalent]}
        | {"joint": _driven_joint(model, effect.location)}
    )


def _effect_entry(effect: NamedEffect) -> dict[str, Any]:
    """An effect of calibration with its numbers."""
    numbers = {name: asdict(estimate) for name, estimate in effect.parameters.items()}
    about = {"effect": effect.effect, "location": effect.location, "parameters": numbers}
    return about | {"tolerances": effect.tolerances}


def _mend(
    found: Sequence[FoundEffect], diagnosis: Diagnosis, dataset: Dataset, effects: Sequence[Effect]
) -> MendedModel:
    """The believed model with refitted parameters, calibration and given effects; where that fails, with a note.

    Where measured forces drive the model, what was found of them is no part of the MJCF's actuators.
    """
    final = {refit.name: refit.final for refit in diagnosis.believed if refit.final != refit.believed}
    values: dict[str, float] = {}
    for parameter in dataset.parameters:
        if parameter.name in final:
            for path in parameter.paths:
                factor = parse_path(dataset.model, path).read(dataset.model) if parameter.relative else 1.0
                values[path] = final[parameter.name] * factor
    if dataset.coarse_step is not None:
        values["option/timestep"] = float(dataset.model.opt.timestep)
    is_mjcf = dataset.model_file.suffix == ".xml" and dataset.model_file.is_file()
    source = dataset.model_file if is_mjcf else dataset.spec_xml
    try:
        every = [*(effect.found() for effect in diagnosis.calibration), *found]
        other = [own for own in every if dataset.forces and acts_through_actuators(dataset.model, own, effects)]
        made = mend(source, [own for own in every if own not in other], believed=values, effects=effects)
        told = (
            f"{own.effect} at {own.location}: of the measured forces; the actuators are as believed" for own in other
        )
        return replace(made, notes=(*made.notes, *told))
    except (InputError, ValueError) as error:
        return MendedModel(dataset.spec_xml, notes=(f"the model could not be mended: {error}",))
