"""Diagnosis of real machines from public recordings, beside specialists and simple rivals.

    uv run python benchmarks/decathlon.py --data FOLDER --json OUT.json
    uv run python benchmarks/decathlon.py --data FOLDER --only emps ur10e --halves --json OUT.json

FOLDER has a subfolder for each repository, named like it without its owner: a clone, or a bare git directory. The
modules of `benchmarks/decathlon/` say which file of which repository is read, under which licence, what the believed
model is, what is held out and over which time predictions are compared. Most of the data may not be redistributed.

Each machine becomes a dataset folder, and a process of its own diagnoses it. Believed and mended model are then
simulated open loop in plain MuJoCo on the held-out recordings, beside constant velocity, a regression of forces, and
the numbers that specialists found. A diagnosis is kept under the digest of the code and of its data: the same command
continues a killed run. With --halves, both halves of the fitted recordings are diagnosed, too: do they agree? With
--toolbox, MuJoCo's own toolbox fits the same recordings.

Of each machine one held-out curve is kept in the folder of --out. --page puts the table, the curves and what was found
into docs/machines.md; without --data, it does so from --json and the curves that are there.
Exit code: 1 where a diagnosis failed, 2 for bad input.
"""

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent / "decathlon"))

import crazyflie
import double_pendulum
import elbow
import emps
import go2_air
import held_out
import mujoco
import panda
import rivals
import servo
import simple_pendulum
import so101
import tx40
import tyro
import ur10e
from gates.answers import CODE, data_digest
from machine import Copies, Machine, Trial, halves, write_trial
from open_loop import (
    Predictor,
    believed_models,
    mended_models,
    misses,
    simulated,
    steady,
    stretch_errors,
    stretches,
    total_error,
)
from page import names, write_page
from sections import PICTURES, agreed, cell

from btr_mjx.errors import BAD_INPUT_CODE, InputError, cli_errors
from btr_mjx.gap.results import verdict_sentence
from btr_mjx.runs import describe_environment, note, read_json, write_json

MACHINES: Mapping[str, Machine] = {
    module.MACHINE.name: module.MACHINE
    for module in (
        *(emps, ur10e, tx40, panda, simple_pendulum, double_pendulum, servo),
        *(go2_air, so101, elbow, crazyflie),
    )
}
"""Machines by name, in the order of the table."""

COLUMNS = {
    "believed": "believed",
    "mended": "mended",
    "steady": "const. vel.",
    "published": "specialists",
    "known": "their numbers",
    "regression": "regression",
    "regression_with_gain": "with gain",
    "toolbox": "mujoco.sysid",
}
"""Columns of the table: errors by name, and their titles."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    data: Path | None = None
    """Folder with a copy of each repository; without it nothing is computed."""
    only: tuple[str, ...] = ()
    """Names of machines; all if none is given."""
    halves: bool = False
    """Also diagnose both halves of the recordings to fit."""
    toolbox: bool = False
    """Also fit each machine with mujoco.sysid; some minutes each."""
    out: Path = Path("runs/decathlon")
    """Folder of datasets, runs and curves."""
    json: Path | None = None
    """Write all numbers here. Machines that the file has already are kept; each row states the digest of its code."""
    page: Path | None = None
    """Put the table, the sections and the pictures of all machines into this page, docs/machines.md."""


def diagnosed(folder: Path, run: Path) -> dict[str, Any]:
    """Diagnose a dataset folder in a process of its own, unless that was done with this code and these data.

    Args:
      folder: the dataset.
      run: its run folder.

    Returns:
      CPU-seconds and, under "refused" or "failed", the message of a command that gave no result.
    """
    kept, data = run.with_name(f"{run.name}.json"), data_digest(folder)
    if kept.is_file() and (known := read_json(kept))["data"] == data and not known["failed"]:
        return dict(known)
    shutil.rmtree(run, ignore_errors=True)
    run.parent.mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "btr_mjx.diagnose", folder, "--out", run]
    before = _cpu()
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    message = (done.stderr.strip() or done.stdout.strip() or f"exit code {done.returncode}").splitlines()[-1]
    refused = message if done.returncode == BAD_INPUT_CODE else ""
    failed = message if done.returncode not in (0, BAD_INPUT_CODE) else ""
    answer = {"cpu_seconds": _cpu() - before, "data": data, "refused": refused, "failed": failed}
    write_json(kept, answer)
    return answer


def examined(machine: Machine, trial: Trial, config: Config) -> dict[str, Any]:
    """Diagnosis of a machine, the errors of all predictors on its held-out recordings, and a curve of them."""
    folder, run = config.out / "data" / machine.name, config.out / CODE / machine.name
    shutil.rmtree(folder, ignore_errors=True)
    write_trial(trial, folder)
    row = _described(machine) | {"code": CODE} | diagnosed(folder, run)
    models = believed_models(trial)
    predictors: dict[str, Predictor] = {
        "believed": simulated(lambda log: (models[log.own_model], ()), trial.interpolation),
        "steady": steady(models[""]),
    }
    if machine.published:
        predictors["known"] = rivals.predictor(trial, machine.published)
    for name, with_gain in (("regression", False), ("regression_with_gain", True)):
        numbers = rivals.regression(trial, with_gain)
        if numbers is not None:
            predictors[name] = rivals.predictor(trial, numbers)
            row[name] = {key: values.tolist() for key, values in numbers.items()}
    if config.toolbox:
        import toolbox  # needs mujoco[sysid], which users of the other rivals need not have

        row["toolbox"], found = toolbox.fitted(machine, trial)
        predictors |= {"toolbox": found} if found else {}
    if not row["refused"] and not row["failed"]:
        result = read_json(run / "result.json")
        if (run / "mended.xml").is_file():  # only where something was named
            mended = mended_models(trial, run, result, read_json(run / "mended.json")["terms"])
            predictors["mended"] = simulated(lambda log: mended[log.own_model], trial.interpolation)
        row |= {key: result[key] for key in ("verdict", "effects", "unexplained", "notes")}
        row["sentence"] = verdict_sentence(result)
    missed = {name: misses(machine, trial, models[""], predict) for name, predict in predictors.items()}
    row["errors"] = {"published": machine.specialists}
    row["errors"] |= {name: total_error(machine, own) for name, own in missed.items()}
    place = held_out.median_place(stretch_errors(machine, missed.get("mended", missed["believed"])))
    shown = {name: predictors[name] for name in held_out.LOOKS if name in predictors}
    curve = held_out.curve(machine, models[""], stretches(machine, trial)[place], shown)
    held_out.save(curve, config.out / "curves" / f"{machine.name}.npz")
    return row | {"curve": {"recording": curve.recording, "start": curve.start, "coordinate": curve.coordinate}}


def repeated(machine: Machine, trial: Trial, config: Config) -> dict[str, Any]:
    """Whether both halves of the recordings to fit give the same names, and which intervals overlap."""
    found = []
    for i, half in enumerate(halves(trial)):
        name = f"{machine.name}_half{i}"
        shutil.rmtree(config.out / "data" / name, ignore_errors=True)
        write_trial(half, config.out / "data" / name)
        answer = diagnosed(config.out / "data" / name, config.out / CODE / name)
        if answer["refused"] or answer["failed"]:
            return {"refused": answer["refused"] or answer["failed"]}
        found.append(read_json(config.out / CODE / name / "result.json")["effects"])
    return agreement(*found)


def agreement(first: Sequence[Mapping[str, Any]], second: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Names that two diagnoses share, and how many of their common numbers have intervals that overlap.

    Args:
      first: effects of a result.json.
      second: those of another one.
    """
    a, b = ({f"{e['effect']}@{e['location']}": e["parameters"] for e in effects} for effects in (first, second))
    both = [name for name in a if name in b]
    pairs = [(a[name][key], b[name][key]) for name in both for key in a[name] if key in b[name]]
    overlap = [max(x["low"], y["low"]) <= min(x["high"], y["high"]) for x, y in pairs]
    return {
        "same_names": set(a) == set(b),
        "both": both,
        "first_only": [name for name in a if name not in b],
        "second_only": [name for name in b if name not in a],
        "numbers": len(overlap),
        "overlap": sum(overlap),
    }


