"""The motion of a base from an inertial unit and from feet: against the truth of a simulation, and part by part."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_cases.imu import PLACE, Mount, imu_columns, with_imu
from scipy.spatial.transform import Rotation

from btr_mjx.demo import demo_robot
from btr_mjx.gap.data.base.block_system import BlockRows, eliminated
from btr_mjx.gap.data.base.motion import COMMON, BaseMotion, Legs, Unit, first_estimate
from btr_mjx.gap.data.base.residuals import inertia_of, propagation, scatter_of, tilts, touches
from btr_mjx.gap.data.base.smoother import BaseMotions, smoothed_bases
from btr_mjx.gap.data.base.touching import touching_points

ROBOT, RATE = demo_robot("quadruped"), 200
MODEL = mujoco.MjModel.from_xml_string(with_imu(ROBOT.xml, '<freejoint name="root"'))
COMMONS = (0, 1, 2, 4, 5, 6, 7, 8, 9)
"""What recordings share, and biases; without the delay."""
SIGMA = np.repeat([1e-3, 0.05], MODEL.nv)


@pytest.fixture(scope="module")
def walk() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, qpos and qvel of a quadruped that walks, at half samples."""
    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    model.opt.timestep = 0.5 / RATE / 5
    data, rows = mujoco.MjData(model), []
    motion = ROBOT.draw_motion(np.random.default_rng(5))
    for step in range(5 * (2 * RATE * 2 + 200)):
        data.ctrl[:] = motion(np.array([data.time]))[0]
        if step % 5 == 0:
            rows.append((data.time, data.qpos.copy(), data.qvel.copy()))
        mujoco.mj_step(model, data)
    time, qpos, qvel = (np.array(one)[200:] for one in zip(*rows, strict=True))
    keep = slice(0, len(time) - 1 + len(time) % 2)
    return time[keep], qpos[keep], qvel[keep]


def measured(walk, orientation: bool = True) -> tuple[Unit, Legs, Mount]:
    """What a unit that is turned by two degrees and noisy encoders measure."""
    time, qpos, qvel = walk
    rng = np.random.default_rng(3)
    mount = Mount.drawn(rng)
    columns = imu_columns(time[::2], qpos, qvel, MODEL.opt.gravity, mount, rng)
    gyro, force = (np.stack([columns[f"sensor/imu_{n}/{a}"] for a in "xyz"], 1) for n in ("gyro", "acc"))
    quat = np.stack([columns[f"sensor/imu_quat/q{a}"] for a in "wxyz"], 1)
    seen_q, seen_v = np.tile(MODEL.qpos0, (len(gyro), 1)), np.zeros((len(gyro), MODEL.nv))
    seen_q[:, 7:] = qpos[1::2, 7:] + 1e-3 * rng.standard_normal((len(gyro), MODEL.nu))
    seen_v[:, 6:] = qvel[1::2, 6:] + 0.05 * rng.standard_normal((len(gyro), MODEL.nu))
    turn = Rotation.from_quat(quat, scalar_first=True) if orientation else None
    unit = Unit(time[1::2], gyro, force, turn, (0.005, 0.1))
    return unit, Legs(MODEL, MODEL.body("trunk").id, PLACE, seen_q, seen_v, SIGMA), mount


@pytest.mark.parametrize("orientation", [True, False])
def test_base_is_found_from_inertial_unit_and_feet(walk, orientation):
    unit, legs, mount = measured(walk, orientation)
    found = smoothed_bases([unit], [legs], Rotation.identity(), 0.02)
    (motion,) = found.motions
    truth_q, truth_v = walk[1][1::2], walk[2][1::2]
    turn = Rotation.from_quat(truth_q[:, 3:7], scalar_first=True)
    place = truth_q[:, :3] + turn.apply(PLACE)
    velocity = truth_v[:, :3] + turn.apply(np.cross(truth_v[:, 3:6], PLACE))
    if orientation:
        north = Rotation.identity()
        assert np.linalg.norm((found.mount.inv() * mount.turn).as_rotvec()) < np.radians(1.5)
        assert np.abs((turn.inv() * motion.turn).as_rotvec()).mean() < np.radians(0.5)
    else:  # where north is, nothing tells
        north = Rotation.from_rotvec([0, 0, (turn * motion.turn.inv()).mean().as_rotvec()[2]])
    off = north.apply(motion.velocity) - velocity
    assert np.sqrt((off**2).mean(0)).max() < 0.04
    assert np.abs(motion.place - place)[:, 2].mean() < 4e-3
    assert np.abs((turn.inv() * north * motion.turn).as_rotvec())[:, :2].mean() < np.radians(1.0)
    moved = off[4:] - off[:-4]
    assert (moved.std(0) / np.sqrt(2) < 3 * motion.within[3:6]).all()
    assert found.late == 0.0


