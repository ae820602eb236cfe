"""Hidden cases with fitness only: a table of controllers and their fitness in a hidden reality."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from btr_mjx.demo import MotionCommand
from btr_mjx.errors import InputError
from btr_mjx.gap.fitness_only import save_fitness
from btr_mjx.gap.results import Verdict
from btr_mjx.models import part_names
from hidden_cases.case_sampling import Draw
from hidden_cases.cases import Truth, draw_reality
from hidden_cases.motion import Loads, peak_loads, simulate_reality
from hidden_cases.robots import CaseRobot, case_robot

_FIT, _TEST = 45, 15
"""Numbers of trials to fit and held out."""


@dataclass(frozen=True)
class FitnessCaseSettings:
    """Settings of a case.

    Attributes:
      verdict: kind of case.
      effects: number of missing effects, or their names.
      trials: numbers of trials to fit and held out.
      duration: duration of a trial [s]; None for the robot's own.
      background: factor on the small errors of calibration.
      controllers: seed of the controllers alone, for several realities with the same controllers; None draws them
        with everything else.
    """

    verdict: Verdict = "effect"
    effects: Sequence[str] | int = 1
    trials: tuple[int, int] = (_FIT, _TEST)
    duration: float | None = None
    background: float = 1.0
    controllers: int | None = None


def make_fitness_case(
    folder: str | Path, seed: int, robot: str = "hexapod", settings: FitnessCaseSettings = FitnessCaseSettings()
) -> Truth:
    """Draw a case and write its table of trials.

    Controllers are r_i = a_i sin(omega t + phi_i) with random amplitudes a_i in [0.13, 0.314] rad and phases phi_i in
    [0, pi]; omega is the robot's `tempo`.

    Args:
      folder: folder of the dataset.
      seed: seed of everything that is drawn.
      robot: name of a case robot with a free base.
      settings: settings that are not drawn.

    Returns:
      The truth.

    Raises:
      InputError: see `make_case`; a robot with a fixed base.
    """
    machine = case_robot(robot)
    if machine.base is None:
        raise InputError(f"robot {robot!r}: it is bolted down and comes nowhere; expected one that walks")
    model, rng = machine.model, np.random.default_rng([seed, 29])
    span, count = settings.duration or machine.duration, sum(settings.trials)
    drive = rng if settings.controllers is None else _rng_of(settings.controllers)
    amplitude, phase, motions = _controllers(machine, drive, count)
    draw = Draw(machine, rng, motions, peak_loads(machine, motions[:3]))
    reality, missing, outside = draw_reality(draw, settings.verdict, settings.effects, None, settings.background)
    base = int(model.jnt_qposadr[model.body_jntadr[model.body(machine.base).id]])
    fitness = []
    for one in motions:
        qpos = simulate_reality(reality, one, span, 1.0 / span)["qpos"]
        fitness.append(float(np.linalg.norm(qpos[-1, base : base + 2] - qpos[0, base : base + 2])) / span)
    names = part_names(model, "actuator")
    columns = {f"amplitude/{n}": amplitude[:, i] for i, n in enumerate(names)}
    columns |= {f"phase/{n}": phase[:, i] for i, n in enumerate(names)}
    columns |= {"fitness": np.array(fitness), "split": np.repeat(["fit", "test"], settings.trials)}
    about = {"body": machine.base, "function": "distance", "duration": span, "omega": machine.tempo}
    save_fitness(folder, machine.xml, about, columns)
    return Truth(robot, seed, settings.verdict, missing, outside, 0, 0.0)


def case_draw(robot: str, seed: int, controllers: int) -> Draw:
    """The draw of `make_fitness_case` before the missing effect, without a simulation of its trials.

    Args:
      robot: name of a case robot with a free base.
      seed: seed of the case.
      controllers: seed of the controllers.

    Returns:
      The draw, ready for `draw_reality`.
    """
    machine = case_robot(robot)
    motions = _controllers(machine, _rng_of(controllers), _FIT + _TEST)[2]
    return Draw(machine, np.random.default_rng([seed, 29]), motions, _loads(robot, controllers))


@cache
def _loads(robot: str, controllers: int) -> Loads:
    machine = case_robot(robot)
    return peak_loads(machine, _controllers(machine, _rng_of(controllers), _FIT + _TEST)[2][:3])


def _rng_of(controllers: int) -> np.random.Generator:
    return np.random.default_rng([controllers, 31])


def _controllers(
    machine: CaseRobot, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, list[MotionCommand]]:
    """Amplitudes and phases (count, nu) [rad], and the motions."""
    nu = machine.model.nu
    amplitude, phase = rng.uniform(0.13, 0.314, (count, nu)), rng.uniform(0, np.pi, (count, nu))

    def motion(k: int) -> MotionCommand:
        return lambda t: amplitude[k] * np.sin(machine.tempo * t[:, None] + phase[k])

    return amplitude, phase, [motion(k) for k in range(count)]
