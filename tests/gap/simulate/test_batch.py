"""Batched simulation of worlds against loops of mj_step."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_models import command
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.errors import InputError
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.simulate import Counter, Rows, Segments, World, differing_fields, rollout, simulate
from btr_mjx.gap.windows.activation import activations
from btr_mjx.models import between, difference, integrate

XML = """
<mujoco>
  <option timestep="0.001" iterations="100" tolerance="1e-14" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="base" pos="0 0 0.12">
      <freejoint/>
      <geom type="sphere" size="0.1" density="800" friction="0.7"/>
      <body name="leg" pos="0.1 0 0" euler="0 30 0">
        <joint name="hip" axis="0 1 0.2" damping="0.1" frictionloss="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04" density="500"/>
      </body>
      <body name="tail" pos="-0.1 0 0">
        <joint name="ball" type="ball" damping="0.01"/>
        <geom type="sphere" pos="-0.15 0 0" size="0.05"/>
      </body>
      <body name="rod" pos="0 0 0.1">
        <joint name="slide" type="slide" axis="0 0 1" stiffness="300" damping="1"/>
        <geom type="sphere" pos="0 0 0.1" size="0.03"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="hip" joint="hip" kp="20" kv="0.5"/><motor name="slide" joint="slide"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


def segments(model: mujoco.MjModel, seed: int, windows: int = 5, samples: np.ndarray | None = None) -> Segments:
    rng = np.random.default_rng(seed)
    qpos = integrate(model, np.tile(model.qpos0, (windows, 1)), 0.2 * rng.normal(size=(windows, model.nv)))
    return Segments(
        start=rng.uniform(0, 0.2, windows),
        qpos=qpos,
        qvel=rng.normal(size=(windows, model.nv)),
        samples=np.array([0.0, 0.01, 0.02]) if samples is None else samples,
        commands=(command(1), command(2)),
        recording=rng.integers(0, 2, windows),
    )


def stepped(model: mujoco.MjModel, world: World, windows: Segments, row: int, steps: int) -> np.ndarray:
    """States (steps + 1, nq + nv) of one window by mj_step alone."""
    data = mujoco.MjData(model)
    data.time = windows.start[row]
    data.qpos[:] = windows.qpos[row]
    data.qvel[:] = windows.qvel[row]
    sent = world.command(windows.commands[windows.recording[row]])
    states = [np.r_[data.qpos, data.qvel]]
    for k in range(steps):
        data.ctrl[:] = sent.at(windows.start[row] + k * model.opt.timestep)
        data.xfrc_applied[:] = world.wrench
        mujoco.mj_step(model, data)
        states.append(np.r_[data.qpos, data.qvel])
    return np.array(states)


def test_worlds_of_different_models_equal_mj_step(model: mujoco.MjModel) -> None:
    worlds = [World.of(model) for _ in range(4)]
    worlds[1].model.dof_damping[6] += 0.3
    worlds[1].model.dof_frictionloss[7] = 0.2
    worlds[2].model.body_mass[2] *= 2
    worlds[2].model.dof_armature[6] = 0.01
    worlds[2].wrench[1, :3] = [5.0, -3.0, 2.0]
    worlds[3].model.opt.gravity[0] = 2.0
    worlds[3].model.geom_friction[:, 0] = 0.3
    worlds[3].command_edits.append(lambda sent: sent.shifted(0.004))
    jobs = [(world, segments(model, seed)) for seed, world in enumerate(worlds)]
    counter = Counter()
    results = simulate(jobs, counter=counter)
    assert counter.steps == 4 * 5 * 20
    for (world, windows), states in zip(jobs, results, strict=True):
        alone = copy.copy(world.model)
        mujoco.mj_setConst(alone, mujoco.MjData(alone))
        for row in range(len(windows)):
            expected = stepped(alone, world, windows, row, 20)
            # Velocities of up to 10, and another starting point of the solver.
            np.testing.assert_allclose(states[row], expected[[0, 10, 20]], rtol=0, atol=1e-11)
    assert np.abs(results[0][0, -1] - simulate([(worlds[1], jobs[0][1])])[0][0, -1]).max() > 1e-4


