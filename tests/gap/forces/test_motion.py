"""Linearised motion against long simulations of single intervals in plain MuJoCo."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, XML, arm
from gap_forces import believed, exact_stretch, moved_arm
from gap_models import one

from btr_mjx.gap.forces.motion import FreeNumber, Linearised, ends, linearise_motion, pushes, time_step
from btr_mjx.gap.forces.stretches import Stretches
from btr_mjx.gap.simulate import Counter, World

FINE = 2.5e-5


@pytest.fixture(scope="module")
def stretches() -> Stretches:
    """One stretch of exact states."""
    recording = moved_arm("r", 2, noise=0.0, seconds=0.5, step=2e-5)
    return exact_stretch(recording, 20, 60)


@pytest.fixture(scope="module")
def linear(stretches) -> Linearised:
    return linearise_motion(stretches, believed())


def end(
    stretches: Stretches,
    k: int,
    change: Callable[[mujoco.MjModel], None] | None = None,
    shift: np.ndarray | float = 0.0,
    force: np.ndarray | float = 0.0,
    step: float = FINE,
) -> np.ndarray:
    """State (4,) at the end of an interval, simulated with very small steps, or the believed model with others."""
    model = arm()
    model.opt.timestep = step
    if step == FINE:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    if change is not None:
        change(model)
    data = mujoco.MjData(model)
    start = np.concatenate([stretches.qpos[0, k], stretches.qvel[0, k]]) + shift
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = start[:2], start[2:], force
    first, last = stretches.time[0, k : k + 2]
    for i in range(round((last - first) / step)):
        data.ctrl[:] = stretches.data.commands[0].at(first + i * step)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


SAMPLES = (3, 18, 31, 47)


def test_transitions_and_forces_are_derivatives_of_the_motion(stretches, linear):
    """They are those of a motion that is simulated finely, although servos damp a link within 20 ms."""
    for k in SAMPLES:
        plain = end(stretches, k)
        for i, size in enumerate((1e-3, 1e-3, 1e-2, 1e-2)):
            moved = (end(stretches, k, shift=size * np.eye(4)[i]) - plain) / size
            np.testing.assert_allclose(linear.transition[0, k, :, i], moved, atol=0.02 * np.abs(moved).max())
        for j in range(2):
            pushed = (end(stretches, k, force=0.1 * np.eye(2)[j]) - plain) / 0.1
            for rows in (slice(0, 2), slice(2, 4)):
                size = np.abs(pushed[rows]).max()
                np.testing.assert_allclose(linear.force[0, k, rows, j], pushed[rows], atol=0.02 * size)


def adding(field: str, index: int, value: float) -> Callable[[mujoco.MjModel], None]:
    def change(model: mujoco.MjModel) -> None:
        getattr(model, field)[index] += value

    return change


def stronger(actuator: int, change: float, damping: float = 0.0) -> Callable[[mujoco.MjModel], None]:
    def of(model: mujoco.MjModel) -> None:
        model.dof_damping[actuator] += damping
        model.actuator_gainprm[actuator] *= 1 + change
        model.actuator_biasprm[actuator] *= 1 + change

    return of


NUMBERS = (
    ("viscous_damping@joint:elbow", 0.02, adding("dof_damping", 1, 0.02)),
    ("armature@joint:shoulder", 0.002, adding("dof_armature", 0, 0.002)),
    ("dry_friction@joint:shoulder", 0.05, adding("dof_frictionloss", 0, 0.05)),
    ("actuator_gain@actuator:shoulder", 0.01, stronger(0, 0.01)),
)


def test_columns_are_derivatives_of_the_motion(stretches, linear):
    """They are those of a motion that is simulated finely, except where a joint turns round: friction is not smooth."""
    numbers = [FreeNumber(one(arm(), name, LIBRARY), 0, (0.0,), step) for name, step, _ in NUMBERS]
    found = linear.responses(pushes(linear, believed(), numbers))
    assert found.shape == (1, 60, 4, len(NUMBERS))
    steady = [k for k in range(2, 60, 7) if np.abs(stretches.qvel[0, k : k + 2]).min() > 0.3]
    assert len(steady) >= 4
    for c, (_, size, change) in enumerate(NUMBERS):
        fine = np.array([(end(stretches, k, change) - end(stretches, k)) / size for k in steady])
        for rows in (slice(0, 2), slice(2, 4)):
            np.testing.assert_allclose(
                found[0, steady, rows, c], fine[:, rows], atol=0.03 * np.abs(fine[:, rows]).max()
            )


def test_effects_beside_others_are_columns_beside_them(stretches):
    """The column of a gain of 1.2 at an elbow with more damping, each where it is."""
    damping = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    gain = one(arm(), "actuator_gain@actuator:elbow", LIBRARY)
    number, damped = FreeNumber(gain, 0, (0.2,), 0.01), believed().with_effect(damping, [0.1])
    beside = linearise_motion(stretches, damped.with_effect(gain, [0.2]))
    found = beside.responses(pushes(beside, damped, [number]))[..., 0]
    changed, plain = stronger(1, 0.21, 0.1), stronger(1, 0.2, 0.1)
    expected = np.array([(end(stretches, k, changed) - end(stretches, k, plain)) / 0.01 for k in SAMPLES])
    np.testing.assert_allclose(found[0, SAMPLES], expected, atol=0.03 * np.abs(expected).max())
    plain_motion = linearise_motion(stretches, believed())
    alone = plain_motion.responses(pushes(plain_motion, believed(), [replace(number, at=(0.0,))]))
    assert np.abs(found - alone[..., 0]).max() > 0.1


def test_pushes_serve_beside_another_rotor(stretches, linear):
    """Damping brakes a joint with a heavy rotor by less; the force with which it brakes is the same."""
    damping = FreeNumber(one(arm(), "viscous_damping@joint:elbow", LIBRARY), 0, (0.0,), 0.02)
    heavy = believed().with_effect(one(arm(), "armature@joint:elbow", LIBRARY), [0.05])
    beside = linearise_motion(stretches, heavy)
    kept, anew = (
        own.responses(pushes(*of, [damping])) for own, of in ((beside, (linear, believed())), (beside, (beside, heavy)))
    )
    old = linear.responses(pushes(linear, believed(), [damping]))
    size = np.abs(anew).max((0, 1, 3))
    assert (np.abs(kept - anew).max((0, 1, 3)) < 0.01 * size)[[1, 3]].all()
    assert (np.abs(old - anew).max((0, 1, 3)) > 0.5 * size)[[1, 3]].all()


def test_nothing_is_left_of_the_motion_of_the_model_itself(stretches, linear):
    """Of exact states, a tenth of the error of a plain simulation is left at most; an effect leaves what it does."""
    plain = ends(stretches, [believed()])[0] - np.concatenate([stretches.qpos, stretches.qvel], -1)[:, 1:]
    for rows in (slice(0, 2), slice(2, 4)):
        assert np.abs(linear.defect[..., rows]).max() < 0.1 * np.abs(plain[..., rows]).max()
    friction = one(arm(), "viscous_damping@joint:elbow", LIBRARY)
    other = linearise_motion(stretches, believed().with_effect(friction, [0.05]), known=linear)
    assert other.transition is linear.transition
    expected = np.array([end(stretches, k) - end(stretches, k, adding("dof_damping", 1, 0.05)) for k in SAMPLES])
    np.testing.assert_allclose(other.defect[0, SAMPLES, 2:], expected[:, 2:], atol=0.03 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.05


def test_errors_of_time_steps_are_of_second_order():
    """Half a step, a quarter of the error; of a plain simulation half of it."""
    errors, plain = [], []
    recording = moved_arm("r", 2, noise=0.0, seconds=0.5, step=5e-6)
    for step in (2.5e-3, 1.25e-3):
        model = mujoco.MjModel.from_xml_string(XML.replace('timestep="0.002"', f'timestep="{step}"'))
        own = exact_stretch(replace(recording, model=model), 20, 60)
        assert time_step(model, np.diff(own.time)) == pytest.approx(step)
        assert time_step(model, np.diff(own.time), 0.5) == pytest.approx(step / 2)
        away = linearise_motion(own, believed()).defect, ends(own, [believed()])[0][..., 2:] - own.qvel[:, 1:]
        errors.append(np.sqrt(np.mean(away[0][..., 2:] ** 2)))
        plain.append(np.sqrt(np.mean(away[1] ** 2)))
    assert plain[0] / plain[1] == pytest.approx(2, abs=0.4)
    assert errors[0] / errors[1] == pytest.approx(4, abs=1)
    assert plain[1] > 10 * errors[1]


def test_time_steps_divide_intervals():
    model = arm()
    for interval in (0.003, 0.004, 0.005, 0.02, 1 / 60):
        for factor in (0.5, 1.0):
            step = time_step(model, np.full((2, 5), interval), factor)
            assert interval / step == pytest.approx(round(interval / step))
            assert step <= factor * model.opt.timestep * 1.001
        half, whole = time_step(model, np.full(5, interval), 0.5), time_step(model, np.full(5, interval))
        assert whole / half == pytest.approx(2)  # what extrapolation needs
    assert time_step(model, np.array([0.004, 0.004, 0.3]), 1.0) == pytest.approx(0.002)  # a gap in a recording


def test_no_interval_diverges_however_wrong_the_model(stretches):
    """Simulations start at measured states: gains a thousand times too large leave finite, if large, defects."""

    def wild(model):
        world = World.of(model)
        world.model.actuator_gainprm[:, 0] *= -1e3
        world.model.actuator_biasprm[:, 1] *= -1e3
        return world

    counter = Counter()
    found = linearise_motion(stretches, wild, counter)
    assert np.isfinite(found.defect).all()
    assert np.isfinite(found.transition).all()
    assert counter.steps > 0
