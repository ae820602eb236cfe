"""Names on cases that resemble what users bring: `uv run python benchmarks/field_gate.py --cases 30 --json after.json`.

    uv run python benchmarks/field_gate.py --nulls --cases 20          # nothing is hidden, logs have one or two faults
    uv run python benchmarks/field_gate.py --compare before.json after.json      # case by case, runs nothing

Cases are those of `field_cases`. A case is made once and kept; an answer is kept under the digest of the code that
computed it, so that the same command continues a run. The right answer to a null is that nothing is missing. An effect
is right by kind and place, also as one of several numbers of which the others may be zero, and a ripple as a law or as
"unexplained"; whatever else is named is false, also a delay where commands were logged late. Exit code: 1 where a case
failed.
"""

import os
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
import tyro
from case_runs import Files
from gap_scores import inside_interval, same_effect
from hidden_cases.field_cases import FAULTS, Wanted, make_case
from hidden_cases.field_robots import ROBOTS
from naming_gate import CODE, mcnemar

from btr_mjx.errors import cli_errors
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.inference import identify
from btr_mjx.gap.preflight import checked, refuse_errors
from btr_mjx.gap.results import as_result, detail_sentences, verdict_sentence
from btr_mjx.runs import note, read_json, write_json

TURN = ("arm", "torque_arm", "pendulum", "gantry", "drone")
"""Robots in turn, where none is chosen."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: int = 15
    """Number of cases."""
    seed: int = 1
    """Seed of the cases."""
    robot: Literal["mixed", "arm", "torque_arm", "pendulum", "gantry", "drone", "legged"] = "mixed"
    """Robot of the cases; mixed takes all in turn but the one on legs."""
    nulls: bool = False
    """Nothing is hidden, and logs have one or two faults in turn; without it one to three effects are hidden."""
    clean: bool = False
    """No faults of data."""
    out: Path = Path("runs/field_gate")
    """Folder of the cases and of the answers of all versions."""
    json: Path | None = None
    """Write the rows of all cases with their answers here."""
    compare: tuple[Path, Path] | None = None
    """Two files that --json wrote: compare them and run nothing."""


def wanted_of(config: Config, index: int) -> tuple[str, Wanted]:
    """Robot of a case and what it is to hold."""
    robot = TURN[index % len(TURN)] if config.robot == "mixed" else config.robot
    turn = index // len(TURN) if config.robot == "mixed" else index
    if config.clean:
        faults: tuple[str, ...] | None = ()
    elif config.nulls:
        first, second = FAULTS[index % len(FAULTS)], FAULTS[(index + 1 + turn % 5) % len(FAULTS)]
        faults = (first,) if turn % 2 == 0 else (first, second)
    else:
        faults = None
    return robot, Wanted(0 if config.nulls else 1 + turn % 3, faults)


def solve(folder: Path) -> dict[str, Any]:
    """Solve a case from its folder alone, as the command `diagnose` does."""
    begun, wall = time.process_time(), time.monotonic()
    dataset = open_dataset(folder)
    dataset, findings = checked(dataset)
    refuse_errors(findings)
    result = as_result(identify(dataset), dataset)
    keys = (
        "verdict",
        "effects",
        "equivalent",
        "chi2",
        "misfit",
        "unexplained",
        "share",
        "lack_of_fit",
        "interpolation",
        "where",
    )
    return {
        **{key: result[key] for key in keys},
        "ranking": result["ranking"][:8],
        "sentence": verdict_sentence(result),
        "details": detail_sentences(result),
        "findings": [f"{f.level}: {f.message}" for f in findings if f.level != "note"],
        "notes": list(dataset.notes),
        "cpu_seconds": time.process_time() - begun,
        "seconds": time.monotonic() - wall,
    }


def same_kind_and_place(model: mujoco.MjModel, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two effects are the same; actuators without a joint have their names alone."""
    places = [effect["location"].partition(":") for effect in (one, other)]
    if places[0][0] == places[1][0] == "actuator" and not all(
        model.actuator_trntype[model.actuator(name).id] == mujoco.mjtTrn.mjTRN_JOINT for _, _, name in places
    ):
        return one["effect"] == other["effect"] and places[0] == places[1]
    if model.nv == 6 and model.njnt == 1 and "all" in (places[0][0], places[1][0]):
        return one["effect"] == other["effect"] and places[0] == places[1]
    return same_effect(model, one, other)


