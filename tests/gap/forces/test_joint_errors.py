"""Errors of predictions by joint."""

import mujoco
import numpy as np

from btr_mjx.gap.forces import joint_errors


def test_errors_by_joint_are_those_of_a_loop_each_in_its_unit() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="torso"><freejoint/><geom size=".1"/>
        <body name="arm"><joint name="turn"/><geom size=".1"/><body><joint name="slide" type="slide"/><geom size=".1"/>
        <body><joint name="ball" type="ball"/><geom size=".1"/></body></body></body></body></worldbody></mujoco>"""
    )
    rng = np.random.default_rng(0)
    before, after = rng.uniform(size=(2, 7, model.nv))
    sigma = rng.uniform(size=2 * model.nv)
    found = joint_errors(model, (before, after), sigma)
    expected = [
        ("position of body torso", "m", [0, 1, 2]),
        ("orientation of body torso", "rad", [3, 4, 5]),
        ("joint turn", "rad", [6]),
        ("joint slide", "m", [7]),
        ("joint ball", "rad", [8, 9, 10]),
    ]
    assert [(row.joint, row.unit) for row in found] == [row[:2] for row in expected]
    for row, (_, _, dofs) in zip(found, expected, strict=True):
        for value, squares in ((row.before, before), (row.after, after), (row.noise, sigma[None] ** 2)):
            every = [squares[w, dof] for w in range(len(squares)) for dof in dofs]
            np.testing.assert_allclose(value, (sum(every) / len(every)) ** 0.5)


def test_joints_that_are_not_measured_have_no_errors() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/><geom size=".1"/></body>
        </body></worldbody></mujoco>"""
    )
    errors = np.ones((3, 2))
    found = joint_errors(model, (errors, errors), np.array([0.1, np.nan, 0.1, 0.1]))
    assert [row.joint for row in found] == ["joint a"]