def late(unit: Unit, rows: int) -> Unit:
    """The unit as it is logged some rows later."""
    at = np.maximum(np.arange(len(unit.time)) - rows, 0)
    assert unit.orientation is not None
    return replace(
        unit, gyro=unit.gyro[at], accelerometer=unit.accelerometer[at], orientation=unit.orientation[at.astype(int)]
    )


def states(found: BaseMotions) -> np.ndarray:
    """(K, 6) velocities and angles of the first recording."""
    (motion,) = found.motions
    return np.concatenate([motion.velocity, motion.turn.as_rotvec()], 1)


def test_unit_that_is_logged_late_is_moved_onto_the_clock_of_the_encoders(walk):
    unit, legs, _ = measured(walk)
    delayed, rows = late(unit, 2), slice(10, -10)
    sound = smoothed_bases([unit], [legs], Rotation.identity(), 0.02)
    found = smoothed_bases([delayed], [legs], Rotation.identity(), 0.02)
    assert found.late == pytest.approx(2 / RATE)
    assert np.sqrt(((states(found) - states(sound))[rows] ** 2).mean(0)).max() < 5e-3


def test_block_system_is_the_dense_least_squares_solution():
    rng, count = np.random.default_rng(0), 6
    rows = [
        BlockRows(
            rng.standard_normal((5, 9)),
            np.arange(5),
            rng.standard_normal((5, 9, 9)),
            rng.standard_normal((5, 9, COMMON)),
            rng.standard_normal((5, 9, 9)),
        ),
        BlockRows(
            rng.standard_normal((8, 4)),
            rng.integers(0, count, 8),
            rng.standard_normal((8, 4, 9)),
            rng.standard_normal((8, 4, COMMON)),
        ),
    ]
    dense, right = [], []
    for part in rows:
        for i, sample in enumerate(part.sample):
            row = np.zeros((part.residual.shape[1], 9 * count + COMMON))
            row[:, 9 * sample : 9 * sample + 9] = part.slope[i]
            if part.ahead is not None:
                row[:, 9 * sample + 9 : 9 * sample + 18] = part.ahead[i]
            row[:, 9 * count :] = part.border[i]
            dense.append(row)
            right.append(part.residual[i])
    fixed, known = np.ones(9), np.eye(COMMON)
    matrix = np.concatenate(dense)
    normal = matrix.T @ matrix + 1e-6 * np.diag(np.arange(9 * count + COMMON) < 9 * count)
    normal[:9, :9] += np.diag(fixed)
    normal[9 * count :, 9 * count :] += known
    pull = np.arange(float(COMMON))
    gradient = matrix.T @ np.concatenate(right)
    gradient[9 * count :] += pull
    expected = -np.linalg.solve(normal, gradient)
    system = eliminated(count, rows, fixed, known, pull)
    border = -np.linalg.solve(system.information, system.pull)
    np.testing.assert_allclose(border, expected[9 * count :], rtol=1e-8)
    np.testing.assert_allclose(system.step(border).ravel(), expected[: 9 * count], rtol=1e-6, atol=1e-9)
    inverse = np.linalg.inv(normal)
    at, moved = system.covariances(np.array([1, 3]), 2, np.linalg.inv(system.information))
    for row, sample in enumerate((1, 3)):
        own, later = np.arange(9) + 9 * sample, np.arange(9) + 9 * (sample + 2)
        np.testing.assert_allclose(at[row], np.diag(inverse)[own], rtol=1e-6)
        change = np.diag(inverse)[own] + np.diag(inverse)[later] - 2 * inverse[own, later]
        np.testing.assert_allclose(moved[row], change, rtol=1e-6)