def judged_parts(named: Mapping[str, Any]) -> list[dict[str, Any]]:
    """An effect at single places: of a number for every member of a group, those whose interval excludes nothing."""
    if not named["location"].startswith("each:"):
        return [dict(named)]
    kind = "actuator" if named["effect"].startswith("actuator") else "joint"
    out = []
    for label, number in named["parameters"].items():
        parameter, _, member = label.removesuffix("]").partition("[")
        if not number["low"] <= number["null"] <= number["high"]:
            out.append({**named, "location": f"{kind}:{member}", "parameters": {parameter: number}})
    return out


def judge(model: mujoco.MjModel, truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, Any]:
    """Row of a case: hidden effects that were named, those listed beside, false names, numbers within intervals."""
    hidden = [effect for effect in truth["effects"] if effect["effect"] != "ripple"]
    ripples = {effect["location"] for effect in truth["effects"] if effect["effect"] == "ripple"}
    laws = [n for n in answer["effects"] if n["effect"] == "law_ripple" and n["location"] in ripples]
    named = [n for n in answer["effects"] if n not in laws]
    parts = [part for one in named for part in judged_parts(one)]
    found = [[n for n in parts if same_kind_and_place(model, h, n)] for h in hidden]
    listed = [any(same_kind_and_place(model, h, n) for n in (*parts, *answer["equivalent"])) for h in hidden]

    def is_true(effect: Mapping[str, Any]) -> bool:
        return any(same_kind_and_place(model, h, effect) for h in hidden)

    extra = [n for n in named if not all(is_true(part) for part in judged_parts(n))]
    inside = [ok for h, f in zip(hidden, found, strict=True) if f for ok in inside_interval(model, h, f[0])]
    outside, null = len(hidden) < len(truth["effects"]), not truth["effects"]
    unexplained = answer["verdict"] == "unexplained"
    return {
        "robot": truth["robot"],
        "hidden": [f"{e['effect']}@{e['location']}" for e in truth["effects"]],
        "visible": truth["visible"],
        "faults": truth["faults"],
        "said": answer["verdict"],
        "named": [f"{e['effect']}@{e['location']}" for e in answer["effects"]],
        "effects": len(hidden),
        "right": sum(map(bool, found)),
        "listed": sum(listed),
        "extra": [f"{e['effect']}@{e['location']}" for e in extra],
        "numbers": len(inside),
        "inside": sum(inside),
        "null": null,
        "false_unexplained": unexplained and not outside,
        "outside": outside,
        "flagged": outside and (unexplained or bool(answer["unexplained"]) or bool(laws)),
        "correct": not extra and all(found) and (not unexplained if not outside else True),
        "cpu_seconds": answer["cpu_seconds"],
        "sentence": answer["sentence"],
    }


COLUMNS = (
    ("cases", lambda rows: f"{len(rows)}"),
    ("right names", lambda rows: f"{_sum(rows, 'right')} of {_sum(rows, 'effects')}"),
    ("or listed", lambda rows: f"{_sum(rows, 'listed')} of {_sum(rows, 'effects')}"),
    ("false names", lambda rows: f"{sum(len(r['extra']) for r in rows if not r['null'])}"),
    ("nulls named", lambda rows: f"{sum(bool(r['extra']) for r in _nulls(rows))} of {len(_nulls(rows))}"),
    ("nulls unexpl.", lambda rows: f"{_sum(_nulls(rows), 'false_unexplained')} of {len(_nulls(rows))}"),
    ("false unexpl.", lambda rows: f"{sum(r['false_unexplained'] for r in rows if not r['null'])}"),
    ("outside told", lambda rows: f"{_sum(rows, 'flagged')} of {_sum(rows, 'outside')}"),
    ("in intervals", lambda rows: f"{_sum(rows, 'inside')} of {_sum(rows, 'numbers')}"),
    ("CPU-s", lambda rows: f"{np.median([r['cpu_seconds'] for r in rows]):.0f}"),
    ("largest", lambda rows: f"{max(r['cpu_seconds'] for r in rows):.0f}"),
)
"""Columns of the table: title and content."""


