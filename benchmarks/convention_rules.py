"""What each rule of the checks of conventions pays: the same cases with and without it.

    uv run python benchmarks/convention_rules.py --cases 4 --clean 60 --json rules.json

The cases are those of `benchmarks/conventions.py`: planted errors, and clean logs, each of which is tried once more
with a coarse encoder (4096 counts a turn, 1 mm). A rule is taken away by the value of its constant that makes it say
nothing. The table counts the planted cases that are named and the clean ones that are accused only with, or only
without it; a rule pays where the difference exceeds two standard errors, the root of the number of cases that differ.
"""

import importlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from re import search
from tempfile import TemporaryDirectory
from time import perf_counter

import mujoco
import numpy as np
import tyro
from conventions import PLANTS, XML, Log, accused, draw, save_logs
from tqdm import tqdm

from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.preflight import Finding, preflight
from btr_mjx.runs import write_json

ALWAYS = 0.0
RULES: Mapping[str, Sequence[tuple[str, str, object]]] = {
    "units only of large numbers (angles)": [("preflight.alternatives.units", "LARGE_ANGLE", ALWAYS)],
    "units only of large numbers (lengths)": [("preflight.alternatives.units", "LARGE_LENGTH", ALWAYS)],
    "swaps of the worst joints only": [("preflight.alternatives.catalogue", "_SWAP_JOINTS", 99)],
    "first look in few stretches": [("preflight.conventions", "_SCREENED", 32)],
    "what is predicted well is not questioned": [("preflight.conventions", "_POOR", ALWAYS)],
    "the same for the base": [("preflight.conventions", "_POOR_BASE", ALWAYS)],
    "error of some coordinate divided by three": [("preflight.conventions", "_RATIO", 1.0)],
    "chance below 1e-5 instead of 1e-3": [("preflight.comparison", "CHANCE", 1e-3)],
    "t test beside the sign test": [("preflight.comparison", "_MIN_VALUES", 10**9)],
    "velocities: error halved": [("preflight.velocities", "_RATIO", 1.0)],
    "velocities: only where there is motion": [("preflight.velocities", "_MOVING", 1.0)],
    "drift: six standard errors instead of three": [("preflight.timing.drift", "_SIGNIFICANT", 3.0)],
    "drift: at least 0.3 ms/s": [("preflight.timing.drift", "_MIN_DRIFT", ALWAYS)],
    "held: changes stand alone": [("data.recordings.held", "_MAX_ADJACENT", 1.0)],
    "held: columns change together": [("data.recordings.held", "_TOGETHER", ALWAYS)],
    "held: at least twelve changes": [("data.recordings.held", "_MIN_CHANGES", 1)],
    "held: more than single counts": [("data.recordings.held", "_MIN_COUNTS", ALWAYS)],
}
"""Rules, each with the constants that are changed: module of `btr_mjx.gap`, name, value."""


@dataclass(frozen=True)
class Config:
    """Settings."""

    cases: int = 4
    """Planted cases for each robot and kind."""
    clean: int = 60
    """Clean logs; each is tried with fine and with coarse encoders."""
    seed: int = 2000
    """Seed of everything random."""
    only: tuple[str, ...] = ()
    """Only rules whose name holds one of these."""
    together: bool = False
    """Take these rules away all at once, not one at a time: each may be superfluous only beside the others."""
    processes: int = 2
    """Processes side by side."""
    json: Path | None = None
    """Also write the counts to this file."""


@dataclass(frozen=True)
class Case:
    """A dataset, and the word that a finding must hold; "" for a clean one."""

    name: str
    folder: Path
    word: str


def coarse(robot: str, logs: Sequence[Log]) -> None:
    """Round the positions of hinges and slides to the counts of a cheap encoder."""
    model = mujoco.MjModel.from_xml_string(XML[robot])
    for joint, kind in enumerate(model.jnt_type):
        if kind in (2, 3):
            q, count = int(model.jnt_qposadr[joint]), 1e-3 if kind == 2 else 2 * np.pi / 4096
            for log in logs:
                log.qpos[:, q] = np.round(log.qpos[:, q] / count) * count