def few_samples(walk) -> tuple[Unit, Legs, BaseMotion, Rotation]:
    """Twelve samples, and a motion that is off."""
    unit, legs, _ = measured(walk)
    part, rng = slice(100, 112), np.random.default_rng(1)
    assert unit.orientation is not None
    unit = Unit(unit.time[part], unit.gyro[part], unit.accelerometer[part], unit.orientation[part], unit.noise)
    legs = replace(legs, qpos=legs.qpos[part], qvel=legs.qvel[part])
    mount = Rotation.from_rotvec([0.02, -0.03, 0.01])
    start = first_estimate(unit, legs, mount)
    velocity = start.velocity + 0.1 * rng.standard_normal((12, 3))
    return unit, legs, replace(start, biases=np.full(6, 0.01), velocity=velocity), mount


def changed(motion: BaseMotion, index: int, step: float, samples: slice) -> BaseMotion:
    """A motion with one coordinate of some samples moved."""
    change = np.zeros((len(motion.place), 9))
    change[samples, index] = step
    return replace(
        motion,
        place=motion.place + change[:, :3],
        velocity=motion.velocity + change[:, 3:6],
        turn=motion.turn * Rotation.from_rotvec(change[:, 6:]),
    )


def border_changed(motion: BaseMotion, mount: Rotation, index: int, step: float) -> tuple[BaseMotion, Rotation]:
    """A motion and a mount with one of the common unknowns moved."""
    border = step * (np.array(COMMONS) == index)
    return replace(motion, biases=motion.biases + border[3:]), Rotation.from_rotvec(border[:3]) * mount


def test_derivatives_with_respect_to_the_delay_are_differences(walk):
    unit, _, start, mount = few_samples(walk)
    t, turns = unit.time[:, None], np.arange(1.0, 4.0)
    smooth = replace(
        unit,
        gyro=np.sin(20 * t + turns),
        accelerometer=np.array([0, 0, 9.81]) + np.cos(15 * t - turns),
        orientation=Rotation.from_rotvec(-0.05 * np.cos(20 * t + turns)),
    )
    start = replace(start, turn=smooth.orientation * mount.inv(), biases=np.zeros(6))

    def rows(shift: float) -> list[BlockRows]:
        moved = smooth.earlier(shift)
        inertia = inertia_of(moved, start, mount)
        return [
            propagation(moved, start, inertia, MODEL.opt.gravity),
            tilts(moved, start, mount)[0],
        ]

    step = float(np.diff(unit.time)[0])
    for low, own, high in zip(rows(-step), rows(0.0), rows(step), strict=True):
        inside = (own.sample > 1) & (own.sample < 9)
        difference = ((high.residual - low.residual) / (2 * step))[inside]
        found = own.border[..., 3][inside]
        assert np.abs(found).max() > 0.1
        np.testing.assert_allclose(difference, found, atol=0.1 * np.abs(found).max())


@pytest.mark.parametrize("index", range(9))
def test_derivatives_of_residuals_are_differences(walk, index):
    unit, _, start, mount = few_samples(walk)

    def rows(motion: BaseMotion, turned: Rotation) -> list[BlockRows]:
        inertia = inertia_of(unit, motion, turned)
        return [propagation(unit, motion, inertia, MODEL.opt.gravity), tilts(unit, motion, turned)[0]]

    step, even = 1e-6, slice(0, None, 2)
    base, moved = rows(start, mount), rows(changed(start, index, step, even), mount)
    beside, common = rows(*border_changed(start, mount, COMMONS[index], step)), COMMONS[index]
    for own, after, other in zip(base, moved, beside, strict=True):
        later = np.zeros_like(own.slope) if own.ahead is None else own.ahead
        expected = np.where((own.sample % 2 == 0)[:, None], own.slope[..., index], later[..., index])
        for found, value in ((after, expected), (other, own.border[..., common])):
            np.testing.assert_allclose(
                (found.residual - own.residual) / step, value, atol=0.02 * (np.abs(value).max() + 1)
            )


