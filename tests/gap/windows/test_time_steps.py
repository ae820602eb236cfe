"""The time step of residuals, and its correction."""

import mujoco
import numpy as np
import pytest
from gap_arm import SIGMA, arm, recording

from btr_mjx.gap.simulate import Counter, World, simulate
from btr_mjx.gap.windows import Span, Windows, linearise, prepare, project
from btr_mjx.gap.windows.time_steps import choose_time_step, step_error


def short_steps(step=5e-4, sigma=5 * SIGMA, first=(10, 150), k=30):
    model = arm()
    model.opt.timestep = step
    data = prepare([recording("r", seed=3, believed=model)], sigma, Span(5, 6))
    return Windows(data, np.zeros(len(first), int), np.array(first), k, Counter())


def test_longer_step_gives_the_same_corrected_residual() -> None:
    """Residuals are corrected to those of steps of 1e-4 s."""
    windows = short_steps()
    windows = linearise(windows, World.of)
    assert windows.step == 2 * windows.dt == 1e-3
    own = np.arange(len(windows))
    start = windows.segments(own, windows.qpos, windows.qvel, windows.since)
    exact = project(windows.whiten(simulate([(World.of(arm()), start)], timestep=1e-4)[0]), windows.basis)
    plain = project(windows.whiten(windows.base), windows.basis)
    assert np.linalg.norm(plain - exact) > 1.0  # the correction is not negligible
    assert np.linalg.norm(windows.residual - exact) < 0.03 * np.linalg.norm(plain - exact)


@pytest.mark.parametrize(
    "integrator", [mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICITFAST], ids=["Euler", "implicit"]
)
def test_corrected_velocities_are_of_second_order(integrator: mujoco.mjtIntegrator) -> None:
    """Those of semi-implicit steps belong to half a step before; the correction moves them to where data have them."""
    plain, corrected = [], []
    for step in (4e-3, 2e-3, 1e-3):
        model = arm()
        model.opt.timestep, model.opt.integrator = step, integrator
        data = prepare([recording("r", seed=3, believed=model)], SIGMA, Span(5, 6))
        windows = Windows(data, np.zeros(2, int), np.array([10, 150]), 30, Counter())
        base, exact = (windows.states([World.of], timestep=t)[0] for t in (step, 1e-4))
        windows.step = step
        off = windows.whiten(base) - windows.whiten(exact)
        errors = (e.reshape(2, 31, 4)[..., 2:] for e in (off, off + step_error(windows, World.of, base)))
        for sizes, error in zip((plain, corrected), errors, strict=True):
            sizes.append(np.sqrt((error**2).mean()))
    assert plain[-1] > 1.0
    np.testing.assert_allclose(np.divide(plain[:-1], plain[1:]), 2.0, rtol=0.15)
    assert (np.divide(corrected[:-1], corrected[1:]) > 3.0).all()
    assert corrected[-1] < 0.02 * plain[-1]


def test_longer_step_halves_the_cost() -> None:
    windows = short_steps()
    windows = linearise(windows, World.of)
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
    windows = linearise(windows, World.of)
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
    windows = linearise(windows, World.of)
    assert windows.step == windows.dt == step


def test_step_is_at_most_the_sample_interval() -> None:
    windows = short_steps()
    windows.since = windows.since / 8  # 1600 Hz
    choose_time_step(windows, World.of)
    assert windows.step == windows.dt
