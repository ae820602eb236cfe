"""Long windows avoid impacts, unstable motion, and time steps that are too long for stiction."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gap_arm import SIGMA, recording
from hypothesis import given
from hypothesis import strategies as st

from btr_mjx.gap.data import Recording
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.simulate import Command, Counter, World
from btr_mjx.gap.windows import (
    Options,
    PreparedData,
    Span,
    Windows,
    choose_windows,
    linearise,
    prepare,
    project,
    reliable_windows,
    step_uncertainty,
    survey,
    tile_windows,
    time_step_notes,
)
from btr_mjx.gap.windows.impacts import contact_samples, impact_free_windows, impact_samples

CART = """<mujoco><option timestep="{step}" integrator="{integrator}"/><worldbody>
  <geom name="wall" type="box" size="0.1 1 1" pos="2.2 0 0"/>
  <body name="cart"><joint name="rail" type="slide" axis="1 0 0" range="-1 1" limited="true" damping="1"/>
    <geom name="cart" type="box" size="0.1 0.1 0.1" mass="1"/>
    <body name="pole"><joint name="hinge" axis="0 1 0" damping="0.01"/>
      <geom name="pole" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.3" contype="0"
        conaffinity="0"/></body></body>
</worldbody><actuator><motor name="push" joint="rail" gear="{gear}"/></actuator></mujoco>"""
NOISE = np.array([1e-3, 1e-3, 1e-2, 1e-2])


DOUBLE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <joint name="one" axis="0 1 0" damping="{damping}"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1"/>
  <body pos="0 0 -0.4"><joint name="two" axis="0 1 0" damping="{damping}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1" contype="0" conaffinity="0"/></body>
</body></worldbody><actuator><motor name="push" joint="one"/></actuator></mujoco>"""


def cart(step=2e-3, integrator="implicitfast", gear=8.0) -> str:
    return CART.format(step=step, integrator=integrator, gear=gear)


