"""Logs in other units than the model's: how many are refused with the right factor, and how many sound ones are.

    uv run python benchmarks/log_units.py --cases 20                    # each unit, and sound logs of all robots
    uv run python benchmarks/log_units.py --cases 20 --only turns sound
    uv run python benchmarks/log_units.py --real FOLDER FOLDER          # recordings that are known to be in order

Robots: those of `field_robots`, with errors of calibration; in half of the cases an effect is missing as well (a gain,
friction, damping, a spring, a payload). What a finding says to write into dataset.toml is written there, and the data
are checked again: they have to pass without another instruction.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np
import tyro
from hidden_cases.field_cases import Logging, log_rows
from hidden_cases.field_physics import SETTLE, Controlled, build, draw_calibration, move
from hidden_cases.field_robots import ROBOTS, FieldRobot

from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset
from btr_mjx.gap.preflight import Finding, preflight

STEP, DURATION, RUNS = 5e-4, 4.0, 3
"""Time step of the real robot [s]; length [s] and number of its recordings."""
HINGED = ("arm", "torque_arm", "pendulum", "legged")
EFFECTS = ("actuator_gain", "dry_friction", "viscous_damping", "joint_stiffness", "armature")


@dataclass(frozen=True)
class Unit:
    """What a log counts angles in.

    Attributes:
      rad: one of them [rad].
      words: one of which the message has to hold.
      whole: whether positions and goals are whole numbers.
      zero: count at which the joint is at 0.
    """

    rad: float
    words: tuple[str, ...]
    whole: bool = False
    zero: float = 0.0


ANGLES: Mapping[str, Unit] = {
    "turns": Unit(2 * np.pi, ("turns (2 pi rad)",)),
    "half turns": Unit(np.pi, ("half turns (pi rad)",)),
    "degrees": Unit(np.pi / 180, ("degrees",)),
    "ticks 4096": Unit(2 * np.pi / 4096, ("4096 a turn",), True),
    "ticks 8192": Unit(2 * np.pi / 8192, ("8192 a turn",), True),
    "ticks 16384": Unit(2 * np.pi / 16384, ("16384 a turn",), True),
}
AMPERES = (0.05, 0.48, 0.7, 2.2)
"""Torque constants [N m/A] of which one is drawn."""


@dataclass(frozen=True)
class Config:
    """Settings."""

    cases: int = 20
    """Logs in each unit."""
    seed: int = 0
    """Seed of everything random."""
    only: tuple[str, ...] = ()
    """Only these rows of the table: names of units, "amperes", "sound"."""
    real: tuple[Path, ...] = ()
    """Datasets that are known to be in order; nothing is simulated then."""
    verbose: bool = False
    """Print what is missed and what is accused."""


def draw(folder: Path, kind: str, seed: int) -> tuple[FieldRobot, list[str]]:
    """Write the model of a random robot and its logs in SI units; returns the robot and what the model lacks."""
    rng = np.random.default_rng([seed, sorted(ROBOTS).index(kind)])
    robot = replace(ROBOTS[kind](rng), step=STEP)
    model = mujoco.MjModel.from_xml_string(robot.xml)
    interval = 1 / float(rng.choice([rate for rate in robot.rates if 1 / STEP % rate == 0]))
    calibration = draw_calibration(rng, model, 0.5 * interval)
    joints = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    hidden = []
    if joints and rng.random() < 0.5:
        joint, effect = int(rng.choice(joints)), str(rng.choice(EFFECTS))
        v, size = int(model.jnt_dofadr[joint]), float(rng.uniform(0.3, 1.0))
        inertia = float(model.dof_M0[v])
        value = {
            "actuator_gain": -0.4 * size,
            "dry_friction": size * inertia * 4,
            "viscous_damping": size * inertia * 8,
            "joint_stiffness": size * inertia * 30,
            "armature": size * inertia,
        }[effect]
        place = (
            f"actuator:{model.actuator(0).name}" if effect == "actuator_gain" else f"joint:{model.joint(joint).name}"
        )
        hidden.append({"effect": effect, "location": place, "parameters": {"value": value}})
    machine = build(robot, calibration, hidden)
    log = Logging(interval, (), bool(rng.random() < 0.7), 0.0, 0, robot.noise)
    times = np.arange(-round(SETTLE / STEP), round(DURATION / STEP)) * STEP
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(robot.xml)
    for k in range(RUNS):
        control = Controlled(robot, robot.reference(rng)(times), 2 if robot.controller else 1)
        (folder / f"run{k + 1}.csv").write_text(log_rows(rng, robot, model, move(machine, control), log))
    return robot, [f"{one['effect']} at {one['location']}" for one in hidden]


def rewrite(folder: Path, change: Callable[[str, np.ndarray], np.ndarray]) -> None:
    """Change the columns of all logs, by name."""
    for path in sorted(folder.glob("run*.csv")):
        names, *rows = path.read_text().splitlines()
        table = np.array([row.split(",") for row in rows], float)
        out = np.stack([change(name, column) for name, column in zip(names.split(","), table.T, strict=True)], 1)
        path.write_text("\n".join([names, *(",".join(f"{x:.9g}" for x in row) for row in out)]) + "\n")


def count_in(folder: Path, robot: FieldRobot, unit: Unit) -> None:
    """Give the angles of all logs, their velocities and the goals of servos in another unit."""
    model = mujoco.MjModel.from_xml_string(robot.xml)
    hinges = [model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    places = {f"q_{name}" for name in hinges} | ({f"cmd_{name}" for name in hinges} if robot.servos else set())
    speeds = {f"dq_{name}" for name in hinges}

    def change(name: str, column: np.ndarray) -> np.ndarray:
        if name in places:
            counts = column / unit.rad + unit.zero
            return np.round(counts) if unit.whole else counts
        return column / unit.rad if name in speeds else column

    rewrite(folder, change)


def check(folder: Path) -> list[Finding]:
    """The findings; a refusal by the reader counts as an error."""
    try:
        return preflight(open_dataset(folder))
    except InputError as error:
        return [Finding("error", "loading", str(error), lines=error.lines)]


def paste(folder: Path, lines: Sequence[str]) -> None:
    """Write what a finding says to write."""
    first = next(i for i, line in enumerate(lines) if line.startswith(("Write this to", "Add this to")))
    last = next(i for i, line in enumerate(lines) if line.startswith("then run:"))
    text = "\n".join(line for line in lines[first + 1 : last] if not line.startswith("("))
    with (folder / "dataset.toml").open("a" if lines[first].startswith("Add") else "w") as file:
        file.write(f"\n{text}\n")


def after_pasting(folder: Path, findings: Sequence[Finding]) -> list[Finding]:
    """The findings after the first instruction was followed."""
    told = [finding for finding in findings if finding.lines]
    if not told:
        return list(findings)
    paste(folder, told[0].lines)
    return check(folder)


def passes(findings: Sequence[Finding]) -> bool:
    """Whether data are neither refused nor asked to be changed."""
    return not any(finding.level == "error" or finding.lines for finding in findings)


def in_unit(config: Config, name: str) -> None:
    """Print how many logs in a unit are refused with its name, and pass once the lines are pasted."""
    count: Counter[str] = Counter()
    for case in range(config.cases):
        kind = HINGED[case % len(HINGED)] if name in ANGLES else ("torque_arm", "pendulum")[case % 2]
        with TemporaryDirectory() as place:
            folder = Path(place) / "case"
            robot, lacks = draw(folder, kind, config.seed + case)
            if name in ANGLES:
                count_in(folder, robot, ANGLES[name])
                words, level = ANGLES[name].words, "error"
            else:
                constant = AMPERES[case // 2 % len(AMPERES)]
                rewrite(folder, lambda n, x, k=constant: x / k if n.startswith("cmd_") else x)  # type: ignore[misc]
                words, level = ("current",), "warning"
            found = check(folder)
            told = [f for f in found if f.level != "note" and any(word in f.message for word in words)]
            odd = [f for f in told if f.level == level]
            after = after_pasting(folder, found) if odd else []
        count["told"] += bool(told)
        count["named"] += bool(odd)
        count["mended"] += bool(odd) and passes(after)
        if config.verbose and not (odd and passes(after)):
            said = [f.message for f in (after if odd else found) if f.level != "note"]
            print("   ", kind, config.seed + case, lacks, "pasted:" if odd else "", said, flush=True)
    print(
        f"{name:12} named {count['named']:3} (or as one of two in a warning: {count['told']}), passes once pasted "
        f"{count['mended']:3}, of {config.cases}",
        flush=True,
    )


def sound(config: Config) -> None:
    """Print how many sound logs are refused, asked to be changed, or warned of."""
    count: Counter[str] = Counter()
    for case in range(config.cases):
        kind = list(ROBOTS)[case % len(ROBOTS)]
        with TemporaryDirectory() as place:
            _, lacks = draw(Path(place) / "case", kind, 1000 + config.seed + case)
            found = check(Path(place) / "case")
        odd = [f for f in found if f.level == "error" or f.lines]
        warned = [f for f in found if f.level == "warning"]
        count["refused"] += bool(odd)
        count["warned"] += bool(warned)
        if config.verbose and (odd or warned):
            print("   ", kind, 1000 + config.seed + case, lacks, [f.message for f in odd + warned], flush=True)
    print(f"sound        refused {count['refused']:3}, warned {count['warned']:3}, of {config.cases}", flush=True)


def main(config: Config) -> None:
    """Run what was asked for."""
    mujoco.set_mju_user_warning(lambda _: None)  # alternatives that diverge are what they are
    for folder in config.real:
        odd = [f for f in check(folder) if f.level != "note"]
        print(folder, [f"{f.level}: {f.message}" for f in odd] or "nothing is accused", flush=True)
    rows = [*ANGLES, "amperes", "sound"] if not config.real else []
    for name in config.only or rows:
        sound(config) if name == "sound" else in_unit(config, name)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