def show(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table and what was said of each machine."""
    print(f"{'machine':16}{'unit':>6}" + "".join(f"{title:>15}" for title in COLUMNS.values()) + f"{'CPU-s':>8}")
    for row in rows:
        cells = "".join(f"{cell(row['errors'].get(name)):>15}" for name in COLUMNS)
        print(f"{row['name']:16}{row['unit']:>6}{cells}{row['cpu_seconds']:8.0f}")
    for row in rows:
        said = row["refused"] or row["failed"] or f"{row['verdict']}; {names(row) or 'no name'}. {row['sentence']}"
        print(f"\n{row['name']}: {said}")
        if half := row.get("halves"):
            print(f"  halves: {half.get('refused') or agreed(half)}")


def decathlon(config: Config) -> dict[str, Any]:
    """Diagnose the machines one after another; returns the report that --json writes."""
    unknown = [name for name in config.only if name not in MACHINES]
    if unknown:
        raise InputError(f"--only: there is no machine {unknown[0]}; known are {', '.join(MACHINES)}")
    if config.data is not None and not config.data.is_dir():
        raise InputError(f"--data {config.data}: there is no such folder")
    kept = read_json(config.json) if config.json is not None and config.json.is_file() else {}
    if config.data is None and not kept:
        raise InputError("--data: name the folder of the copies, or with --json a file of an earlier run")
    rows = {row["name"]: row for row in kept.get("rows", [])}
    report: dict[str, Any] = dict(kept)
    for name in (config.only or tuple(MACHINES)) if config.data else ():
        note(f"{name} ...")
        trial = MACHINES[name].make(Copies(config.data))
        rows[name] = examined(MACHINES[name], trial, config)
        if config.halves:
            rows[name]["halves"] = repeated(MACHINES[name], trial, config)
        ordered = [rows[name] for name in MACHINES if name in rows]
        report = {"code": CODE, "environment": describe_environment(), "rows": ordered}
        if config.json is not None:
            write_json(config.json, report)
    if config.page is not None:
        for row in report["rows"]:
            curve = config.out / "curves" / f"{row['name']}.npz"
            if curve.is_file():
                held_out.draw(curve, config.page.parent / PICTURES / f"{row['name']}.svg")
        write_page(report["rows"], config.page)
    return report


def _described(machine: Machine) -> dict[str, Any]:
    keys = ("name", "about", "source", "licence", "citation", "split", "unit", "figure", "horizon", "measure")
    return {key: getattr(machine, key) for key in keys}


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    mujoco.set_mju_user_warning(lambda _: None)  # a believed model may well diverge
    with cli_errors():
        report = decathlon(config)
    show(report["rows"])
    if any(row["failed"] for row in report["rows"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