def _sum(rows: Sequence[Mapping[str, Any]], key: str) -> int:
    return int(sum(row[key] for row in rows))


def _nulls(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    return [row for row in rows if row["null"]]


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table by robot, and every answer that is not right."""
    print(f"{'robot':12}" + "".join(f"{title:>14}" for title, _ in COLUMNS))
    for robot in (*ROBOTS, "all"):
        if own := [row for row in rows if robot in ("all", row["robot"])]:
            print(f"{robot:12}" + "".join(f"{cell(own):>14}" for _, cell in COLUMNS))
    print()
    for row in rows:
        if not row["correct"]:
            print(f"{row['case']} [{', '.join(row['faults']) or 'no faults'}] hidden {_words(row['hidden'])}")
            print(f"    {row['said']}: {_words(row['named'])}; false: {_words(row['extra'])}\n    {row['sentence']}")


def _words(names: Sequence[str]) -> str:
    return " + ".join(names) or "nothing"


def compare(before: Path, after: Path) -> None:
    """Print how many cases two versions have right, and whose answers changed."""
    old, new = ({row["case"]: row for row in read_json(path)["rows"]} for path in (before, after))
    both = sorted(set(old) & set(new))
    for title, key in (("all right", "correct"), ("no false name", "extra")):
        right = [[not r[c][key] if key == "extra" else r[c][key] for c in both] for r in (old, new)]
        print(f"{title:16}" + "  ".join(f"{name} {value:.3g}" for name, value in mcnemar(*right).items()))
    for sum_of in ("right", "inside", "numbers", "cpu_seconds"):
        print(f"{sum_of:16}{sum(old[c][sum_of] for c in both):.5g} -> {sum(new[c][sum_of] for c in both):.5g}")
    for case in both:
        if (old[case]["said"], old[case]["named"]) != (new[case]["said"], new[case]["named"]):
            words = [f"{r[case]['said']} {_words(r[case]['named'])}" for r in (old, new)]
            print(f"{case}, hidden {_words(old[case]['hidden'])}: {words[0]} -> {words[1]}")


def solved_case(config: Config, index: int, answers: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Make and solve a case, unless its answer is kept in a folder: its row and its answer; None if it failed."""
    robot, wanted = wanted_of(config, index)
    kind = ("nulls" if config.nulls else "effects") + ("-clean" if config.clean else "")
    name = f"{config.robot}-{kind}-{config.seed}-{index:04d}"
    files, kept = Files(config.out / name, index), answers / f"{name}.json"
    try:
        if not files.truth.is_file():
            seed = int(np.random.SeedSequence([config.seed, index]).generate_state(1)[0])
            write_json(files.truth, make_case(files.data, seed, robot, wanted))
        if not kept.is_file():
            write_json(kept, solve(files.data))
    except Exception as error:
        note(f"case {name} failed: {type(error).__name__}: {error}")
        write_json(config.out / "failed" / CODE / f"{name}.json", {"error": traceback.format_exc()})
        return None
    answer = {"truth": read_json(files.truth), **read_json(kept)}
    model = mujoco.MjModel.from_xml_path(str(files.data / "model.xml"))
    row = {"case": name, **judge(model, answer["truth"], answer)}
    note(f"{name} {row['faults']} {_words(row['hidden'])}: {row['said']} {_words(row['named'])}")
    return row, answer


def gate(config: Config) -> dict[str, Any]:
    """Make and solve the cases that are not kept; returns what --json writes."""
    found = [solved_case(config, index, config.out / "answers" / CODE) for index in range(config.cases)]
    rows = [case[0] for case in found if case]
    answers = {case[0]["case"]: case[1] for case in found if case}
    return {"code": CODE, "rows": rows, "answers": answers, "failed": [i for i, case in enumerate(found) if not case]}


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    mujoco.set_mju_user_warning(lambda _: None)
    with cli_errors():
        if config.compare is not None:
            compare(*config.compare)
            return
        report = gate(config)
        if config.json is not None:
            write_json(config.json, report)
        if report["rows"]:
            show(report["rows"])
        if report["failed"]:
            raise SystemExit(f"cases that failed: {', '.join(map(str, report['failed']))}")


if __name__ == "__main__":
    main()
