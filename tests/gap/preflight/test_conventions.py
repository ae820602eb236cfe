"""Errors of convention are named before any fit, with their remedy; sound data and physical effects are not accused."""

import re
from collections.abc import Callable
from functools import cache

import imu_logs
import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset
from btr_mjx.gap.preflight import preflight, refuse_errors
from btr_mjx.gap.preflight.comparison import CHANCE, compare
from btr_mjx.gap.preflight.predictions import Change, ColumnMap
from btr_mjx.gap.preflight.velocities import rotations
from tests.support.convention_logs import ARM, CART, FLOATER, FLYER, dataset, log, planted, sines

DEGREES = 180 / np.pi
Arrays = dict[str, np.ndarray]
Plant = Callable[[Arrays], None]


def arm(edit: Callable[[mujoco.MjModel], None] = lambda model: None, seed: int = 0) -> Dataset:
    rng = np.random.default_rng(seed)
    return dataset(ARM, [log(ARM, sines(rng, [0.9, 0.8, 0.8]), i, edit=edit) for i in range(2)])


def floater() -> Dataset:
    rng = np.random.default_rng(1)
    recordings = []
    for i in range(2):
        qpos = np.concatenate([rng.normal(size=3), rng.normal(size=4), np.zeros(2)])
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        start = qpos, np.concatenate([rng.uniform(-1, 1, 6), np.zeros(2)])
        recordings.append(log(FLOATER, sines(rng, [1.0, 1.0]), i, rate=100, start=start))
    return dataset(FLOATER, recordings)


def cart() -> Dataset:
    rng = np.random.default_rng(2)
    start = np.array([0.0, 0.8]), np.zeros(2)
    return dataset(CART, [log(CART, sines(rng, [5.0]), i, seconds=5.0, rate=100, start=start) for i in range(2)])


ROBOTS = {"arm": arm, "floater": floater, "cart": cart}


@cache
def sound(robot: str) -> Dataset:
    return ROBOTS[robot]()


def scaled(factor: float, **columns: int | slice | list[int]) -> Plant:
    def plant(arrays: Arrays) -> None:
        for name, own in columns.items():
            arrays[name][:, own] *= factor

    return plant


def swapped(a: int, b: int, *names: str) -> Plant:
    def plant(arrays: Arrays) -> None:
        for name in names:
            arrays[name][:, [a, b]] = arrays[name][:, [b, a]]

    return plant


def both(*plants: Plant) -> Plant:
    def plant(arrays: Arrays) -> None:
        for one in plants:
            one(arrays)

    return plant


def turned(columns: slice, inverse: bool) -> Plant:
    def plant(arrays: Arrays) -> None:
        turn = rotations(arrays["qpos"][:, 3:7])
        arrays["qvel"][:, columns] = np.einsum(
            "kji,kj->ki" if inverse else "kij,kj->ki", turn, arrays["qvel"][:, columns]
        )

    return plant


def xyzw(arrays: Arrays) -> None:
    arrays["qpos"][:, 3:7] = arrays["qpos"][:, [4, 5, 6, 3]]


def errors(data: Dataset) -> list[str]:
    return [f.message for f in preflight(data) if f.level == "error"]


@pytest.mark.parametrize("robot", ROBOTS)
def test_sound_data_are_not_accused(robot: str) -> None:
    """Logs are simulated with finer steps than models have, which may be told."""
    findings = preflight(sound(robot))
    assert [f.message for f in findings if f.level != "note" and f.topic != "time step"] == []


