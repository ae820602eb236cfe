"""What has changed between two sets of recordings: `uv run python benchmarks/changes.py --json changes.json`.

    uv run python benchmarks/changes.py --robots 1 --no-plain     # five cases, with --before only
    uv run python benchmarks/changes.py --real FOLDER             # halves of real recordings: nothing has changed

A robot is an arm of `field_robots` with the physics of `field_physics` and a wide calibration: masses 5 %, gains 4 %,
damping from nothing to twice of what is believed, zeros 4 mrad. It is recorded before, and then after each of
five changes: more dry friction, a payload, a weaker motor, more damping, and none. Motions, noise, and when commands
act within a sample are new each time. The right answer names the change alone, at its place, with a size within 20 %.
Beside it stands what the diagnosis of the later recordings alone says. Answers are kept under the digest of the code.
"""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
import tyro
from field_gate import judged_parts, same_kind_and_place
from gap_scores import parameter_error
from hidden_cases.field_cases import Logging, UsualSizes, log_rows, usual_sizes
from hidden_cases.field_physics import SETTLE, Calibration, Controlled, build, move
from hidden_cases.field_robots import ROBOTS, FieldRobot
from naming_gate import CODE

from btr_mjx.errors import cli_errors
from btr_mjx.gap.data import Dataset, open_dataset
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces import Carried, carried_of, prepare_forces, search_forces
from btr_mjx.gap.results import as_result
from btr_mjx.gap.simulate import Counter
from btr_mjx.runs import note, read_json, write_json

