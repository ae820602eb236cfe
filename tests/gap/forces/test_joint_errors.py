"""Errors of predictions by joint."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import make_recording
from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.forces import horizon_errors, joint_errors, noise_errors
from btr_mjx.gap.results import JointError
from btr_mjx.gap.windows import Span, prepare


def test_errors_by_joint_are_those_of_a_loop_each_in_its_unit() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="torso"><freejoint/><geom size=".1"/>
        <body name="arm"><joint name="turn"/><geom size=".1"/><body><joint name="slide" type="slide"/><geom size=".1"/>
        <body><joint name="ball" type="ball"/><geom size=".1"/></body></body></body></body></worldbody></mujoco>"""
    )
    rng = np.random.default_rng(0)
    before, after, noise, step, steady = rng.uniform(size=(5, 7, model.nv))
    found = joint_errors(model, before, after, (noise, step), steady)
    expected = [
        ("position of body torso", "m", [0, 1, 2]),
        ("orientation of body torso", "rad", [3, 4, 5]),
        ("joint turn", "rad", [6]),
        ("joint slide", "m", [7]),
        ("joint ball", "rad", [8, 9, 10]),
    ]
    assert [(row.joint, row.unit) for row in found] == [row[:2] for row in expected]
    for row, (_, _, dofs) in zip(found, expected, strict=True):
        for value, squares in _pairs(row, before, after, noise, step, steady):
            every = [squares[w, dof] for w in range(len(squares)) for dof in dofs]
            np.testing.assert_allclose(value, (sum(every) / len(every)) ** 0.5)


def _pairs(row: JointError, *squares: np.ndarray) -> list[tuple[float | None, np.ndarray]]:
    return list(zip((row.before, row.after, row.noise, row.time_step, row.constant_velocity), squares, strict=True))


def test_joints_that_are_not_measured_have_no_errors() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/><geom size=".1"/></body>
        </body></worldbody></mujoco>"""
    )
    errors = np.ones((3, 2))
    (row,) = joint_errors(model, errors, None, (np.array([[0.1, np.nan]]), errors), errors)
    assert (row.joint, row.after) == ("joint a", None)


def test_what_noise_alone_makes_is_what_a_true_model_errs_by() -> None:
    """A pendulum is recorded with noise: its own model errs as `noise_errors` says, whatever the noise's size."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body><joint name="j" axis="0 1 0"
        damping="0.05"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02"/></body></worldbody></mujoco>"""
    )
    data, states = mujoco.MjData(model), []
    data.qpos[0] = 1.2
    for _ in range(4000):
        states.append(np.r_[data.qpos, data.qvel])
        mujoco.mj_step(model, data)
    true, time = np.array(states)[::5], 0.01 * np.arange(800)
    for size in (1e-3, 1e-2):
        sigma = np.array([size, 10 * size])
        noisy = true + sigma * np.random.default_rng(1).normal(size=true.shape)
        recording = make_recording({"time": time, "qpos/j": noisy[:, 0], "qvel/j": noisy[:, 1]}, model, "here", "swing")
        prepared = prepare([replace(recording, interpolation="linear")], sigma, Span(5))
        believed = Hypothesis((), ())
        (errors,), _ = horizon_errors(prepared, [believed])
        made = noise_errors(prepared, believed)
        assert np.sqrt(errors.mean()) == pytest.approx(np.sqrt(made.mean()), rel=0.15)