def friction(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[:] = 0.3


def weak(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0] *= 0.2
    model.actuator_biasprm[1, 1] *= 0.2


def dead(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1], model.actuator_biasprm[1] = 0, 0


def payload(model: mujoco.MjModel) -> None:
    model.body_mass[3] *= 4


@pytest.mark.parametrize("edit", [friction, weak, dead, payload])
def test_physical_effects_are_not_accused(edit: Callable[[mujoco.MjModel], None]) -> None:
    assert errors(arm(edit)) == []


CASES: dict[str, tuple[str, Plant, str]] = {
    "encoder": ("arm", scaled(-1, qpos=1, qvel=1), r"qpos/elbow counts the other way|ctrl/elbow has the opposite sign"),
    "command": ("arm", scaled(-1, ctrl=0), r"ctrl/shoulder has the opposite sign|qpos/shoulder counts the other way"),
    "axis": ("arm", scaled(-1, qpos=1, qvel=1, ctrl=1), r"qpos/elbow and ctrl/elbow both have the opposite sign"),
    "velocity": ("arm", scaled(-1, qvel=2), r"qvel/wrist has the opposite sign of the slope"),
    "degrees of one joint": ("arm", scaled(DEGREES, qpos=1, qvel=1), r"qpos/elbow looks like degrees"),
    "degrees": (
        "arm",
        scaled(DEGREES, qpos=slice(0, 3), qvel=slice(0, 3), ctrl=slice(0, 3)),
        r"all hinges look like deg",
    ),
    "degrees/s": ("arm", scaled(DEGREES, qvel=1), r"qvel/elbow looks like degrees/s"),
    "rpm": ("arm", scaled(60 / 2 / np.pi, qvel=1), r"qvel/elbow looks like revolutions per minute"),
    "counts": ("arm", scaled(4096 / 2 / np.pi, qpos=1, qvel=1, ctrl=1), r"looks like encoder counts, 4096 a turn"),
    "swapped": ("arm", swapped(0, 1, "qpos", "qvel"), r"qpos/.* and qpos/.* are swapped"),
    "commands swapped": (
        "arm",
        swapped(1, 2, "ctrl"),
        r"ctrl/elbow and ctrl/wrist are swapped|ctrl/wrist and ctrl/elbow",
    ),
    "two faults": ("arm", both(scaled(-1, qvel=2), scaled(DEGREES, qpos=1, qvel=1)), r"qpos/elbow looks like degrees"),
    "world": ("floater", turned(slice(3, 6), False), r"qvel/root/wx, wy, wz are in the world's frame"),
    "body": ("floater", turned(slice(0, 3), True), r"qvel/root/vx, vy, vz are in the body's frame"),
    "spin in degrees/s": ("floater", scaled(DEGREES, qvel=slice(3, 6)), r"wz are in degrees/s"),
    "xyzw": ("floater", xyzw, r"x, y, z, w"),
    "mm": ("cart", scaled(1e3, qpos=0, qvel=0), r"qpos/slider looks like millimetres"),
    "mm/s": ("cart", scaled(1e3, qvel=0), r"qvel/slider looks like mm/s"),
    "passive degrees": ("cart", scaled(DEGREES, qpos=1, qvel=1), r"qpos/pole looks like degrees"),
    "force": ("cart", scaled(-1, ctrl=0), r"ctrl/force has the opposite sign|qpos/slider counts the other way"),
    "mN": ("cart", scaled(1e3, ctrl=0), r"ctrl/force looks like thousandths"),
}


@pytest.mark.parametrize("case", CASES)
def test_errors_of_convention_are_named(case: str) -> None:
    robot, plant, message = CASES[case]
    found = [f for f in preflight(planted(sound(robot), plant)) if f.level == "error"]
    assert any(re.search(message, f.message) for f in found), [f.message for f in found]
    assert all(f.remedy and f.evidence for f in found)
    with pytest.raises(InputError, match=r"^fix the data first: "):
        refuse_errors(found)


@pytest.mark.parametrize("case", ["encoder", "mm", "passive degrees", "swapped", "xyzw"])
def test_they_are_named_without_measured_velocities(case: str) -> None:
    robot, plant, message = CASES[case]
    found = errors(planted(sound(robot), plant, measured=False))
    assert any(re.search(message, text) for text in found), found


def test_a_robot_whose_motors_the_model_lacks_is_not_turned_over() -> None:
    """Without them it falls, and gravity that points up is nearer to what stood than gravity that points down."""
    log = {name: own for name, own in imu_logs.walk(4.0).items() if not name.startswith(("sensor", "ctrl"))}
    data = imu_logs.dataset(log, re.sub("<actuator>.*</actuator>", "", imu_logs.quadruped(""), flags=re.DOTALL))
    assert not [f.message for f in preflight(data) if f.level == "error"]


def test_gravity_of_a_free_body_in_flight() -> None:
    """A falling and turning body without thrust: z of the data points down."""
    rng = np.random.default_rng(3)
    start = np.array([0, 0, 2, 1.0, 0, 0, 0]), rng.uniform(-2, 2, 6)

    def still(times: np.ndarray) -> np.ndarray:
        return np.zeros((len(times), 1))

    data = dataset(FLYER, [log(FLYER, still, i, seconds=2.0, start=start) for i in range(2)])
    assert errors(data) == []  # "no joint moves" is no reason for a refusal: the body does
    found = errors(planted(data, both(scaled(-1, qpos=[1, 2, 5, 6]), scaled(-1, qvel=[1, 2, 4, 5]))))
    assert any("z down" in text or "gravity=" in text for text in found), found


def test_drifting_clocks() -> None:
    def drift(rate: float) -> Plant:
        def plant(arrays: Arrays) -> None:
            late = arrays["time"] * (1 + rate)
            arrays["ctrl"][:] = np.stack([np.interp(arrays["time"], late, c) for c in arrays["ctrl"].T], 1)

        return plant

    rng = np.random.default_rng(4)
    long = dataset(ARM, [log(ARM, sines(rng, [0.9, 0.8, 0.8]), i, seconds=8.0) for i in range(2)])
    assert errors(long) == []
    for rate in (0.002, -0.002):
        (found,) = (f for f in preflight(planted(long, drift(rate))) if f.level == "error")
        assert "clocks drift" in found.message
        assert found.evidence["drift_s_per_s"] == pytest.approx(-rate, rel=0.15)


def test_a_constant_delay_is_not_a_drift() -> None:
    def late(arrays: Arrays) -> None:
        arrays["ctrl"][:] = np.stack([np.interp(arrays["time"] + 0.02, arrays["time"], c) for c in arrays["ctrl"].T], 1)

    assert errors(planted(sound("arm"), late)) == []


@pytest.mark.parametrize("slower", [False, True])
def test_a_delay_that_follows_the_motion_is_not_a_drift(slower: bool) -> None:
    """Friction and damping that the model lacks, in a sweep of frequency on one clock."""

    def sweep(times: np.ndarray) -> np.ndarray:
        since = 12 - times if slower else times
        return np.sin(2 * since + 10 / 24 * since**2)[:, None] * [0.6, 0.5, 0.5]

    def rough(model: mujoco.MjModel) -> None:
        model.dof_damping *= 3
        friction(model)

    assert errors(dataset(ARM, [log(ARM, sweep, i, seconds=12.0, rate=200, edit=rough) for i in range(2)])) == []


def test_chances_are_those_of_sign_test_and_t_test() -> None:
    from scipy.stats import binomtest, ttest_1samp

    now, other = np.full(30, 2.0), np.r_[np.full(26, 1.9), np.full(3, 9.0), 2.0]
    found = compare(now, other)
    assert (found.wins, found.stretches) == (26, 29)
    assert found.ratio == pytest.approx(2 / 1.9)
    assert found.chance == pytest.approx(2 * binomtest(26, 29, 0.5, "greater").pvalue)
    assert found.decisive(1.0) == (found.chance < CHANCE)
    assert not found.decisive(1.1)
    assert not compare(now, now).decisive(0.0)
    few = np.random.default_rng(8).uniform(50, 200, 8)
    found = compare(few, np.ones(8))
    assert found.chance == pytest.approx(2 * ttest_1samp(np.log(few), 0, alternative="greater").pvalue)
    assert found.decisive(9)
    assert not compare(few[:3], np.ones(3)).decisive(9)


def test_column_maps_compose() -> None:
    rng = np.random.default_rng(5)
    first, second = (ColumnMap(rng.permutation(4), rng.normal(size=4), rng.normal(size=4)) for _ in range(2))
    values = rng.normal(size=(7, 4))
    np.testing.assert_allclose(second.after(first)(values), second(first(values)))
    model = mujoco.MjModel.from_xml_string(CART)
    change = Change(ColumnMap.affine(2), ColumnMap.affine(1), (0.0, 0.0, 1.0), (0,))
    assert Change.none(model).after(change).gravity == (0.0, 0.0, 1.0)


def test_advice_about_velocities_is_for_joints_that_move() -> None:
    """A gripper that moves no further than its noise has a velocity that is noise: that is not a wrong sign."""

    def still(arrays: Arrays) -> None:
        rng = np.random.default_rng(6)
        arrays["qpos"][:, 2] = 3e-4 * rng.normal(size=len(arrays["time"]))
        arrays["qvel"][:, 2] = 5e-3 * rng.normal(size=len(arrays["time"]))
        arrays["ctrl"][:, 2] = 0

    findings = preflight(planted(sound("arm"), still))
    assert not any("qvel/wrist" in f.message or "qpos/wrist" in f.message for f in findings)
    assert any("no further than their noise: wrist" in f.message for f in findings)


def test_thrusters_at_sites_show_their_gain() -> None:
    rng = np.random.default_rng(7)
    wave = sines(rng, [2.0])
    data = dataset(FLYER, [log(FLYER, lambda t: 9.8 + wave(t), i, seconds=2.0) for i in range(2)])
    blind = [f.message for f in preflight(data) if f.message.startswith("these data cannot show")]
    assert not any("actuator_gain" in text or "actuator_delay" in text for text in blind)


def test_a_coarse_encoder_is_a_warning() -> None:
    def coarse(arrays: Arrays) -> None:
        arrays["qpos"][:, 1] = np.round(arrays["qpos"][:, 1] / 0.2) * 0.2

    warnings = [f.message for f in preflight(planted(sound("arm"), coarse)) if f.level == "warning"]
    assert any("qpos/elbow takes only" in text and "0.2 apart" in text for text in warnings)