CHANGES = ("dry_friction", "payload", "actuator_gain", "viscous_damping", "nothing")
RUNS, DURATION = 3, 4.0
"""Recordings of a set, and their length [s]."""
MOST_JOINTS = 4
"""Joints of the arms; more take longer."""
CLOSE = 0.2
"""Relative error of a size that is right."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    robots: int = 4
    """Number of robots, each with five cases."""
    seed: int = 1
    """Seed of the robots."""
    plain: bool = True
    """Also diagnose the later recordings alone."""
    real: Path | None = None
    """A dataset folder: cut each recording in halves by time, and compare the second halves with the first ones."""
    out: Path = Path("runs/changes")
    """Folder of the cases and of the answers of all versions."""
    json: Path | None = None
    """Write the rows of all cases here."""


def wide_calibration(rng: np.random.Generator, model: mujoco.MjModel) -> Calibration:
    """A robot that nobody has calibrated: masses 5 %, gains 4 %, damping 0 to 200 %, zeros 4 mrad."""
    return Calibration(
        rng.uniform(0, 2, model.nv),
        1 + 0.04 * rng.standard_normal(model.nactuator).clip(-2, 2),
        1 + 0.05 * rng.standard_normal(model.nbody).clip(-2, 2),
        4e-3 * rng.standard_normal(model.nv).clip(-2, 2),
    )


def change_of(rng: np.random.Generator, model: mujoco.MjModel, usual: UsualSizes, kind: str) -> list[dict[str, Any]]:
    """The change: 0.08 N m, 60 g, -5 %, 0.12 N m s/rad; at a joint that moves with less, as a part of what is usual."""
    if kind == "nothing":
        return []
    a = int(rng.integers(model.nactuator))
    dof = int(model.jnt_dofadr[model.actuator_trnid[a, 0]])
    torque, speed = usual.torque[dof], usual.speed[dof]
    if kind == "payload":
        body = model.nbody - 1
        geom = int(model.body_geomadr[body])
        place = dict(zip("xyz", (1.7 * model.geom_pos[geom]).tolist(), strict=True))
        return [{"effect": kind, "location": f"body:{model.body(body).name}", "parameters": {"mass": 0.06, **place}}]
    if kind == "actuator_gain":
        return [{"effect": kind, "location": f"actuator:{model.actuator(a).name}", "parameters": {"change": -0.05}}]
    size = min(0.08, 0.2 * torque) if kind == "dry_friction" else min(0.12, 0.3 * torque / speed)
    parameter = "torque" if kind == "dry_friction" else "damping"
    joint = model.joint(int(model.actuator_trnid[a, 0])).name
    return [{"effect": kind, "location": f"joint:{joint}", "parameters": {parameter: float(size)}}]


def record(folder: Path, rng: np.random.Generator, robot: FieldRobot, calibration: Calibration, hidden: Any) -> None:
    """Write the folder of a set of recordings."""
    model, interval = mujoco.MjModel.from_xml_string(robot.xml), 1 / float(rng.choice((100, 125)))
    calibration = replace(calibration, shift=float(rng.uniform(0, 0.5 * interval)))
    log = Logging(interval, (), bool(rng.random() < 0.5), 0.0, 0, robot.noise)
    times = np.arange(-round(SETTLE / robot.step), round(DURATION / robot.step)) * robot.step
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(robot.xml)
    for k in range(RUNS):
        motion = move(build(robot, calibration, hidden), Controlled(robot, robot.reference(rng)(times)))
        (folder / f"run{k + 1}.csv").write_text(log_rows(rng, robot, model, motion, log))


def make_robot(folder: Path, seed: int) -> None:
    """Write the folders of a robot, before and after each change, and truth.json."""
    rng = np.random.default_rng([seed, 7])
    robot = ROBOTS["arm"](rng)
    while (model := mujoco.MjModel.from_xml_string(robot.xml)).nv > MOST_JOINTS:
        robot = ROBOTS["arm"](rng)
    calibration = wide_calibration(rng, model)
    times = np.arange(-round(SETTLE / robot.step), round(DURATION / robot.step)) * robot.step
    usual = usual_sizes(model, move(build(robot, calibration), Controlled(robot, robot.reference(rng)(times))))
    record(folder / "before", rng, robot, calibration, ())
    truth = {}
    for kind in CHANGES:
        truth[kind] = change_of(rng, model, usual, kind)
        record(folder / kind, rng, robot, calibration, truth[kind])
    write_json(folder / "truth.json", truth)


def searched(dataset: Dataset, known: Carried | None = None) -> tuple[dict[str, Any], Carried]:
    """Part of result.json, and what a set says of the robot."""
    begun = time.process_time()
    prepared = prepare_forces(dataset)
    assert prepared is not None
    diagnosis, found = search_forces(prepared, EFFECTS, 5, lambda _: None, Counter(), known)
    result = as_result(diagnosis, dataset)
    keys = ("verdict", "effects", "equivalent", "unexplained", "calibration")
    carried = carried_of(found)
    return {key: result[key] for key in keys} | {"cpu_seconds": time.process_time() - begun}, carried


def judge(model: mujoco.MjModel, hidden: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Whether an answer names what is hidden and nothing else, with its size, and alone."""
    parts = [part for one in answer["effects"] for part in judged_parts(one)]
    true = [part for part in parts if any(same_kind_and_place(model, h, part) for h in hidden)]
    errors = [abs(parameter_error(h, p)) for h in hidden for p in true if same_kind_and_place(model, h, p)]
    named = len(true) == len(hidden) and answer["verdict"] != "unexplained"
    return {
        "said": answer["verdict"],
        "named": [f"{p['effect']}@{p['location']} {_numbers(p)}" for p in parts],
        "false": len(parts) - len(true) + (answer["verdict"] == "unexplained"),
        "error": errors[0] if errors else None,
        "right": named and len(parts) == len(true) and all(error < CLOSE for error in errors),
        "ambiguous": len(answer["equivalent"]) > 1,
        "cpu_seconds": answer["cpu_seconds"],
    }


def _numbers(effect: Mapping[str, Any]) -> str:
    return ", ".join(f"{p['value']:.4g} [{p['low']:.4g}, {p['high']:.4g}]" for p in effect["parameters"].values())


