"""The time step of residuals, and its correction."""

import numpy as np
import pytest
from gap_arm import SIGMA, arm, recording

from btr_mjx.gap.simulate import Counter, World, simulate
from btr_mjx.gap.windows import Span, Windows, linearise, prepare, project
from btr_mjx.gap.windows.time_steps import choose_time_step


def short_steps(step=5e-4, sigma=5 * SIGMA, first=(10, 150), k=30):
    model = arm()
    model.opt.timestep = step
    data = prepare([recording("r", seed=3, believed=model)], "cubic", sigma, Span(5, 6))
    return Windows(data, np.zeros(len(first), int), np.array(first), k, Counter())


def test_longer_step_gives_the_same_corrected_residual() -> None:
    """Residuals are corrected to those of steps of 1e-4 s."""
    windows = short_steps()
    linearise(windows, World.of)
    assert windows.step == 2 * windows.dt == 1e-3
    own = np.arange(len(windows))
    start = windows.segments(own, windows.qpos, windows.qvel, windows.since)
    exact = project(windows.whiten(simulate([(World.of(arm()), start)], timestep=1e-4)[0]), windows.basis)
    plain = project(windows.whiten(windows.base), windows.basis)
    assert np.linalg.norm(plain - exact) > 1.0  # the correction is not negligible
    assert np.linalg.norm(windows.residual - exact) < 0.03 * np.linalg.norm(plain - exact)


def test_longer_step_halves_the_cost() -> None:
    windows = short_steps()
    linearise(windows, World.of)
    before = windows.counter.steps
    windows.states([lambda model: World.of(model)])  # not cached
    coarse = windows.counter.steps - before
    windows.states([lambda model: World.of(model)], timestep=windows.dt)
    assert windows.counter.steps - before - coarse == 2 * coarse > 0


def test_signatures_are_the_same_with_both_steps() -> None:
    def damped(model):
        world = World.of(model)
        world.model.dof_damping[:] += 0.02
        return world

    windows = short_steps()
    linearise(windows, World.of)
    changes = []
    for step in (windows.dt, 2 * windows.dt):
        windows.step = step
        changes.append(windows.whiten(windows.states([damped])[0]) - windows.whiten(windows.states([World.of])[0]))
    assert np.linalg.norm(changes[0]) > 1
    assert np.linalg.norm(changes[1] - changes[0]) < 0.02 * np.linalg.norm(changes[0])


@pytest.mark.parametrize(
    ("step", "sigma", "k"),
    [(1e-3, 5 * SIGMA, 30), (5e-4, 0.1 * SIGMA, 30)],
    ids=["long enough", "sensors see what it does"],
)
def test_step_is_not_doubled_if_its_error_exceeds_noise(step, sigma, k) -> None:
    windows = short_steps(step, sigma, k=k)
    linearise(windows, World.of)
    assert windows.step == windows.dt == step


def test_step_is_at_most_the_sample_interval() -> None:
    windows = short_steps()
    windows.since = windows.since / 8  # 1600 Hz
    choose_time_step(windows, World.of)
    assert windows.step == windows.dt
