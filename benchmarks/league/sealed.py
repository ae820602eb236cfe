"""The realities of the league: what is hidden in them, and the process that measures. No contestant imports this file.

    python benchmarks/league/sealed.py measure REALITY EXCHANGE TRIALS [--exact]
    python benchmarks/league/sealed.py oracle REALITY OUT.json SEED BUDGET.json

`measure` tries what an exchange folder asks for and has not been measured yet, and refuses where more than TRIALS are
asked for altogether. `oracle` evolves controllers in the reality itself and says what was hidden. The physics is that
of `hidden_cases`, which shares no code with the effects of the library.
"""

import csv
import os
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import mujoco
import numpy as np
from contest import REALITIES, Budget, best_index, coded, evolved, league_robot, unknown_of
from hidden_cases import physics
from hidden_cases.case_sampling import Draw, draw_background
from hidden_cases.motion import Loads, Restart, peak_loads, simulate_reality
from hidden_cases.outside import OUTSIDE, possible_outside
from hidden_cases.physics import HiddenReality
from hidden_cases.robots import CaseRobot

from btr_mjx.demo import MotionCommand
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.gap.data import control_columns, state_columns
from btr_mjx.models import base_model, start_of
from btr_mjx.robots import Pairs, Robot
from btr_mjx.runs import read_json, write_json, write_text

SEED = 46
"""Seed of all realities: one for which those with nothing or something else hidden are of four different robots."""
OUTSIDERS, EMPTY = 2, 2
"""Realities with an effect that the library does not have, and realities in which nothing is hidden."""
CALIBRATION = 3.0
"""Errors of calibration, in those of `hidden_cases`: gains are wrong by 0.9 %, masses by 1.2 %, friction by 9 %."""
RATE, STEP = 200.0, 5e-4
"""Samples per second of signals and recordings, and time step of reality [s]."""
_NEVER = 10**9
"""Samples between two resets of a reality: it is put into the state in which trials start, and left alone."""

Size = Callable[[np.random.Generator, Loads, str], Mapping[str, float]]


def _of(name: str, low: float, high: float, unit: Callable[[Loads, str], float] = lambda loads, joint: 1.0) -> Size:
    return lambda rng, loads, joint: {name: rng.uniform(low, high) * unit(loads, joint)}


JOINT_EFFECTS: Mapping[str, Size] = {
    "viscous_damping": _of("damping", 0.1, 0.4, lambda own, j: own.torque[j] / own.speed[j]),
    "dry_friction": _of("torque", 0.08, 0.25, lambda own, j: own.torque[j]),
    "load_friction": _of("coefficient", 0.15, 0.4),
    "armature": _of("armature", 0.1, 0.4, lambda own, j: own.torque[j] / own.acceleration[j]),
    "joint_stiffness": _of("stiffness", 0.08, 0.3, lambda own, j: own.torque[j] / own.travel[j]),
    "joint_offset": _of("offset", 0.03, 0.1),
    "backlash": _of("play", 0.02, 0.06),
    "actuator_delay": _of("delay", 0.01, 0.03),
    "actuator_lag": _of("time_constant", 0.01, 0.04),
    "actuator_gain": _of("change", -0.4, -0.15),
    "torque_limit": _of("limit", 0.35, 0.7, lambda own, j: own.torque[j]),
}
"""Effects at joints and motors, with their sizes: large enough to matter to a controller."""

SERVO_EFFECTS = ("joint_stiffness", "joint_offset", "backlash")
"""Those that presume motors which hold an angle."""


@dataclass(frozen=True)
class Reality:
    """A reality.

    Attributes:
      robot: the believed robot.
      world: the physics of the true one.
      hidden: what is hidden, in words.
      sort: nothing, library or outside.
    """

    robot: Robot
    world: HiddenReality
    hidden: tuple[str, ...]
    sort: str


