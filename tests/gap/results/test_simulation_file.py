"""A simulation as plain MJCF is the simulation, also for programs that know nothing of its robot."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.results import Callback, FoundEffect, added_effects, simulation_mjcf
from btr_mjx.models import general_model, load_robot
from btr_mjx.robots import Box, Robot, hexapod

EXAMPLES = Path(__file__).parents[3] / "examples"


def states(model: mujoco.MjModel, steps: int = 200) -> np.ndarray:
    data = mujoco.MjData(model)
    for k in range(steps):
        data.ctrl[:] = 0.3 * np.sin(0.05 * k)
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("name", ["hexapod", "thrower", "quadruped"])
def test_templates_and_edits_become_numbers(name: str) -> None:
    """The oracle is the model that the package itself simulates."""
    robot = hexapod() if name == "hexapod" else load_robot(EXAMPLES / name)
    rng = np.random.default_rng(3)
    simulation = robot.simulation_box.sample(rng)
    found = simulation_mjcf(robot, simulation)
    assert found.terms == []
    assert found.notes == ()
    ours, theirs = mujoco.MjModel.from_xml_string(found.xml), general_model(robot, simulation)
    for field in (
        "body_mass",
        "body_inertia",
        "dof_damping",
        "dof_armature",
        "geom_friction",
        "geom_size",
        "jnt_range",
    ):
        np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), rtol=2e-5, atol=1e-8, err_msg=field)
    np.testing.assert_allclose(states(ours, 20), states(theirs, 20), rtol=1e-3, atol=1e-4)


def with_effects(robot: Robot, effects: list[FoundEffect]) -> Robot:
    names = [f"number {i}" for i in range(len(effects))]
    model = general_model(robot, robot.nominal_simulation)
    edits, simulator = added_effects(model, effects, [(name,) for name in names], EFFECTS)
    box = robot.simulation_box
    low, high = [*box.low, *[0.0] * len(names)], [*box.high, *[1.0] * len(names)]
    return Robot(
        **{
            **{field: getattr(robot, field) for field in ("name", "template", "template_path", "controller_box")},
            **{field: getattr(robot, field) for field in ("signal", "folder", "plain", "point", "target", "fitness")},
            "simulation_box": Box([*box.names, *names], low, high),
            "nominal": (*robot.nominal, *[0.1] * len(names)),
            "edits": (*robot.edits, *edits),
            "simulator": simulator,
        }
    )


def test_effects_are_numbers_or_terms() -> None:
    robot = load_robot(EXAMPLES / "thrower")
    added = [
        FoundEffect("dry_friction", "joint:elbow", {"torque": 0.05}),
        FoundEffect("backlash", "joint:elbow", {"play": 0.02}),
    ]
    grown = with_effects(robot, added)
    found = simulation_mjcf(grown, [*robot.nominal, 0.07, 0.03])
    model = mujoco.MjModel.from_xml_string(found.xml)
    assert model.dof_frictionloss[model.joint("elbow").dofadr[0]] == pytest.approx(0.07)
    assert [(term["effect"], term["parameters"]) for term in found.terms] == [("backlash", {"play": 0.03})]
    assert found.native == ("dry_friction@joint:elbow",)
    Callback(model, found.terms)
