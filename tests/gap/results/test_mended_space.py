import mujoco
import numpy as np
import pytest
from gap_models import QUADRUPED

from btr_mjx.errors import InputError
from btr_mjx.evaluation import evaluate
from btr_mjx.gap.results import ControllerTrial, FoundEffect, mend, mended_robot
from btr_mjx.models import compile_models
from btr_mjx.robots import Box


def signal(controller, time, xp):
    return controller[0:1] * xp.sin(10.0 * time + controller[1:2]) * np.ones((4, *([1] * (controller.ndim - 1))))


CONTROLLERS = Box(["amplitude", "phase"], [0.1, 0.0], [0.4, 3.0])


def entry(effect: str, location: str, **values: tuple[float, float]) -> dict:
    parameters = {name: {"value": v, "low": v - d, "high": v + d, "unit": "1"} for name, (v, d) in values.items()}
    return {"effect": effect, "location": location, "parameters": parameters}


COMMANDS = ("actuator_delay", "actuator_dynprm", "dof_armature")
CASES = {
    "damping": [entry("viscous_damping", "joint:knee0", damping=(0.6, 0.1))],
    "two": [
        entry("actuator_gain", "actuator:hip0", change=(-0.2, 0.05)),
        entry("ground_slope", "world", x=(0.1, 0.03), y=(-0.05, 0.03)),
    ],
    "length": [entry("link_length", "body:shank0", change=(0.02, 0.004))],
    "payload": [entry("payload", "body:head", mass=(0.5, 0.1))],
    "delay": [entry("actuator_delay", "all", delay=(0.01, 0.002))],
    "lag": [entry("actuator_lag", "actuator:hip0", time_constant=(0.02, 0.004))],
    "each": [
        entry("armature", "each:subtree:thigh0", **{"armature[hip0]": (0.01, 0.002), "armature[knee0]": (0.02, 0.003)})
    ],
}


@pytest.mark.parametrize("case", CASES)
def test_a_simulation_is_the_mended_model_at_every_point_of_its_box(case: str, rng: np.random.Generator) -> None:
    robot = mended_robot(QUADRUPED, CASES[case], ControllerTrial(signal, CONTROLLERS, base_body="torso"))
    found = [FoundEffect.from_result(e) for e in CASES[case]]
    for values in [robot.nominal_simulation, *robot.simulation_box.sample(rng, 3)]:
        rest = list(values)
        items = [FoundEffect(f.effect, f.location, {name: rest.pop(0) for name in f.values}) for f in found]
        expected = mujoco.MjModel.from_xml_string(mend(QUADRUPED, items).xml)
        ours = compile_models(robot, values).row(0)
        for field in (
            "dof_damping",
            "body_mass",
            "body_pos",
            "body_ipos",
            "geom_pos",
            "geom_size",
            "actuator_gainprm",
            *COMMANDS,
        ):
            np.testing.assert_allclose(getattr(ours, field), getattr(expected, field), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(ours.opt.gravity, expected.opt.gravity, rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(ours.dof_M0, expected.dof_M0, rtol=1e-4)


def test_a_mended_robot_can_be_evaluated(rng: np.random.Generator) -> None:
    robot = mended_robot(
        QUADRUPED, CASES["damping"], ControllerTrial(signal, CONTROLLERS, base_body="torso", duration=0.05)
    )
    assert robot.simulation_box.names == ("viscous_damping_joint_knee0_damping",)
    assert len(compile_models(robot, robot.simulation_box.sample(rng, 3))) == 3
    result = evaluate(robot, robot.simulation_box.sample(rng, 2), CONTROLLERS.sample(rng, 2), engine="native")
    assert np.isfinite(result.fitness).all()


def test_effects_without_mjcf_or_parameters_are_refused() -> None:
    with pytest.raises(InputError, match="load_friction@all"):
        mended_robot(
            QUADRUPED,
            [entry("load_friction", "all", coefficient=(0.2, 0.1))],
            ControllerTrial(signal, CONTROLLERS),
        )
    with pytest.raises(InputError, match="parameters"):
        mended_robot(QUADRUPED, [], ControllerTrial(signal, CONTROLLERS))
