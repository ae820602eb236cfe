"""Hidden cases of which only fitness is known: a table of controllers and what they came to in a hidden reality."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.fitness_only import save_fitness
from btr_mjx.models import part_names
from btr_mjx.testing.cases import Truth, Verdict, draw_reality
from btr_mjx.testing.draw import Draw
from btr_mjx.testing.motion import Loads, loads, simulate
from btr_mjx.testing.robots import CaseRobot, Motion, case_robot

FIT, TEST = 45, 15
"""Trials to fit and held out."""


def make_fitness_case(
    folder: str | Path,
    seed: int,
    robot: str = "hexapod",
    *,
    verdict: Verdict = "effect",
    effects: Sequence[str] | int = 1,
    trials: tuple[int, int] = (FIT, TEST),
    duration: float | None = None,
    background: float = 1.0,
    controllers: int | None = None,
) -> Truth:
    """Draw a case and write its table of trials.

    Controllers are r_i = a_i sin(omega t + phi_i), with random amplitudes and phases, at the robot's own tempo.

    Args:
      folder: the dataset's folder.
      seed: of everything that is drawn.
      robot: name of a case robot that walks.
      verdict: kind of case.
      effects: number of missing effects, or their names.
      trials: numbers of trials to fit and held out.
      duration: of a trial [s]; None for the robot's own.
      background: factor on the small errors everywhere.
      controllers: seed of the controllers alone, for several realities that are tried with the same ones; None draws
        them with everything else.

    Returns:
      The answer.

    Raises:
      InputError: see `cases.make_case`; a robot that is bolted down.
    """
    machine = case_robot(robot)
    if machine.base is None:
        raise InputError(f"robot {robot!r}: it is bolted down and comes nowhere; expected one that walks")
    model, rng = machine.model, np.random.default_rng([seed, 29])
    span, count = duration or machine.duration, sum(trials)
    drive = rng if controllers is None else _rng_of(controllers)
    amplitude, phase, motions = _controllers(machine, drive, count)
    draw = Draw(machine, rng, motions, loads(machine, motions[:3]))
    reality, missing, outside = draw_reality(draw, verdict, effects, None, background)
    base = int(model.jnt_qposadr[model.body_jntadr[model.body(machine.base).id]])
    fitness = []
    for one in motions:
        qpos = simulate(reality, one, span, 1.0 / span)["qpos"]
        fitness.append(float(np.linalg.norm(qpos[-1, base : base + 2] - qpos[0, base : base + 2])) / span)
    names = part_names(model, "actuator")
    columns = {f"amplitude/{n}": amplitude[:, i] for i, n in enumerate(names)}
    columns |= {f"phase/{n}": phase[:, i] for i, n in enumerate(names)}
    columns |= {"fitness": np.array(fitness), "split": np.repeat(["fit", "test"], trials)}
    about = {"body": machine.base, "function": "distance", "duration": span, "omega": machine.tempo}
    save_fitness(folder, machine.xml, about, columns)
    return Truth(robot, seed, verdict, missing, outside, 0, 0.0)


def case_draw(robot: str, seed: int, controllers: int) -> Draw:
    """What `make_fitness_case` draws an effect from, without simulating its trials.

    Args:
      robot: name of a case robot that walks.
      seed: of the case.
      controllers: seed of the controllers.
    """
    machine = case_robot(robot)
    motions = _controllers(machine, _rng_of(controllers), FIT + TEST)[2]
    return Draw(machine, np.random.default_rng([seed, 29]), motions, _loads(robot, controllers))


@cache
def _loads(robot: str, controllers: int) -> Loads:
    machine = case_robot(robot)
    return loads(machine, _controllers(machine, _rng_of(controllers), FIT + TEST)[2][:3])


def _rng_of(controllers: int) -> np.random.Generator:
    return np.random.default_rng([controllers, 31])


def _controllers(
    machine: CaseRobot, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, list[Motion]]:
    """Amplitudes and phases (count, nu) [rad], and the motions."""
    nu = machine.model.nu
    amplitude, phase = rng.uniform(0.13, 0.314, (count, nu)), rng.uniform(0, np.pi, (count, nu))

    def motion(k: int) -> Motion:
        return lambda t: amplitude[k] * np.sin(machine.tempo * t[:, None] + phase[k])

    return amplitude, phase, [motion(k) for k in range(count)]