@cache
def reality(name: str) -> Reality:
    """A reality by name; the same in every process.

    Raises:
      InputError: there is none of that name.
    """
    if name not in REALITIES:
        raise InputError(f"reality {name!r}: expected one of {', '.join(REALITIES)}")
    index = REALITIES.index(name)
    place = int(np.random.default_rng(SEED).permutation(len(REALITIES))[index])
    sort = "outside" if place < OUTSIDERS else "nothing" if place < OUTSIDERS + EMPTY else "library"
    robot, rng = league_robot(name), np.random.default_rng([SEED, index])
    box, truth = robot.simulation_box, robot.nominal_simulation
    drawn = {own: float(rng.uniform(low, high)) for own, low, high in zip(box.names, box.low, box.high, strict=True)}
    drawn = {own: drawn[own] for own in unknown_of(robot)}
    edited = {own for edit in robot.edits for own in edit.parameters}
    for own, value in drawn.items():
        if own not in edited:
            truth[box.index(own)] = value
    planes = base_model(robot).geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    machine = CaseRobot(
        name=robot.name,
        xml=robot.render(truth),
        draw_motion=_random_motion(robot),
        duration=robot.duration,
        base=robot.base_body,
        noise=(0.0,) * 6,
        tempo=6.0 / robot.duration,
        floor="floor" if planes.any() else None,
        legs=(),
        links=(),
        drag=(0.0, 0.0),
    )
    motions = [machine.draw_motion(rng) for _ in range(3)]
    loads = peak_loads(machine, motions, _start(robot))
    world = HiddenReality.of(machine)
    for own in sorted(edited & set(drawn)):
        _set_parameter(world, robot, own, drawn[own])
    draw_background(Draw(machine, rng, motions, loads), CALIBRATION)(world)
    hidden: list[str] = []
    if sort == "outside":
        effect = str(rng.choice(possible_outside(world)))
        hidden.append(f"{effect}@{OUTSIDE[effect](world, list(loads.torque), loads, rng)}")
    if sort == "library":
        hidden += _add_effects(world, loads, rng, int(rng.integers(1, 4)))
    words = tuple(f"{own} = {value:.4g}" for own, value in drawn.items())
    return Reality(robot, world, (*words, *hidden), sort)


def _random_motion(robot: Robot) -> Callable[[np.random.Generator], MotionCommand]:
    return lambda rng: motion_of(signal_table(robot, robot.controller_box.sample(rng, 1)[0]))


def _add_effects(world: HiddenReality, loads: Loads, rng: np.random.Generator, count: int) -> list[str]:
    """Draw and add effects of different kinds; their names and places."""
    joints, robot = list(loads.torque), world.robot
    servos = any(actuator.biasprm[1] != 0 for actuator in world.spec.actuators)
    kinds = [name for name in JOINT_EFFECTS if servos or name not in SERVO_EFFECTS] + ["payload"]
    if robot.base is not None:
        kinds += ["ground_friction", "ground_slope", "constant_force"]
    out = []
    for name in map(str, rng.choice(kinds, count, replace=False)):
        at = "world"
        if name in JOINT_EFFECTS:
            first = str(rng.choice(joints))
            everywhere = name not in ("joint_stiffness", "joint_offset") and rng.random() < 0.5
            numbers = JOINT_EFFECTS[name](rng, loads, first)
            getattr(physics, name)(world, joints if everywhere else [first], **numbers)
            at = "all" if everywhere else first
        elif name == "payload":
            body = robot.base or robot.model.body(int(robot.model.jnt_bodyid[-1])).name
            own = float(robot.model.body_subtreemass[robot.model.body(body).id])
            physics.payload(world, body, own * rng.uniform(0.15, 0.4), rng.uniform(-0.05, 0.05, 3).tolist())
            at = body
        elif name == "ground_friction":
            physics.ground_friction(world, rng.uniform(0.3, 0.6))
        elif name == "ground_slope":
            physics.ground_slope(world, *(0.1 * rng.normal(size=2)).tolist())
        else:
            weight = float(robot.model.body_subtreemass[0]) * 9.81
            force = rng.uniform(0.1, 0.25) * weight * np.array([*rng.normal(size=2), 0.0])
            physics.constant_force(world, str(robot.base), force.tolist())
        out.append(f"{name}@{at}")
    return out


def _set_parameter(world: HiddenReality, robot: Robot, name: str, value: float) -> None:
    """Give a believed parameter, whose paths robot.toml has, its true value."""
    with Path(robot.template_path).with_name("robot.toml").open("rb") as file:
        row = next(row for row in tomllib.load(file)["parameter"] if row["name"] == name)
    relative = row.get("relative", False)
    for path in [row["path"]] if isinstance(row["path"], str) else row["path"]:
        place, _, field = path.partition("/")
        own = place.partition(":")[2]
        if field == "mass":
            physics.scale_mass(world, own, value if relative else value / float(world.robot.model.body(own).mass[0]))
        elif field == "damping":
            joint = world.spec.joint(own)
            joint.damping = np.array([value * (joint.damping[0] if relative else 1.0), *joint.damping[1:]])
        elif field == "kp" and relative:
            motor = next(actuator for actuator in world.spec.actuators if actuator.name == own)
            motor.gainprm = np.array([value * motor.gainprm[0], *motor.gainprm[1:]])
            motor.biasprm = np.array([motor.biasprm[0], value * motor.biasprm[1], *motor.biasprm[2:]])
        else:
            raise InputError(f"{robot.name}: {path}: the realities of the league have no such parameter")