def test_samples_between_steps_are_interpolated(model: mujoco.MjModel) -> None:
    rng = np.random.default_rng(5)
    samples = np.sort(rng.uniform(0, 0.03, (5, 4)), axis=1)
    world, windows = World.of(model), segments(model, 3, samples=samples)
    coarse = simulate([(world, windows)])[0]
    for row in range(5):
        path = stepped(model, world, windows, row, 31)
        for k, t in enumerate(samples[row]):
            i = int(t // 0.001)
            earlier, later = path[i], path[i + 1]
            fraction = t / 0.001 - i
            q = earlier[: model.nq].copy()
            mujoco.mj_integratePos(model, q, earlier[model.nq :], 0.001 * fraction)
            apart, dq = np.zeros(model.nv), np.zeros(model.nv)
            mujoco.mj_differentiatePos(model, dq, 1.0, earlier[: model.nq], later[: model.nq])
            mujoco.mj_differentiatePos(model, apart, 1.0, q, coarse[row, k, : model.nq])
            assert np.abs(apart).max() < 1e-6 + np.abs(dq - 0.001 * earlier[model.nq :]).max()
            v = earlier[model.nq :] + fraction * (later - earlier)[model.nq :]
            np.testing.assert_allclose(coarse[row, k, model.nq :], v, atol=1e-12)


def test_interpolation_meets_both_ends(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    q0 = integrate(model, np.tile(model.qpos0, (6, 1)), rng.normal(size=(6, model.nv)))
    v0, v1 = rng.normal(size=(2, 6, model.nv))
    q1 = integrate(model, q0, 0.01 * v1)
    for end, (q, v) in ((0.0, (q0, v0)), (1.0, (q1, v1))):
        qs, vs = between(model, (q0, v0), (q1, v1), np.full(6, end), 0.01)
        np.testing.assert_allclose(difference(model, q, qs), 0, atol=1e-12)
        np.testing.assert_allclose(vs, v, atol=1e-12)


class Spring:
    """A force on the hip and friction that grows with speed: reads the state, writes a force and a field."""

    fields = ("dof_frictionloss",)

    def __call__(self, rows: Rows) -> None:
        rows.qfrc_applied[:, 6] -= 3.0 * rows.qpos[:, 7]
        rows.field("dof_frictionloss")[:, 6] += 0.1 * np.abs(rows.qvel[:, 6]) + 0.01 * np.abs(rows.actuator_force[:, 0])
        rows.ctrl[:, 1] += rows.time


def test_laws_act_on_their_own_rows_and_add_up(model: mujoco.MjModel) -> None:
    plain, ruled, twice = (World.of(model) for _ in range(3))
    ruled.laws.append(Spring())
    twice.laws += [Spring(), Spring()]
    windows = segments(model, 7)
    results = simulate([(plain, windows), (ruled, windows), (plain, windows), (twice, windows)])
    np.testing.assert_array_equal(results[0], results[2])
    for times, states in ((0, results[0]), (1, results[1]), (2, results[3])):
        for row in range(len(windows)):
            expected = ruled_loop(model, windows, row, times)
            np.testing.assert_allclose(states[row, -1], expected, rtol=0, atol=1e-9)


def ruled_loop(model: mujoco.MjModel, windows: Segments, row: int, times: int) -> np.ndarray:
    model = copy.copy(model)
    data = mujoco.MjData(model)
    data.time, data.qpos[:], data.qvel[:] = windows.start[row], windows.qpos[row], windows.qvel[row]
    sent = windows.commands[windows.recording[row]]
    for k in range(20):
        data.ctrl[:] = sent.at(windows.start[row] + k * 0.001)
        if k == 0:
            mujoco.mj_forward(model, data)
        data.ctrl[1] += times * data.time
        data.qfrc_applied[6] = -3.0 * times * data.qpos[7]
        speed, force = abs(data.qvel[6]), abs(data.actuator_force[0])
        model.dof_frictionloss[6] = 0.05 + times * (0.1 * speed + 0.01 * force)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


def test_encoder_offsets_are_added_to_measurements(model: mujoco.MjModel) -> None:
    world, windows = World.of(model), segments(model, 8)
    world.offset[6] = 0.1
    shown = simulate([(world, windows)])[0]
    np.testing.assert_allclose(shown[:, 0, : model.nq], windows.qpos, atol=1e-12)
    true = copy.deepcopy(windows)
    true.qpos[:, 7] -= 0.1
    expected = simulate([(World.of(model), true)])[0]
    np.testing.assert_allclose(shown[..., 7], expected[..., 7] + 0.1, atol=1e-12)


def test_solver_with_few_iterations_is_warm_started() -> None:
    """The result of one iteration depends on its starting point, which must be that of mj_step."""
    model = mujoco.MjModel.from_xml_string(XML.replace('iterations="100"', 'iterations="1"'))
    world, windows = World.of(model), segments(model, 13)
    cold = copy.copy(model)
    cold.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    states = simulate([(world, windows)])[0]
    apart = []
    for row in range(len(windows)):
        expected = stepped(model, world, windows, row, 20)[[0, 10, 20]]
        np.testing.assert_allclose(states[row], expected, rtol=0, atol=1e-12)
        apart.append(np.abs(expected - stepped(cold, world, windows, row, 20)[[0, 10, 20]]).max())
    assert max(apart) > 1e-6


@pytest.mark.parametrize("geoms", [1, 12])
def test_collisions_of_bodies_with_many_geoms_equal_mj_step(geoms: int) -> None:
    """With few geoms the collision midphase is disabled, with many it is used."""
    beads = "".join(f'<geom type="sphere" pos="{0.02 * i} 0 -0.05" size="0.03"/>' for i in range(geoms))
    own = XML.replace('<geom type="sphere" pos="-0.15 0 0" size="0.05"/>', beads)
    model = mujoco.MjModel.from_xml_string(own)
    assert model.body_geomnum.max() == geoms
    world, windows = World.of(model), segments(model, 14)
    states = simulate([(world, windows)])[0]
    for row in range(len(windows)):
        expected = stepped(model, world, windows, row, 20)[[0, 10, 20]]
        np.testing.assert_allclose(states[row], expected, rtol=0, atol=1e-10)


def test_results_are_independent_of_threads_and_other_jobs(model: mujoco.MjModel) -> None:
    world, other, windows = World.of(model), World.of(model), segments(model, 9)
    other.model.dof_damping[:] += 0.2
    reference = simulate([(world, windows)], threads=1)[0]
    np.testing.assert_array_equal(reference, simulate([(other, windows), (world, windows)], threads=2)[1])


def test_smaller_steps_converge(model: mujoco.MjModel) -> None:
    world, windows = World.of(model), segments(model, 10)
    windows.qpos[:, 2] += 1.0  # no contact
    finest = simulate([(world, windows)], timestep=1e-5)[0]
    errors = [np.abs(simulate([(world, windows)], timestep=dt)[0] - finest).max() for dt in (1e-3, 2.5e-4)]
    assert errors[1] < 0.35 * errors[0]


def test_invalid_rows_are_nan_and_do_not_affect_others(model: mujoco.MjModel) -> None:
    bad, good, windows = World.of(model), World.of(model), segments(model, 11)
    bad.model.actuator_gainprm[0, 0] = -1e9
    bad.model.actuator_biasprm[0, 1] = 1e9
    results = simulate([(bad, windows), (good, windows)])
    assert np.isnan(results[0][:, -1]).all()
    np.testing.assert_array_equal(results[1], simulate([(good, windows)])[0])


class Still:
    """A law without effect: forces single steps."""

    fields = ()

    def __call__(self, rows: Rows) -> None:
        return None


@pytest.mark.parametrize("samples", [None, "uneven", "long"])
@pytest.mark.parametrize("wild", [False, True])
def test_rollout_equals_single_steps(model: mujoco.MjModel, samples, wild, monkeypatch) -> None:
    rng = np.random.default_rng(2)
    uneven = np.sort(rng.uniform(0, 0.03, (5, 4)), axis=1)
    uneven[::2] += 0.01  # diverging rows have the longest segments
    times = {None: None, "uneven": uneven, "long": np.array([0.0, 0.07, 0.1505])}
    plain, still = World.of(model), World.of(model)
    still.laws.append(Still())
    windows = segments(model, 12, samples=times[samples])
    if wild:  # some of the segments diverge
        windows.qvel[::2] *= 1e4
        for world in (plain, still):
            world.model.dof_damping[:] = -50.0
    expected, found = Counter(), Counter()
    slow = simulate([(still, windows)], counter=expected)[0]
    for most in (2**22, 5 * 100):  # 5 rows in blocks of many steps, and of few
        monkeypatch.setattr(rollout, "_MAX_NUMBERS", most)
        found.steps = 0
        np.testing.assert_array_equal(simulate([(plain, windows)], counter=found)[0], slow)
        assert found.steps == expected.steps
    assert np.isnan(slow).any() == wild


def test_derived_constants_are_updated_after_an_edit(model: mujoco.MjModel) -> None:
    world = World.of(model)
    assert differing_fields(world, model) == {}
    world.model.body_mass[3] += 1.0
    changed = differing_fields(world, model)
    assert {"body_mass", "body_subtreemass", "dof_M0", "body_invweight0", "dof_invweight0"} <= set(changed)
    assert "dof_damping" not in changed


def test_constants_of_frozen_worlds_are_computed_once(model: mujoco.MjModel) -> None:
    def derived(mass: float) -> np.ndarray:
        own = copy.copy(model)
        own.body_mass[3] += mass
        mujoco.mj_setConst(own, mujoco.MjData(own))
        return own.dof_M0.copy()

    world = World.of(model)
    for mass in (1.0, 2.0):
        world.model.body_mass[3] = model.body_mass[3] + mass
        np.testing.assert_allclose(world.update_constants(mujoco.MjData(model)).dof_M0, derived(mass))
    world.frozen = True
    world.model.body_mass[3] += 1.0
    np.testing.assert_allclose(world.update_constants().dof_M0, derived(2.0))  # edited although frozen: not updated


def test_edits_between_two_simulations_take_effect(model: mujoco.MjModel) -> None:
    world, windows = World.of(model), segments(model, 13)
    simulate([(world, windows)])
    world.model.body_mass[3] += 1.0
    fresh = World.of(model)
    fresh.model.body_mass[3] += 1.0
    np.testing.assert_array_equal(simulate([(world, windows)])[0], simulate([(fresh, windows)])[0])


def test_hypothesis_creates_its_world_once(model: mujoco.MjModel) -> None:
    hypothesis, other = Hypothesis((), ()), copy.copy(model)
    assert hypothesis(model) is hypothesis(model)
    assert hypothesis(model).frozen
    assert hypothesis(other) is not hypothesis(model)
    assert replace(hypothesis)(model) is not hypothesis(model)
    assert replace(hypothesis) == hypothesis


def test_native_delay_equals_shifted_command() -> None:
    xml = XML.replace('kp="20" kv="0.5"', 'kp="20" kv="0.5" delay="0.004" nsample="8"')
    delayed, plain = mujoco.MjModel.from_xml_string(xml), mujoco.MjModel.from_xml_string(XML)
    windows = segments(plain, 12)
    shifted = World.of(plain)
    shifted.command_edits.append(lambda sent: sent.shifted([0.004, 0.0]))
    native = World.of(delayed)
    assert not native.model.actuator_delay.any()
    np.testing.assert_allclose(simulate([(native, windows)])[0], simulate([(shifted, windows)])[0], rtol=0, atol=1e-12)


def test_segments_of_another_model_raise(model: mujoco.MjModel) -> None:
    windows = segments(model, 13)
    with pytest.raises(InputError, match="expected"):
        simulate([(World.of(mujoco.MjModel.from_xml_string("<mujoco/>")), windows)])


def test_activations_follow_from_measured_motion() -> None:
    actuators = """<actuator><pid joint="hip" kp="20" ki="30" kv="0.5" input="pos"/>
      <general joint="slide" dyntype="filter" dynprm="0.02" gainprm="3"/></actuator>"""
    model = mujoco.MjModel.from_xml_string(XML[: XML.index("<actuator>")] + actuators + "</mujoco>")
    world, data, sent = World.of(model), mujoco.MjData(model), command(6)
    world.command_edits.append(lambda command: command.shifted([0.003, 0.0]))
    time, rows = 0.001 * np.arange(151), []
    for t in time:
        rows.append((data.qpos.copy(), data.qvel.copy(), data.act.copy()))
        data.ctrl[:] = world.command(sent).over_step(t, 0.001, [0.0, 0.5])  # the filter in the middle of a step
        mujoco.mj_step(model, data)
    qpos, qvel, act = (np.array(column) for column in zip(*rows, strict=True))
    np.testing.assert_allclose(activations(world, sent, time, qpos, qvel), act, atol=1e-12)
    coarse = activations(world, sent, time[::4], qpos[::4], qvel[::4])
    np.testing.assert_allclose(coarse, act[::4], atol=0.02 * np.abs(act).max())
    late = activations(world, sent, time[50:], qpos[50:], qvel[50:], start=act[50])
    np.testing.assert_allclose(late, act[50:], atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_tangent_space_agrees_with_mujoco(seed: int) -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    rng = np.random.default_rng(seed)
    a, b = integrate(model, np.tile(model.qpos0, (2, 3, 1)), 1.5 * rng.normal(size=(2, 3, model.nv)))
    for apart, start, end in zip(difference(model, a, b), a, b, strict=True):
        expected = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, expected, 1.0, start, end)
        np.testing.assert_allclose(apart, expected, atol=1e-9)
        moved = start.copy()
        mujoco.mj_integratePos(model, moved, apart, 1.0)
        np.testing.assert_allclose(integrate(model, start, apart), moved, atol=1e-12)
        np.testing.assert_allclose(difference(model, integrate(model, start, apart), end), 0, atol=1e-9)
