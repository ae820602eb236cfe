"""What a mended model has instead of the believed numbers, as physical quantities."""

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.effects import MassProperties
from btr_mjx.gap.results import FoundEffect, mend
from btr_mjx.gap.results.changed_numbers import changed_numbers
from btr_mjx.gap.results.transcribe import nearest_axes

LINK = """<mujoco><worldbody><body name="hand"><joint name="wrist" axis="0 1 0" damping="0.2"/>
<inertial pos="0.1 0 0" mass="2" diaginertia="{moments}" {axes}/><geom size=".05" mass="0"/></body></worldbody>
<actuator><position name="servo" joint="wrist" kp="40"/></actuator></mujoco>"""


def link(moments: str = "0.0066 0.005 0.002", axes: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(LINK.format(moments=moments, axes=axes))


def told(model: mujoco.MjModel) -> dict[str, tuple[float, float]]:
    return {one["what"]: (one["believed"], one["mended"]) for one in changed_numbers(link(), model)}


def test_principal_axes_with_other_names_are_no_change() -> None:
    quarter = f"{np.sqrt(0.5)} 0 0 {np.sqrt(0.5)}"  # about z: the first axis becomes the second one
    assert told(link("0.005 0.0066 0.002", f'quat="{quarter}"')) == {}
    assert told(link("0.0066 0.005 0.002", 'quat="0 1 0 0"')) == {}  # axes that point the other way
    assert set(told(link("0.005 0.0066 0.002"))) == {f"inertia of body hand about {axis}" for axis in "xy"}


def test_a_link_that_is_turned_has_other_moments_in_its_own_axes() -> None:
    turned = link("0.0066 0.005 0.002", 'euler="0 0 30"')
    expected = MassProperties.of(turned, 1).inertia
    found = told(turned)
    assert set(found) == {
        "inertia of body hand about x",
        "inertia of body hand about y",
        "product of inertia xy of body hand",
    }
    assert found["inertia of body hand about x"] == pytest.approx((0.0066, expected[0, 0]))
    assert found["product of inertia xy of body hand"] == pytest.approx((0.0, expected[0, 1]))


def test_numbers_have_names_units_and_changes_in_per_cent() -> None:
    model = link()
    model.body_mass[1], model.body_ipos[1, 0] = 2.5, 0.12
    model.dof_damping[0], model.dof_frictionloss[0] = 0.3, 0.04
    model.actuator_gainprm[0, 0] = 44
    rows = {one["what"]: one for one in changed_numbers(link(), model)}
    assert {what: row["unit"] for what, row in rows.items()} == {
        "mass of body hand": "kg",
        "centre of mass of body hand along x": "m",
        "viscous damping of joint wrist": "N m s/rad",
        "dry friction of joint wrist": "N m",
        "gain of actuator servo, number 1": "",
    }
    assert rows["mass of body hand"]["percent"] == pytest.approx(25)
    assert rows["gain of actuator servo, number 1"]["percent"] == pytest.approx(10)
    assert rows["dry friction of joint wrist"]["percent"] is None
    assert rows["viscous damping of joint wrist"]["field"] == "dof_damping[0]"


def test_a_payload_leaves_the_axes_in_the_order_of_the_believed_model() -> None:
    """The moments in mended.xml are about the axes that are nearest, and are the same tensor."""
    load = {"mass": 0.2, "x": 0.02, "y": 0.0, "z": 0.01}
    made = mend(LINK.format(moments="0.0066 0.005 0.002", axes=""), [FoundEffect("payload", "body:hand", load)])
    model = mujoco.MjModel.from_xml_string(made.xml)
    moments = model.body_inertia[1]
    assert moments[0] > moments[1] > moments[2]  # as they were
    assert abs(model.body_iquat[1, 0]) > 0.9  # hardly turned
    arm = np.array([0.02, 0.0, 0.01]) - [0.1, 0.0, 0.0]
    expected = np.diag([0.0066, 0.005, 0.002]) + 2 * 0.2 / 2.2 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    np.testing.assert_allclose(MassProperties.of(model, 1).inertia, expected, rtol=1e-4, atol=1e-7)
    assert {one["what"] for one in made.changes} >= {"mass of body hand", "inertia of body hand about y"}


def test_axes_are_named_as_in_the_other_model_for_any_orientation(rng: np.random.Generator) -> None:
    for _ in range(50):
        quaternion = rng.normal(size=4)
        axes = f'quat="{" ".join(map(str, quaternion / np.linalg.norm(quaternion)))}"'
        base, renamed = link(axes=axes), link(axes=axes)
        properties = MassProperties.of(base, 1)
        properties.write(renamed, 1)  # sorts its moments
        moments, orientation = nearest_axes(renamed, base, 1)
        np.testing.assert_allclose(moments, base.body_inertia[1], rtol=1e-9)
        assert abs(orientation @ base.body_iquat[1]) == pytest.approx(1, abs=1e-9)
