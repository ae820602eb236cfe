"""Hidden cases for demonstrations: an effect of the library, drawn from a seed, and the errors of a calibration.

Reality is the believed model with the hidden effect, and with small errors of every number that calibration leaves
uncertain, simulated at a time step of 1e-4 s by the implicit integrator. Cases whose physics share no code with the
library are in benchmarks/hidden_cases.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.demo.robots import DemoRobot, MotionCommand, demo_robot
from btr_mjx.errors import InputError
from btr_mjx.gap.data import DatasetDescription, Recording, save_dataset
from btr_mjx.gap.effects import EFFECTS, Candidate, Scales, candidates
from btr_mjx.gap.fitness_only import save_fitness
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.models import integrate, part_names

_FIT, _TEST = 8, 4
"""Numbers of recordings to fit and held out."""
_TRIALS = 45, 15
"""Numbers of trials to fit and held out."""
_RATE = 400
"""Samples per second."""
_TIMESTEP = 1e-4
"""Time step of reality [s]."""
_STEPS = 4.0, 12.0
"""Sizes of hidden effects, in steps that are visible above the noise, see `Parameter.step`."""


def make_demo(folder: str | Path, seed: int, robot: str = "hexapod") -> dict[str, Any]:
    """Draw a case and write its recordings.

    Args:
      folder: folder of the dataset.
      seed: seed of everything that is drawn.
      robot: hexapod, pendulum, quadruped or arm.

    Returns:
      The truth: robot, seed, and `effects` with their places and values.

    Raises:
      InputError: a robot that does not exist.
    """
    machine, rng = demo_robot(robot), np.random.default_rng([seed, 17])
    model = machine.model
    motions = [machine.draw_motion(rng) for _ in range(_FIT + _TEST)]
    world, hidden = _hidden_world(machine, motions[0], rng)
    time, states = _moved(world, machine, motions)
    sigma_q, sigma_v = machine.sigma(model)
    recordings = []
    for i, (motion, rows) in enumerate(zip(motions, states, strict=True)):
        qpos, qvel = rows[:, : model.nq], rows[:, model.nq :]
        recordings.append(
            Recording(
                name=f"behaviour_{i + 1:02d}",
                time=time,
                ctrl=motion(time),
                qpos=integrate(model, qpos, rng.normal(size=qvel.shape) * sigma_q),
                qvel=qvel + rng.normal(size=qvel.shape) * sigma_v,
                qvel_measured=np.ones(model.nv, bool),
                split="fit" if i < _FIT else "test",
                model=model,
            )
        )
    save_dataset(folder, machine.xml, recordings, DatasetDescription(interpolation="cubic"))
    return {"robot": robot, "seed": seed, "effects": [hidden]}


def make_fitness_demo(folder: str | Path, seed: int, robot: str = "hexapod") -> dict[str, Any]:
    """Draw a case and write its table of trials.

    Controllers are r_i = a_i sin(omega t + phi_i) with random amplitudes a_i in [0.13, 0.314] rad and phases phi_i in
    [0, pi]; omega is the robot's `tempo`.

    Args:
      folder: folder of the dataset.
      seed: seed of everything that is drawn.
      robot: hexapod or quadruped, which walk.

    Returns:
      The truth, see `make_demo`.

    Raises:
      InputError: a robot that does not exist, or one with a fixed base.
    """
    machine, rng = demo_robot(robot), np.random.default_rng([seed, 29])
    if machine.base is None:
        raise InputError(f"robot {robot!r}: it is bolted down and comes nowhere; expected one that walks")
    model = machine.model
    shape = (sum(_TRIALS), model.nu)
    amplitude, phase = rng.uniform(0.13, 0.314, shape), rng.uniform(0, np.pi, shape)

    def motion(k: int) -> MotionCommand:
        return lambda t: amplitude[k] * np.sin(machine.tempo * t[:, None] + phase[k])

    motions = [motion(k) for k in range(len(amplitude))]
    world, hidden = _hidden_world(machine, motions[0], rng)
    base = int(model.jnt_qposadr[model.body_jntadr[model.body(machine.base).id]])
    places = _moved(world, machine, motions)[1][..., base : base + 2]
    columns: dict[str, np.ndarray] = {}
    for i, name in enumerate(part_names(model, "actuator")):
        columns |= {f"amplitude/{name}": amplitude[:, i], f"phase/{name}": phase[:, i]}
    columns["fitness"] = np.linalg.norm(places[:, -1] - places[:, 0], axis=1) / machine.duration
    columns["split"] = np.repeat(["fit", "test"], _TRIALS)
    about = {"body": machine.base, "function": "distance", "duration": machine.duration, "omega": machine.tempo}
    save_fitness(folder, machine.xml, about, columns)
    return {"robot": robot, "seed": seed, "effects": [hidden]}


def _hidden_world(
    machine: DemoRobot, motion: MotionCommand, rng: np.random.Generator
) -> tuple[World, Mapping[str, Any]]:
    """Reality, and the effect that it has: name, location, and values by parameter."""
    model = machine.model
    time, (rows,) = _moved(World.of(model), machine, [motion])
    some = slice(None, None, 4)
    scales = Scales.measured(model, rows[some, : model.nq], rows[some, model.nq :], motion(time)[some])
    everything = candidates(model, scales, EFFECTS)
    world = World.of(model)
    world.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    for one in everything:
        tolerance = np.array([parameter.tolerance for parameter in one.parameters])
        if tolerance.any() and not one.place.members:
            one.apply(world, one.null + tolerance * rng.normal(size=len(tolerance)))
    usable = [one for one in everything if _is_usable(one)]
    name = str(rng.choice(sorted({one.effect.name for one in usable})))
    there = [one for one in usable if one.effect.name == name]
    hidden = there[int(rng.integers(len(there)))]
    values = _drawn_values(hidden, rng)
    hidden.apply(world, values)
    named = {parameter.name: float(v) for parameter, v in zip(hidden.parameters, values, strict=True)}
    return world, {"effect": name, "location": hidden.place.label, "parameters": named}


def _is_usable(one: Candidate) -> bool:
    """A longer leg would start inside the ground; a limit that is not reached hides nothing; one number is enough."""
    return one.effect.name != "link_length" and not one.effect.saturates and not one.place.parts


def _drawn_values(hidden: Candidate, rng: np.random.Generator) -> np.ndarray:
    """Values (p,) of an effect that is visible: larger than at its null, or on either side where it may be both."""
    out = hidden.null
    for i, parameter in enumerate(hidden.parameters):
        size = float(np.exp(rng.uniform(*np.log(_STEPS)))) * parameter.step
        sign = rng.choice([-1, 1])
        if not parameter.shape:
            both = parameter.low < out[i] - abs(size) and out[i] + abs(size) < parameter.high
            out[i] = np.clip(out[i] + (sign * size if both else size), parameter.low, parameter.high)
    return out


def _moved(world: World, machine: DemoRobot, motions: Sequence[MotionCommand]) -> tuple[np.ndarray, np.ndarray]:
    """Sample times (K,) [s], and states (motions, K, nq + nv) as encoders without noise report them."""
    model, time = world.model, np.arange(round(_RATE * machine.duration) + 1) / _RATE
    dense, count = np.arange(0.0, machine.duration + 0.01, 5e-4), len(motions)
    commands = tuple(Command(dense, motion(dense), "cubic") for motion in motions)
    start = np.tile(model.qpos0, (count, 1)), np.zeros((count, model.nv))
    segments = Segments(np.zeros(count), *start, time, commands, np.arange(count))
    return time, simulate([(world, segments)], timestep=_TIMESTEP)[0]
