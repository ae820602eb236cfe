"""Evaluation of behaviours: fitness at the marks of the multiscale distance, and at the end of a trial."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from common import Config
from units import Step

from btr_mjx.evaluation import FITNESS_FUNCTIONS, EngineSettings, evaluate, fitness_at_marks
from btr_mjx.robots import Robot, hexapod


@dataclass(frozen=True)
class Bench:
    """Robot, engine and sample times with which behaviours are evaluated.

    Attributes:
      robot: the robot, with the experiment's duration.
      engine: the engine, None for the fastest.
      marks: marks of the multiscale distance [s].
      step: callback of progress, in whole trials.
    """

    robot: Robot
    engine: Any
    marks: tuple[float, ...]
    step: Step

    @classmethod
    def of(cls, config: Config, step: Step) -> "Bench":
        """The bench of an experiment."""
        engine = None if config.engine == "auto" else config.engine
        return cls(dataclasses.replace(hexapod(), duration=config.duration), engine, config.mark_times, step)

    def with_marks_until(self, horizon: float) -> "Bench":
        """A copy with the same number of evenly spaced marks, the last one at `horizon` [s]."""
        count = len(self.marks)
        return dataclasses.replace(self, marks=tuple(np.linspace(horizon / count, horizon, count).tolist()))

    def early(self, simulations: np.ndarray, controllers: np.ndarray, settings: EngineSettings | None = None) -> Any:
        """Fitness at the marks (L, M, K) of trials that end at the last mark; NaN where a pair diverged."""
        return self._fitness(simulations, controllers, self.marks, settings)

    def whole(self, simulations: np.ndarray, controllers: np.ndarray, settings: EngineSettings | None = None) -> Any:
        """Fitness at the marks and at T_e, (L, M, K + 1), of whole trials; the last entry is f_s."""
        return self._fitness(simulations, controllers, (*self.marks, self.robot.duration), settings)

    def _fitness(
        self,
        simulations: np.ndarray,
        controllers: np.ndarray,
        times: tuple[float, ...],
        settings: EngineSettings | None,
    ) -> np.ndarray:
        share = times[-1] / self.robot.duration
        evaluation = evaluate(
            self.robot,
            simulations,
            controllers,
            engine=self.engine if settings is None else "native",
            times=times,
            settings=settings or EngineSettings(),
            progress=lambda pairs: self.step(pairs * share),
        )
        return np.where(
            evaluation.diverged[..., None], np.nan, fitness_at_marks(evaluation.outcome, FITNESS_FUNCTIONS["distance"])
        )
