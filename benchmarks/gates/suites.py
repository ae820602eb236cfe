"""The table of suites: how their cases are made, solved and judged.

A case of `hidden_cases.cases` counts as detectable where its truth is visible: chi^2 of the change of motion that what
is hidden causes within 40 ms, after a fit of starting states, summed over the recordings to fit (`Truth.visible`; of a
pair, that of both together). The simulator of reality computes it; no search does. All other truths count: their sizes
are drawn as parts of what is usual in the motion.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from hidden_cases import PER_JOINT_EFFECTS, CaseSettings, Truth, case_robot, make_case
from hidden_cases.changed_arms import make_changed
from hidden_cases.field_cases import FAULTS, Wanted
from hidden_cases.field_cases import make_case as make_field_case
from hidden_cases.field_laws import LAWS
from hidden_cases.imu_walks import make_walks
from hidden_cases.torque_arms import drives, weak_or_stiff

from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.forces import identify_changes
from btr_mjx.gap.inference import identify
from btr_mjx.gap.preflight import checked, refuse_errors
from btr_mjx.gap.results import Verdict, as_result, detail_sentences, verdict_sentence
from gates.cases import Suite
from gates.forces import judge_drives, judge_law
from gates.names import judge_names, judged_parts, same_effect
from gates.rows import Row

VISIBLE = 60.0
"""`Truth.visible` (chi^2) beyond which what is hidden can be detected."""
SAME_SIZE = 0.2
"""Relative error of the size of a change that is right."""
TURN = ("arm", "torque_arm", "pendulum", "gantry", "drone")
"""Robots of the field that touch nothing, in turn."""
KEYS = (
    *("verdict", "effects", "equivalent", "calibration", "unexplained", "chi2", "misfit", "share", "lack_of_fit"),
    *("where", "interpolation", "steps"),
)
"""Entries of result.json that an answer keeps."""


def solve(folder: Path, after: str = ".", before: str = "") -> dict[str, Any]:
    """Solve a case from its folder alone, as the command `diagnose` does: checks, search and sentences.

    Args:
      folder: of the recordings.
      after: folder in it of the recordings that are searched.
      before: folder in it of earlier recordings; the answer is then what has changed since.

    Returns:
      Entries of result.json and CPU time.
    """
    begun = time.process_time()
    dataset, findings = checked(open_dataset(folder / after))
    refuse_errors(findings)
    if before:
        diagnosis = identify_changes([checked(open_dataset(folder / before))[0], dataset]).diagnoses[-1]
    else:
        diagnosis = identify(dataset)
    result = as_result(diagnosis, dataset)
    return {
        **{key: result[key] for key in KEYS},
        "ranking": result["ranking"][:8],
        "sentence": verdict_sentence(result),
        "details": detail_sentences(result),
        "findings": [f"{f.level}: {f.message}" for f in findings if f.level != "note"],
        "notes": list(dataset.notes),
        "cpu_seconds": time.process_time() - begun,
    }


def case_seed(seed: int, index: int) -> int:
    """Seed of a case."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def make_hidden(
    robot: str, folder: Path, seed: int, index: int, effects: int = 1, each: bool = False, duration: float | None = None
) -> Truth:
    """A case of `hidden_cases.cases`; a pair and what differs at each joint are always effects of the library."""
    kinds = (PER_JOINT_EFFECTS[index % len(PER_JOINT_EFFECTS)],) if each else effects
    verdict: Verdict | None = "effect" if each or effects > 1 else None
    settings = CaseSettings(verdict=verdict, effects=kinds, each=each, duration=duration)
    return make_case(folder, case_seed(seed, index), robot, settings)