def make_case(job: tuple[str, str, int, Path]) -> Case:
    """Write one dataset."""
    robot, kind, seed, folder = job
    logs, _ = draw(seed, robot)
    word = ""
    if kind == "coarse":
        coarse(robot, logs)
    elif kind != "fine":
        plant, word = PLANTS[robot][kind]
        for log in logs:
            plant(log)
    save_logs(robot, logs, folder)
    return Case(f"{robot} {kind} {seed}", folder, word)


def judge(case: Case) -> bool:
    """Whether a planted error is named, or a clean log accused."""
    try:
        found = preflight(open_dataset(case.folder))
    except InputError as error:
        found = [Finding("error", "loading", str(error))]
    if not case.word:
        return bool(accused(found)) or any("repeat in between" in f.message for f in found)
    return any(search(case.word, f.message) for f in found if f.level != "note" or f.topic == "loading")


def without(rules: Sequence[str]) -> None:
    """Take rules away, in this process."""
    set_constants([constant for rule in rules for constant in RULES[rule]])


def set_constants(constants: Sequence[tuple[str, str, object]]) -> None:
    """Change constants in this process: module of `btr_mjx.gap`, name, value."""
    mujoco.set_mju_user_warning(lambda _: None)
    for module, name, value in constants:
        home = importlib.import_module(f"btr_mjx.gap.{module}")
        if not hasattr(home, name):
            raise InputError(f"{module} has no constant {name}")
        setattr(home, name, value)
        if name == "_MIN_CHANGES":
            home.held.__defaults__ = (value,)


def outcomes(cases: Sequence[Case], rules: Sequence[str], processes: int) -> tuple[np.ndarray, float]:
    """Judgements of all cases without some rules, and the seconds that they took."""
    start = perf_counter()
    with ProcessPoolExecutor(processes, get_context("spawn"), without, (rules,)) as pool:
        judged = tqdm(
            pool.map(judge, cases, chunksize=4), total=len(cases), desc="; ".join(rules) or "all rules", leave=False
        )
        found = list(judged)
    return np.array(found), perf_counter() - start


def compared(with_it: np.ndarray, without_it: np.ndarray, better: bool) -> tuple[int, int, bool]:
    """Cases right only with the rule, only without it, and whether it pays."""
    right, wrong = (with_it, without_it) if better else (~with_it, ~without_it)
    gained, lost = int((right & ~wrong).sum()), int((wrong & ~right).sum())
    return gained, lost, gained - lost > 2 * np.sqrt(gained + lost)


def main(config: Config) -> None:
    """Print the table."""
    with TemporaryDirectory() as parent:
        jobs = [
            (robot, kind, config.seed + i, Path(parent) / f"{robot}-{k}-{i}")
            for robot, kinds in PLANTS.items()
            for k, kind in enumerate(kinds)
            for i in range(config.cases)
        ]
        robots = list(XML)
        jobs += [
            (robots[i % len(robots)], kind, config.seed + 10_000 + i, Path(parent) / f"{kind}-{i}")
            for i in range(config.clean)
            for kind in ("fine", "coarse")
        ]
        with ProcessPoolExecutor(config.processes, get_context("spawn")) as pool:
            cases = list(tqdm(pool.map(make_case, jobs), total=len(jobs), desc="cases", leave=False))
        planted = np.array([bool(case.word) for case in cases])
        base, usual = outcomes(cases, (), config.processes)
        right, wrong = (f"{base[own].sum()} of {own.sum()}" for own in (planted, ~planted))
        print(f"all rules: {right} named, {wrong} clean logs accused, {usual:.0f} s")
        print(f"{'rule':50} {'named only with/without':>24} {'spared only with/without':>25} {'pays':>5} {'time':>6}")
        rows = {}
        chosen = [rule for rule in RULES if not config.only or any(word in rule for word in config.only)]
        for rules in [chosen] if config.together else [[rule] for rule in chosen]:
            other, seconds = outcomes(cases, rules, config.processes)
            rule = "; ".join(rules)
            named = compared(base[planted], other[planted], True)
            spared = compared(base[~planted], other[~planted], False)
            pays = "yes" if named[2] or spared[2] else "no"
            shown = f"{named[0]:>15} / {named[1]:<6} {spared[0]:>16} / {spared[1]:<6}"
            print(f"{rule:50} {shown} {pays:>5} {seconds / usual:6.2f}", flush=True)
            rows[rule] = {"named": named[:2], "spared": spared[:2], "pays": pays == "yes", "time": seconds / usual}
        if config.json:
            write_json(config.json, rows)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