def driven(xml: str, seed: int, duration=3.0, push=1.0, start=(0.0, 0.0)) -> Recording:
    """A recording of a robot with one motor, simulated by a first-order integrator with steps of 0.1 ms."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, duration, 0.004)
    phase = rng.uniform(0, 6.28, 3)
    ctrl = push * np.sin(time[:, None] * np.array([2.0, 5.0, 9.0]) + phase).sum(1, keepdims=True)
    real = mujoco.MjModel.from_xml_string(xml)
    real.opt.timestep, real.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    controls = Command(time, ctrl, "cubic").at((np.arange(40 * len(time)) + 0.5) * 1e-4)
    data = mujoco.MjData(real)
    data.qpos[:] = start
    states = []
    for i, control in enumerate(controls):
        if i % 40 == 0:
            states.append([*data.qpos, *data.qvel])
        data.ctrl[:] = control
        mujoco.mj_step(real, data)
    seen = np.array(states) + NOISE * rng.standard_normal((len(time), 4))
    model = mujoco.MjModel.from_xml_string(xml)
    return Recording(
        f"r{seed}", time, ctrl, seen[:, :2], seen[:, 2:], np.ones(2, bool), "fit", model, interpolation="cubic"
    )


def prepared(*recordings: Recording, sigma=NOISE) -> PreparedData:
    return prepare(recordings, sigma, Span(5, 6))


def chosen(data: PreparedData):
    found = survey(data, Counter())
    assert not found.contact
    return found, choose_windows(data, data, Hypothesis((), ()), found, 20, Options(), Counter())


@given(st.lists(st.booleans(), min_size=8, max_size=120), st.integers(1, 12), st.integers(0, 5))
def test_windows_between_impacts(blow, k, first) -> None:
    """Windows contain no impact, do not overlap, and are as many as a greedy loop finds."""
    blow = np.array(blow)
    last = len(blow) - 1 - k
    found = impact_free_windows(blow, first, last, k)
    assert (np.diff(found) >= k).all()
    expected, at = 0, first
    while at <= last:  # greedily, the earliest that fits, sharing end points within a free part
        if blow[at : at + k + 1].any():
            at += 1
            continue
        expected, at = expected + 1, at + k
    assert len(found) == expected
    for a in found:
        assert first <= a <= last
        assert not blow[a : a + k + 1].any()


def test_impacts_are_contacts_and_changes_at_end_stops() -> None:
    position = np.array([0.0, 0.4, 0.45, 0.2, -0.2, -0.51, -0.505, -0.4, 1.0, 1.999, 2.003, 1.95, 1.5])
    still, count = prepared(driven(cart(), 0, 0.2)), len(position)
    still.recordings[0].model.jnt_range[0] = -0.5, 2.0  # the wall is 2 m away
    track = replace(still.tracks[0], time=np.arange(count) * 0.004, qpos=np.column_stack([position, np.zeros(count)]))
    data = replace(still, tracks=(replace(track, qvel=np.zeros((count, 2))),))
    (touching,) = contact_samples(data, Counter())
    assert touching.tolist() == [p > 2.0 for p in position]
    (found,) = impact_samples(data, Counter())
    #                  0 .4 .45 .2 -.2 -.51 -.505 -.4  1  1.999 2.003 1.95 1.5
    assert found.tolist() == [bool(x) for x in (0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0)]


def test_windows_of_a_cart_avoid_its_end_stop() -> None:
    data = prepared(driven(cart(), 0), driven(cart(), 1))
    hits = [np.abs(r.qpos[:, 0]) > 1.0 for r in data.recordings]
    assert all(hit.any() for hit in hits)
    _, found = chosen(data)
    for windows in found.windows:
        assert windows.data.impacts is not None
        for r, a in zip(windows.recording, windows.first, strict=True):
            assert not hits[r][a : a + windows.k + 1].any()
    count = sum(len(tile_windows(windows.data, found.survey.span)[1]) for windows in found.windows)
    assert count >= sum(len(windows) for windows in found.windows) >= 2


def test_recordings_without_impacts_keep_all_windows() -> None:
    data = prepared(driven(cart(gear=1.0), 0), driven(cart(gear=1.0), 1))
    before, found = chosen(data)
    assert found.windows[0].data.impacts is None
    assert found.survey == before


def test_impacts_are_kept_if_they_are_everywhere() -> None:
    data = prepared(driven(cart(), 0), driven(cart(), 1))
    for one in data.recordings:
        one.model.jnt_range[0] = -5e-3, 5e-3
    rattling = [np.column_stack([np.arange(len(t.qpos)) % 2 * 1e-2, t.qpos[:, 1]]) for t in data.tracks]
    data = replace(data, tracks=tuple(replace(t, qpos=q) for t, q in zip(data.tracks, rattling, strict=True)))
    assert all(own.mean() > 0.9 for own in impact_samples(data, Counter()))
    found = survey(prepared(driven(cart(gear=1.0), 0)), Counter())
    kept_all = choose_windows(data, data, Hypothesis((), ()), found, 20, Options(), Counter())
    assert kept_all.windows[0].data.impacts is None
    assert kept_all.survey is found


def test_long_time_steps_are_divided_without_contact() -> None:
    data = prepared(driven(cart(step=0.01, integrator="RK4", gear=1.0), 0), driven(cart(step=0.01, gear=1.0), 1))
    _, found = chosen(data)
    fit = found.windows[0]
    assert fit.dt == 0.0025
    assert not fit.data.refined_for_contact
    assert "steps of 2.5 ms: steps of 10 ms" in time_step_notes(fit)[0]
    assert "friction" in time_step_notes(fit)[0]
    assert found.options.steps == 4 * Options().steps


def test_unstable_motion_has_shorter_windows() -> None:
    """A double pendulum, released upright or strongly damped."""
    spans = []
    for damping, start in ((0.5, (0.5, 0.0)), (0.0, (2.8, 0.5))):
        data = prepared(*(driven(DOUBLE.format(damping=damping), i, 4.0, start=start) for i in range(2)))
        spans.append(survey(data, Counter()).span)
    assert spans[1] < 0.8 * spans[0]


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_step_uncertainty_for_all_integrators(integrator) -> None:
    """Equals the effect of 0.1 ms of a first-order time step, by simulation."""
    data = prepared(driven(cart(integrator=integrator, gear=1.0), 0, start=(0.0, 1.0)))
    windows = Windows(data, np.zeros(2, int), np.array([20, 300]), 100, Counter())
    windows = linearise(windows, World.of)

    def first_order(model):
        world = World.of(model)
        world.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        return world

    near, far = (windows.whiten(windows.states([first_order], timestep=t)[0]) for t in (1e-4, 2e-4))
    expected = project(far - near, windows.basis)
    found = step_uncertainty(windows, World.of)
    assert np.abs(expected).max() > 0.02
    sign = 1.0 if integrator == "RK4" else -1.0
    np.testing.assert_allclose(sign * found, expected, atol=0.15 * np.abs(expected).max())


def test_windows_sensitive_to_the_time_step_are_left_out() -> None:
    data = prepare([recording("r", seed=3)], SIGMA, Span(5, 6))
    windows = Windows(data, np.zeros(4, int), np.array([10, 60, 110, 160]), 30)
    windows = linearise(windows, World.of)
    assert len(reliable_windows(windows, World.of, contact=False)) == 4
    windows.correction[2] *= 4.0 / np.sqrt((windows.correction[2] ** 2).mean()) * windows.step / 1e-4
    found = reliable_windows(windows, World.of, contact=False)
    assert found.first.tolist() == [10, 60, 160]
    assert len(reliable_windows(windows, World.of, contact=True)) == 4


def test_payload_on_simple_bodies(tmp_path: Path) -> None:
    """A payload on a single slider and on a single floating body, against the model compiled with it."""
    xml = """<mujoco><worldbody>
      <body name="target"><joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
        <geom type="box" size="0.1 0.1 0.1" mass="1"/>{on_target}</body>
      <body name="drone" pos="0 0 1"><freejoint/><geom type="box" size="0.2 0.2 0.05" mass="1"/>{on_drone}</body>
      </worldbody><actuator><motor joint="x"/></actuator></mujoco>"""
    file = tmp_path / "robot.xml"
    file.write_text(xml.format(on_target="", on_drone=""))
    assert mujoco.MjModel.from_xml_path(str(file)).body_simple[1:].all()
    model, text = load_model(file, file.parent)
    assert not model.body_simple[1:].any()
    assert text == file.read_text()
    effect = next(e for e in EFFECTS if e.name == "payload")
    payload = {c.place.label: c for c in candidates(model, Scales.of(model), [effect])}
    slid = payload["body:target"].apply(World.of(model), [0.3, 0.1]).update_constants()
    np.testing.assert_allclose(slid.dof_M0[:2], 1.3, rtol=1e-9)
    weight = '<geom type="sphere" size="1e-3" pos="0.05 0.02 0.01" mass="0.3"/>'
    expected = mujoco.MjModel.from_xml_string(xml.format(on_target="", on_drone=weight))
    states = []
    for own in (payload["body:drone"].apply(World.of(model), [0.3, 0.05, 0.02, 0.01]).update_constants(), expected):
        data = mujoco.MjData(own)
        data.qvel[:] = np.linspace(-1, 1, own.nv)
        data.ctrl[:] = 0.5
        mujoco.mj_step(own, data, 100)
        states.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(states[0], states[1], rtol=1e-5, atol=1e-6)  # a sphere of 1 mm instead of a point