@pytest.mark.parametrize("index", range(16))
def test_points_pull_as_the_likelihood_of_touching_or_not(walk, index):
    """Residuals times derivatives are the slope of a likelihood: a point stands, slides, or is away."""
    unit, legs, start, mount = few_samples(walk)

    def surprise(motion: BaseMotion, turned: Rotation, delay: float = 0.0) -> float:
        inertia = inertia_of(unit.earlier(delay), motion, turned)
        points, total = legs.points(motion.place, motion.turn), 0.0
        for n, k in enumerate(points.sample):
            arm = points.place[n]
            speed = motion.turn[k].inv().apply(motion.velocity[k]) + np.cross(inertia.spin[k], arm) + points.velocity[n]
            across = np.cross(np.eye(3), arm)
            variance = points.velocity_covariance[n] + 0.005**2 * across.T @ across + motion.slip.sigma**2 * np.eye(3)
            load = max(motion.turn[k].apply(inertia.force[k])[2] / 9.81, 0.0)
            gap = points.distance[n] + motion.softness * load / max(motion.carrying[k], 1.0)
            wide = points.distance_variance[n] + motion.gap.sigma**2
            near = np.exp(-0.5 * gap**2 / wide) / np.sqrt(2 * np.pi * wide)
            standing = np.exp(-0.5 * speed @ np.linalg.solve(variance, speed))
            standing /= np.sqrt((2 * np.pi) ** 3 * np.linalg.det(variance))
            total -= np.log(near * (standing + 1 / 2.0**3) + 1 / (2.0**3 * 0.04))
        return total

    seen = legs.points(start.place, start.turn)
    rows, *_ = touches(seen, unit, start, inertia_of(unit, start, mount), MODEL.opt.gravity)
    own, step = index % 9, 1e-6
    if index < 9:
        low, high = (surprise(changed(start, own, sign * step, slice(None)), mount) for sign in (-1, 1))
        slope = rows.slope
    elif index == 15:
        low, high = (surprise(start, mount, sign * step) for sign in (-1, 1))
        slope, own = rows.border, 3
    else:
        low, high = (surprise(*border_changed(start, mount, COMMONS[own], sign * step)) for sign in (-1, 1))
        slope, own = rows.border, COMMONS[own]
    pulls = (slope[..., own] * rows.residual).sum(1)
    assert (high - low) / (2 * step) == pytest.approx(pulls.sum(), abs=0.05 * np.abs(pulls).sum() + 1e-3)


def test_points_move_as_their_velocities_say(walk):
    _, qpos, qvel = walk
    own, step = qpos[51:52], 1e-6
    after = own.copy()
    mujoco.mj_integratePos(MODEL, after[0], qvel[51], step)
    base = MODEL.body("trunk").id
    one, other = (touching_points(MODEL, base, PLACE, q, qvel[51:52], SIGMA, 0.05) for q in (own, after))
    assert len(one.sample) >= 4
    turn = Rotation.from_quat(own[0, 3:7], scalar_first=True)
    arm = np.cross(qvel[51, 3:6], one.place) + one.velocity
    speed = turn.apply(arm) + qvel[51, :3] + turn.apply(np.cross(qvel[51, 3:6], PLACE))
    np.testing.assert_allclose((other.distance - one.distance) / step, speed[:, 2], atol=1e-4)
    np.testing.assert_allclose(one.distances(one.world + np.array([0.1, 0.2, 0.03])), one.distance + 0.03, atol=1e-9)


def test_feet_sink_until_they_carry_the_robot():
    model = mujoco.MjModel.from_xml_string(ROBOT.xml)
    data = mujoco.MjData(model)
    for _ in range(4000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    deepest = -np.mean([contact.dist for contact in data.contact])
    still = np.tile(data.qpos, (20, 1))
    still[:, 2] += deepest  # feet touch, and carry nothing
    base = model.body("trunk").id
    legs = Legs(model, base, np.zeros(3), still, np.zeros((20, model.nv)), np.repeat([1e-3, 0.05], model.nv))
    turn = Rotation.from_quat(still[:, 3:7], scalar_first=True)
    assert legs.softness(still[:, :3], turn) == pytest.approx(len(data.contact) * deepest, rel=0.1)


def test_scatter_of_a_process_of_first_order():
    rng, correlation = np.random.default_rng(0), 0.8
    values = rng.standard_normal((40_000, 1))
    for i in range(1, len(values)):
        values[i] = correlation * values[i - 1] + np.sqrt(1 - correlation**2) * values[i]
    noisy = 0.3 * values + 0.1 * rng.standard_normal(values.shape)
    ones = np.ones(len(values))
    index = np.arange(len(values))
    found = scatter_of(noisy, (index[:-1], index[1:]), ones, 0.1**2 * ones, 1e-6)
    assert found.sigma == pytest.approx(0.3, rel=0.05)
    assert found.alike == pytest.approx((1 + correlation) / (1 - correlation), rel=0.15)