def _start(robot: Robot) -> Restart | None:
    start = start_of(robot)
    return start and Restart(
        {name: own[None] for name, own in zip(("qpos", "qvel", "act"), start, strict=True)}, _NEVER
    )


def signal_table(robot: Robot, controller: np.ndarray) -> np.ndarray:
    """Reference signal (K, 1 + nu) of a controller (n_c,), as an exchange folder has it: time [s] and commands."""
    time = np.arange(0.0, robot.duration + 0.5 / RATE, 1.0 / RATE)
    return np.array([[t, *robot.signal(controller[:, None], t, np)[:, 0]] for t in time])


def motion_of(table: np.ndarray) -> MotionCommand:
    """Commands at any time of a signal (K, 1 + nu)."""
    return lambda times: np.stack([np.interp(times, table[:, 0], own) for own in table[:, 1:].T], axis=-1)


def moved(own: Reality, table: np.ndarray) -> dict[str, np.ndarray]:
    """What a reality does with a signal, see `hidden_cases.motion.simulate_reality`."""
    return simulate_reality(own.world, motion_of(table), own.robot.duration, RATE, STEP, _start(own.robot))


@dataclass(frozen=True)
class TrueSimulator:
    """A reality as the simulator of a robot, for the oracle."""

    name: str

    def __call__(self, robot: Robot, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """See `btr_mjx.robots.Simulator`."""
        rows = [moved(reality(self.name), signal_table(robot, controller)) for controller in pairs.controllers]
        at = np.rint(pairs.times * RATE).astype(int)
        return np.stack([row["qpos"][at] for row in rows]), np.stack([row["qvel"][at] for row in rows])


def oracle(name: str, out: Path, seed: int, budget: Budget) -> None:
    """Evolve controllers in a reality with the search of the contestants; write the best one, and what is hidden."""
    robot = replace(reality(name).robot, simulator=TrueSimulator(name))
    generations = budget.generations * budget.rounds
    genomes, scores = evolved(robot, robot.nominal_simulation[None], budget, generations, [seed, 1])
    best = np.unravel_index(best_index(robot, scores), scores.shape)
    found: dict[str, Any] = {"controller": coded(robot).decode(genomes[best]).tolist()}
    write_json(out, found | {"hidden": list(reality(name).hidden), "sort": reality(name).sort})


def measure(name: str, exchange: Path, trials: int, exact: bool) -> None:
    """Measure what was asked for in an exchange folder and is not there.

    Raises:
      InputError: more than `trials` were asked for.
    """
    own, asked = reality(name), sorted((exchange / "trials").glob("*.csv"))
    ids = [int(row["id"]) for path in asked for row in csv.DictReader(path.read_text().splitlines())]
    if len(ids) > trials:
        raise InputError(f"{name}: {len(ids)} trials were asked for, and {trials} may be measured")
    for i in ids:
        path = exchange / "measured" / f"trial-{i}.csv"
        if not path.is_file():
            table = np.loadtxt(exchange / "signals" / f"trial-{i}.csv", delimiter=",", skiprows=1, ndmin=2)
            rng = np.random.default_rng([SEED, REALITIES.index(name), i])
            write_text(path, _recorded(own, table, None if exact else rng))


def _recorded(own: Reality, table: np.ndarray, rng: np.random.Generator | None) -> str:
    """The recording of a trial as CSV, with the noise of good sensors."""
    model, rows = base_model(own.robot), moved(own, table)
    qpos, qvel = rows["qpos"], rows["qvel"]
    if rng is not None:
        free = model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_FREE
        for row, error in zip(qpos, rng.normal(size=qvel.shape) * np.where(free, 1e-3, 5e-4), strict=True):
            mujoco.mj_integratePos(model, row, error, 1.0)
        qvel = qvel + rng.normal(size=qvel.shape) * np.where(free, 2e-2, 1e-2)
    names = ["time", *(name for some in state_columns(model) for name in some), *control_columns(model)]
    values = np.column_stack([rows["time"], qpos, qvel, motion_of(table)(rows["time"])])
    return "\n".join([",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in values), ""])


def main(words: Sequence[str]) -> None:
    """Entry point of the process."""
    with cli_errors():
        if words[0] == "measure":
            measure(words[1], Path(words[2]), int(words[3]), "--exact" in words[4:])
        else:
            oracle(words[1], Path(words[2]), int(words[3]), Budget(**read_json(Path(words[4]))))


if __name__ == "__main__":
    main(sys.argv[1:])