def judge_hidden(_: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """By names, where the truth is visible; what is outside the library counts always."""
    detectable = truth["verdict"] != "effect" or truth["visible"] > VISIBLE
    model = case_robot(truth["robot"]).model
    return judge_names(model, truth["effects"], answer, outside=truth["outside"], detectable=detectable)


def wanted(index: int, robot: str, nulls: bool) -> tuple[str, Wanted]:
    """Robot of a field case and what it is to hold: one to three effects, or none and one or two faults, in turn."""
    turn = index if robot else index // len(TURN)
    first, second = FAULTS[index % len(FAULTS)], FAULTS[(index + 1 + turn % 5) % len(FAULTS)]
    faults = (first,) if turn % 2 == 0 else (first, second)
    return robot or TURN[index % len(TURN)], Wanted(0, faults) if nulls else Wanted(1 + turn % 3)


def make_field(folder: Path, seed: int, index: int, robot: str = "", nulls: bool = False) -> dict[str, Any]:
    """A case of `hidden_cases.field_cases`."""
    return make_field_case(folder, case_seed(seed, index), *wanted(index, robot, nulls))


def judge_field(folder: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """By names; a ripple is right as a law or as "unexplained". A delay where commands were logged late is false."""
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    ripples = [effect["location"] for effect in truth["effects"] if effect["effect"] == "ripple"]
    hidden = [effect for effect in truth["effects"] if effect["effect"] != "ripple"]
    outside = " + ".join(f"ripple@{place}" for place in ripples)
    return judge_names(model, hidden, answer, outside=outside, laws=[f"law_ripple@{place}" for place in ripples])


def make_law(robot: str, folder: Path, seed: int, index: int) -> dict[str, Any]:
    """A robot of the field that hides a law and has no faults of data; one on legs hides a ripple."""
    law = "ripple" if robot == "legged" else LAWS[index % len(LAWS)]
    return make_field_case(folder, case_seed(seed, index), robot, Wanted(1, (), law))


def judge_change(folder: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """By names, and by the first number of the change: torque, mass, strength or damping."""
    model = mujoco.MjModel.from_xml_path(str(folder / "before" / "model.xml"))
    row, errors = judge_names(model, truth["effects"], answer), list[float]()
    parts = [part for effect in answer["effects"] for part in judged_parts(effect)]
    for hidden in truth["effects"]:
        name, true = next(iter(hidden["parameters"].items()))
        errors += [abs(p["parameters"][name]["value"] / true - 1) for p in parts if same_effect(model, hidden, p)]
    return replace(row, right=row.right and max(errors, default=0.0) < SAME_SIZE)


def judge_torques(folder: Path, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> Row:
    """By names: the weak motor and the damping at its joint."""
    return judge_names(mujoco.MjModel.from_xml_path(str(folder / "arm.xml")), truth["effects"], answer)


def _walks(sensors: str, fault: str) -> partial[Any]:
    return partial(make_walks, sensors=sensors, fault=fault)


_legged, _compare = partial(make_field, robot="legged"), partial(solve, after="after", before="before")
SUITES: Mapping[str, Suite] = {
    suite.name: suite
    for suite in (
        # One effect, none, or something outside the library; a laboratory's calibration.
        Suite("hexapod", 100, 2026, partial(make_hidden, "hexapod"), solve, judge_hidden),
        Suite("quadruped", 40, 2026, partial(make_hidden, "quadruped"), solve, judge_hidden),
        Suite("arm", 20, 2026, partial(make_hidden, "arm"), solve, judge_hidden),
        Suite("pendulum", 20, 2026, partial(make_hidden, "pendulum"), solve, judge_hidden),
        Suite("pairs", 12, 2026, partial(make_hidden, "hexapod", effects=2), solve, judge_hidden),
        Suite("each", 12, 2026, partial(make_hidden, "hexapod", each=True), solve, judge_hidden),
        # What users bring: another simulation, a field calibration, faults of data.
        Suite("field", 15, 1, make_field, solve, judge_field),
        Suite("field_nulls", 20, 1, partial(make_field, nulls=True), solve, judge_field),
        Suite("field_legged", 6, 2, _legged, solve, judge_field),
        Suite("field_legged_nulls", 8, 7, partial(_legged, nulls=True), solve, judge_field),
        # Quadrupeds with encoders and an inertial unit: no pose, faults of the unit, or a pose beside it.
        Suite("legged", 18, 1, _walks("imu", "none"), solve, judge_field),
        Suite("legged_late", 18, 1, _walks("imu", "late"), solve, judge_field),
        Suite("legged_held", 18, 1, _walks("imu", "held"), solve, judge_field),
        Suite("legged_pose", 18, 1, _walks("pose", "none"), solve, judge_field),
        # Laws that no library has.
        Suite("laws", 20, 1, partial(make_law, "arm"), solve, judge_law),
        Suite("laws_legged", 6, 1, partial(make_law, "legged"), solve, judge_law),
        # What has changed since earlier recordings, five cases a robot; and the later recordings alone.
        Suite("changes", 20, 1, make_changed, _compare, judge_change),
        Suite("changes_alone", 20, 1, make_changed, partial(solve, after="after"), judge_change),
        # Torques beside commands, the same arms without them, and torques in place of commands.
        Suite("torques", 10, 1, partial(weak_or_stiff, reported=True), solve, judge_torques),
        Suite("no_torques", 10, 1, partial(weak_or_stiff, reported=False), solve, judge_torques),
        Suite("drives", 10, 1, drives, solve, judge_drives),
    )
}
"""All suites by name: number of cases, seed, and how they are made, solved and judged."""