def cases_of(config: Config, index: int) -> list[dict[str, Any]]:
    """Rows of the cases of a robot, each with the answer beside the earlier recordings and without them."""
    folder = config.out / f"robot-{config.seed}-{index:02d}"
    kept = config.out / "answers" / CODE / f"{folder.name}.json"
    if not (folder / "truth.json").is_file():
        make_robot(folder, int(np.random.SeedSequence([config.seed, index]).generate_state(1)[0]))
    answers = read_json(kept) if kept.is_file() else {}
    truth, known = read_json(folder / "truth.json"), None
    model = mujoco.MjModel.from_xml_path(str(folder / "before/model.xml"))
    rows = []
    for kind in CHANGES:
        if kind not in answers:
            if known is None:
                answers["before"], known = searched(open_dataset(folder / "before"))
            answers[kind] = searched(open_dataset(folder / kind), known)[0]
            write_json(kept, answers)
        if config.plain and f"{kind} alone" not in answers:
            answers[f"{kind} alone"] = searched(open_dataset(folder / kind))[0]
            write_json(kept, answers)
        row = {"robot": index, "hidden": truth[kind], **judge(model, truth[kind], answers[kind])}
        if config.plain:
            row["alone"] = judge(model, truth[kind], answers[f"{kind} alone"])
        note(_line(row))
        rows.append(row)
    return rows


def _line(row: Mapping[str, Any]) -> str:
    hidden = [f"{e['effect']}@{e['location']} {next(iter(e['parameters'].values())):.4g}" for e in row["hidden"]]
    alone = f"; alone: {_answer(row['alone'])}" if "alone" in row else ""
    return f"robot {row['robot']}, {' + '.join(hidden) or 'nothing'}: {_answer(row)}{alone}"


def _answer(row: Mapping[str, Any]) -> str:
    mark = "right" if row["right"] and not row["ambiguous"] else "right, ambiguous" if row["right"] else "WRONG"
    return f"{mark} ({row['said']}: {' + '.join(row['named']) or 'nothing'})"


def halves(folder: Path) -> tuple[Dataset, Dataset]:
    """A dataset with the first half of each recording, and one with the second halves."""
    whole = open_dataset(folder)

    def part(first: float, last: float) -> Dataset:
        parts = []
        for r in whole.recordings:
            rows = slice(int(first * len(r.time)), int(last * len(r.time)))
            cut = {name: getattr(r, name)[rows] for name in ("time", "ctrl", "qpos", "qvel")}
            parts.append(replace(r, force={}, sensor={}, **cut))
        return replace(whole, recordings=tuple(parts))

    return part(0, 0.5), part(0.5, 1)


def real(folder: Path) -> None:
    """Print what has changed between the halves of real recordings, either way."""
    first, second = halves(folder)
    for before, after in ((first, second), (second, first)):
        said, known = searched(before)
        found, _ = searched(after, known)
        for which, answer in (("before", said), ("change", found)):
            each = [f"{e['effect']}@{e['location']} {_numbers(e)}" for e in answer["effects"]]
            note(f"{folder.name} {which}: {answer['verdict']} {'; '.join(each)} {' '.join(answer['unexplained'])}")


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the counts."""
    for name, own in (("with --before", rows), ("later recordings alone", [r["alone"] for r in rows if "alone" in r])):
        if own:
            sizes = [row["error"] for row in own if row["error"] is not None] or [np.nan]
            seconds = np.median([row["cpu_seconds"] for row in own])
            print(
                f"{name:24}{sum(r['right'] for r in own)} of {len(own)} right, {sum(r['ambiguous'] for r in own)} "
                f"ambiguous, {sum(bool(r['false']) for r in own)} with something false; median error of sizes "
                f"{100 * np.median(sizes):.1f} %; {seconds:.0f} CPU-s"
            )


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    mujoco.set_mju_user_warning(lambda _: None)
    with cli_errors():
        if config.real is not None:
            real(config.real)
            return
        rows = [row for index in range(config.robots) for row in cases_of(config, index)]
        if config.json is not None:
            write_json(config.json, {"code": CODE, "rows": rows})
        show(rows)


if __name__ == "__main__":
    main()
