from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_models import QUADRUPED

from btr_mjx.errors import InputError
from btr_mjx.evaluation import evaluate, fitness_function
from btr_mjx.gap.effects import KNOWN_EFFECTS
from btr_mjx.gap.results import (
    Callback,
    ControllerTrial,
    EffectSimulator,
    FoundEffect,
    added_effects,
    mend,
    mended_robot,
)
from btr_mjx.models import compile_models
from btr_mjx.robots import Box


def signal(controller, time, xp):
    return controller[0:1] * xp.sin(10.0 * time + controller[1:2]) * np.ones((4, *([1] * (controller.ndim - 1))))


CONTROLLERS = Box(["amplitude", "phase"], [0.1, 0.0], [0.4, 3.0])


def entry(effect: str, location: str, **values: tuple[float, float]) -> dict:
    parameters = {name: {"value": v, "low": v - d, "high": v + d, "unit": "1"} for name, (v, d) in values.items()}
    return {"effect": effect, "location": location, "parameters": parameters}


CASES = {
    "damping": [entry("viscous_damping", "joint:knee0", damping=(0.6, 0.1))],
    "two": [
        entry("actuator_gain", "actuator:hip0", change=(-0.2, 0.05)),
        entry("ground_slope", "world", x=(0.1, 0.03), y=(-0.05, 0.03)),
    ],
    "length": [entry("link_length", "body:shank0", change=(0.02, 0.004))],
    "payload": [entry("payload", "body:head", mass=(0.5, 0.1))],
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
            "dof_armature",
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


TERMS = {
    "delay": [entry("actuator_delay", "all", delay=(0.01, 0.002))],
    "lag": [entry("actuator_lag", "actuator:hip0", time_constant=(0.02, 0.004))],
    "backlash": [entry("backlash", "all", play=(0.05, 0.01))],
    "force": [entry("constant_force", "body:torso", x=(3.0, 0.5), y=(1.0, 0.5), z=(0.0, 0.5))],
    "two": [
        entry("load_friction", "all", coefficient=(0.2, 0.1)),
        entry("viscous_damping", "joint:knee0", damping=(0.6, 0.1)),
    ],
}


@pytest.mark.parametrize("case", TERMS)
def test_effects_without_mjcf_are_simulated(case: str) -> None:
    """Against the mended MJCF in plain MuJoCo, with the callback for terms that MJCF lacks."""
    trial = ControllerTrial(signal, CONTROLLERS, base_body="torso", duration=0.3)
    robot = mended_robot(QUADRUPED, TERMS[case], trial)
    controllers = np.array([[0.3, 1.0], [0.2, 2.0]])
    wrong = evaluate(
        replace(robot, simulator=EffectSimulator(()), edits=()), robot.nominal_simulation, controllers, states=True
    )
    result = evaluate(robot, robot.nominal_simulation, controllers, states=True)
    assert result.engine == "native"
    assert np.isfinite(result.fitness).all()
    mended = mend(QUADRUPED, [FoundEffect.from_result(e) for e in TERMS[case]])
    for row, controller in enumerate(controllers):
        model = mujoco.MjModel.from_xml_string(mended.xml)
        data, missing = mujoco.MjData(model), Callback(model, mended.terms)
        late = model.actuator_delay.max(initial=0.0)
        model.actuator_delay[:] = 0.0  # MuJoCo's own starts from a control of zero
        for k in range(round(0.3 / model.opt.timestep)):
            data.ctrl[:] = signal(controller[:, None], max(k * model.opt.timestep - late, 0.0), np)[:, 0]
            if k == 0 and model.na:
                data.act[:] = data.ctrl[:1]  # a filter starts at rest
            missing(model, data)
            mujoco.mj_step(model, data)
        size = np.abs(wrong.outcome.qpos[0, row, -1] - data.qpos).max()
        # MuJoCo's filter acts on the state at the start of a step, the simulator's in its middle.
        share = 0.1 if case == "lag" else 0.05
        assert np.abs(result.outcome.qpos[0, row, -1] - data.qpos).max() < share * size
        np.testing.assert_array_equal(result.outcome.position[0, row, -1], result.outcome.qpos[0, row, -1, :3])


def test_without_its_effects_a_simulator_gives_what_the_engine_gives(rng: np.random.Generator) -> None:
    trial = ControllerTrial(signal, CONTROLLERS, base_body="torso", duration=0.2)
    robot = mended_robot(QUADRUPED, CASES["damping"], trial)
    own = replace(robot, simulator=EffectSimulator(()))
    simulations, controllers = robot.simulation_box.sample(rng, 3), CONTROLLERS.sample(rng, 4)
    expected = evaluate(robot, simulations, controllers, engine="native", times=[0.1, 0.2])
    result = evaluate(own, simulations, controllers, times=[0.1, 0.2])
    np.testing.assert_allclose(result.fitness, expected.fitness, rtol=1e-6)
    np.testing.assert_allclose(result.outcome.position, expected.outcome.position, rtol=1e-6, atol=1e-9)
    energy = evaluate(own, simulations, controllers, fitness=fitness_function("energy_per_metre"))
    assert np.isnan(energy.fitness).all()
    with pytest.raises(InputError, match="simulator of its own"):
        evaluate(own, simulations, controllers, engine="lanes")


def test_effects_without_parameters_are_refused() -> None:
    with pytest.raises(InputError, match="parameters"):
        mended_robot(QUADRUPED, [], ControllerTrial(signal, CONTROLLERS))


def test_an_edit_leaves_the_delays_of_a_model_alone() -> None:
    model = mujoco.MjModel.from_xml_string(mend(QUADRUPED, [FoundEffect("actuator_delay", "all", {"delay": 0.01})]).xml)
    (edit,), simulator = added_effects(
        model, [FoundEffect("viscous_damping", "all", {"damping": 0.5})], [("d",)], KNOWN_EFFECTS
    )
    assert simulator is None
    edit(model, [0.5])
    assert model.actuator_delay.min() == pytest.approx(0.01)
