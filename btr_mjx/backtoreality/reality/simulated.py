"""Where f_r comes from. Anything with a `measure` method is a reality: a robot, a file of measurements, a simulation.

`SimulatedReality` is a hidden simulation s_r. Run by the engine that also searches, it makes Theorems 1 and 2 exact;
run by native MuJoCo in float64 with a time step and an integrator of its own, it is free of the inverse crime.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.errors import InputError
from btr_mjx.evaluation import DISTANCE, Engine, EngineSettings, FitnessFunction, evaluate, fitness_at_marks
from btr_mjx.robots import Robot


class Reality(Protocol):
    """Something controllers can be tried in."""

    def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
        """Try controllers once each.

        Args:
          controllers: (m, n_c).
          trial: how many evaluations were made before; makes noise repeatable after a resume.
          times: K ascending times [s], the last one T_e.

        Returns:
          (m, K) fitness as if the trial had ended at each time; the last column is f_r. NaN for a trial that failed.
        """
        ...


@dataclass(frozen=True)
class SimulatedReality:
    """A hidden simulation in the part of reality.

    Attributes:
      robot: the robot (of which a richer reality may have another template).
      truth: s_r, one value per parameter of S.
      engine: engine that runs it; None for the fastest.
      settings: time step, integrator, ... of that engine.
      fitness: the fitness function.
      noise: standard deviation of the relative error of a measured fitness, 0.05 = 5 %.
      seed: of the noise.
    """

    robot: Robot
    truth: tuple[float, ...]
    engine: Engine | None = None
    settings: EngineSettings = field(default_factory=EngineSettings)
    fitness: FitnessFunction = DISTANCE
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        self.robot.simulation_box.validate(self.truth, "hidden simulation")
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise: got {self.noise}, expected a relative standard deviation of 0 or more")

    def measure(self, controllers: ArrayLike, trial: int = 0, times: tuple[float, ...] | None = None) -> np.ndarray:
        """Try controllers once each; see `Reality.measure`. Without times, the end of the trial alone."""
        trials = evaluate(
            self.robot,
            [self.truth],
            controllers,
            engine=self.engine,
            fitness=self.fitness,
            settings=self.settings,
            times=times,
        )
        values = np.where(trials.diverged[0, :, None], np.nan, fitness_at_marks(trials.outcome, self.fitness)[0])
        if not self.noise:
            return values
        # One stream per trial number: the noise does not depend on how trials are grouped into calls. The end of the
        # trial draws first: asking for more times leaves its noise as it was.
        draws = [np.random.default_rng([self.seed, trial + k]).normal(size=values.shape[1]) for k in range(len(values))]
        return values * (1.0 + self.noise * np.array(draws)[:, ::-1])
