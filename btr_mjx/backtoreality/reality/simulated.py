"""Interface of realities, which measure f_r, and a simulated reality.

Any object with a `measure` method is a reality: a robot, a file of measurements, a simulation. `SimulatedReality` is a
hidden simulation s_r. With the engine of the searches, Theorems 1 and 2 hold exactly; with native MuJoCo in float64 and
another time step and integrator, reality does not share the simulator's numerical errors (no inverse crime).
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from btr_mjx.backtoreality.reality.imu_readings import imu_readings
from btr_mjx.errors import InputError
from btr_mjx.evaluation import Engine, EngineSettings, FitnessLike, evaluate, fitness_at_marks, fitness_of
from btr_mjx.gap.data import Recording
from btr_mjx.models import base_model
from btr_mjx.robots import Robot


class Reality(Protocol):
    """An object in which controllers can be tried."""

    def measure(self, controllers: np.ndarray, trial: int, times: tuple[float, ...]) -> np.ndarray:
        """Try controllers once each.

        Args:
          controllers: (m, n_c).
          trial: number of evaluations made before, from which the noise is seeded.
          times: K ascending times [s], the last one T_e.

        Returns:
          (m, K) fitness as if the trial had ended at each time; the last column is f_r. NaN for a trial that failed.
        """
        ...


@dataclass(frozen=True)
class SimulatedReality:
    """A hidden simulation in place of reality.

    Attributes:
      robot: the robot; its template may differ from that of the searches.
      truth: s_r, one value per parameter of S.
      engine: engine that runs it; None for the fastest.
      settings: time step, integrator, ... of that engine.
      fitness: see `evaluate`.
      noise: standard deviation of the relative error of a measured fitness, 0.05 = 5 %.
      seed: of the noise.
      recording_rate: samples per second of recordings.
      told: (n_s,) true values of the parameters of S, NaN where a model of its own has none; None for `truth`.
    """

    robot: Robot
    truth: tuple[float, ...]
    engine: Engine | None = None
    settings: EngineSettings = field(default_factory=EngineSettings)
    fitness: FitnessLike | None = None
    noise: float = 0.0
    seed: int = 0
    recording_rate: float = 400.0
    told: tuple[float, ...] | None = None

    @property
    def true_values(self) -> np.ndarray:
        """(n_s,) true values of the parameters of S, with which results are compared; NaN where they are not told."""
        return np.array(self.truth if self.told is None else self.told)

    def __post_init__(self) -> None:
        self.robot.simulation_box.validate(self.truth, "hidden simulation")
        if not 0 <= self.noise < np.inf:
            raise InputError(f"noise: got {self.noise}, expected a relative standard deviation of 0 or more")

    def measure(self, controllers: ArrayLike, trial: int = 0, times: tuple[float, ...] | None = None) -> np.ndarray:
        """Try controllers once each; see `Reality.measure`. Without times, only the end of the trial is measured."""
        fitness = fitness_of(self.robot, self.fitness)
        trials = evaluate(
            self.robot,
            [self.truth],
            controllers,
            engine=self.engine,
            fitness=fitness,
            settings=self.settings,
            times=times,
        )
        values = np.where(trials.diverged[0, :, None], np.nan, fitness_at_marks(trials.outcome, fitness)[0])
        if not self.noise:
            return values
        # One random generator per trial: the noise does not depend on how trials are grouped into calls. The noise at
        # the end of the trial is drawn first, so that it does not depend on the other times.
        draws = [np.random.default_rng([self.seed, trial + k]).normal(size=values.shape[1]) for k in range(len(values))]
        return values * (1.0 + self.noise * np.array(draws)[:, ::-1])

    def record(self, controllers: ArrayLike, trials: ArrayLike) -> list[Recording]:
        """Recordings of trials, with the noise of good sensors, and with the IMUs that the model has.

        Args:
          controllers: (m, n_c).
          trials: (m,) their numbers, from which the noise is seeded.

        Returns:
          One recording for each trial that did not diverge. Motors hold the robot's signal over every time step, so
          that recorded commands are half a step late.
        """
        model = base_model(self.robot)
        step = self.settings.timestep or float(model.opt.timestep)
        late, interval = 0.5 * step, step * max(1, round(1 / (self.recording_rate * step)))  # samples are at steps
        count = int(self.robot.duration / interval + 1e-6)
        times = interval * np.arange(1, count + 1)
        rows = np.atleast_2d(np.asarray(controllers, float))
        how: dict[str, Any] = {"engine": "native", "fitness": self.fitness, "settings": self.settings}
        found = evaluate(self.robot, [self.truth], rows, **how, times=times, states=True)
        assert found.outcome.qpos is not None
        assert found.outcome.qvel is not None
        sigma = np.array([_SIGMA[int(model.jnt_type[j]) == 0] for j in model.dof_jntid])
        out = []
        for i, trial in enumerate(np.asarray(trials).tolist()):
            if found.diverged[0, i]:
                continue
            rng = np.random.default_rng([self.seed, 11, trial])
            qpos = found.outcome.qpos[0, i].copy()
            for k, error in enumerate(rng.normal(size=(count, model.nv)) * sigma[:, 0]):
                mujoco.mj_integratePos(model, qpos[k], error, 1.0)
            qvel = found.outcome.qvel[0, i] + rng.normal(size=(count, model.nv)) * sigma[:, 1]
            ctrl = np.stack([self.robot.signal(rows[i][:, None], t - late, np)[:, 0] for t in times])
            sensor, seen = imu_readings(model, times, found.outcome.qpos[0, i], rng), np.ones(model.nv, bool)
            out.append(Recording(f"trial {trial}", times, ctrl, qpos, qvel, seen, "fit", model, sensor=sensor))
        return out


_SIGMA = (5e-4, 1e-2), (1e-3, 2e-2)
"""Standard deviations of recorded positions and velocities [rad, m, per s]: of joints, and of a free body."""
