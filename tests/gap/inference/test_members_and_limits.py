"""Names of effects whose sizes differ between joints, and of limits, of an arm."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, QUICK, dataset, recording

from btr_mjx.gap.data import DatasetDescription, Recording, load, save_dataset
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, identify
from btr_mjx.gap.inference.scoring.screening import screen
from btr_mjx.gap.inference.search.naming import TOLERANCES, within_calibration
from btr_mjx.gap.simulate import Command

NAME = "viscous_damping@each:all"


def test_each_joint_has_a_number_of_its_own() -> None:
    def heavier(model):
        model.dof_armature[:] += [0.05, 0.015]

    found = identify(dataset(heavier, seed=4), LIBRARY, options=QUICK)
    (named,) = found.effects
    assert named.name == "armature@each:all"
    shoulder, elbow = named.parameters["armature[shoulder]"], named.parameters["armature[elbow]"]
    for estimate, truth in ((shoulder, 0.05), (elbow, 0.015)):
        assert estimate.low < truth < estimate.high
        assert estimate.high - estimate.low < 0.03 * truth
    assert found.chi2.before > 1e3
    assert found.chi2.after < 1.2


def test_one_number_is_enough_where_the_joints_are_alike() -> None:
    def heavier(model):
        model.dof_armature[:] += 0.005

    (named,) = identify(dataset(heavier, seed=3), LIBRARY, options=QUICK).effects
    assert named.name == "armature@all"


def test_signatures_of_members_are_those_of_single_joints() -> None:
    bench = Bench(dataset(seed=1, fit=2, test=1), LIBRARY, QUICK)
    entries = bench.scanner.screened.entries
    index = {entry.candidate.name: i for i, entry in enumerate(entries) if not entry.probe}
    found = screen(bench.fit.windows, bench.base, entries, bench.single)
    each = found.signature(index["armature@each:all"])
    for i, joint in enumerate(("shoulder", "elbow")):
        single = index[f"armature@joint:{joint}"]
        per_unit = found.signature(single)[0] / entries[single].steps[0]
        np.testing.assert_allclose(each[i] / entries[index["armature@each:all"]].steps[i], per_unit, rtol=1e-5)


def test_a_limit_of_the_commands_rate_is_named() -> None:
    limit = 2.0

    def arrive(sent: Command, time: np.ndarray) -> np.ndarray:
        wanted, out = sent.at(time), np.empty((len(time), 2))
        now, reach = sent.at(sent.times[:1])[0], limit * (time[1] - time[0])
        for k, there in enumerate(wanted):
            now = now + np.clip(there - now, -reach, reach)
            out[k] = now
        return out

    slow = tuple(
        recording(f"r{i}", None, 700 + i, "fit" if i < 3 else "test", duration=0.7, arrive=arrive) for i in range(5)
    )
    model = slow[0].model
    data = dataclasses.replace(dataset(seed=7), recordings=tuple(dataclasses.replace(r, model=model) for r in slow))
    limits = [effect for effect in EFFECTS if effect.saturates]
    (named,) = identify(data, (*LIBRARY, *limits), options=QUICK).effects
    assert named.name == "command_rate_limit@all"
    assert named.parameters["limit"].value == pytest.approx(limit, rel=0.02)
    assert named.parameters["limit"].unit == "rad/s"


FIVE = """<mujoco model="arm5"><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
<default><geom type="capsule" contype="0" conaffinity="0"/><joint damping="1" armature="0.01"/></default>
<worldbody><body pos="0 0 0.3"><joint name="j1" axis="0 0 1"/><geom fromto="0 0 0 0 0 0.15" size="0.05" mass="3"/>
<body pos="0 0 0.15"><joint name="j2" axis="0 1 0"/><geom fromto="0 0 0 0 0 0.3" size="0.04" mass="3"/>
<body pos="0 0 0.3"><joint name="j3" axis="0 1 0"/><geom fromto="0 0 0 0.25 0 0" size="0.035" mass="2"/>
<body pos="0.25 0 0"><joint name="j4" axis="1 0 0"/><geom fromto="0 0 0 0.1 0 0" size="0.03" mass="1"/>
<body pos="0.1 0 0"><joint name="j5" axis="0 1 0"/><geom fromto="0 0 0 0.1 0 0.02" size="0.025" mass="0.6"/>
</body></body></body></body></body></worldbody>
<actuator><position name="j1" joint="j1" kp="400" kv="40"/><position name="j2" joint="j2" kp="400" kv="40"/>
<position name="j3" joint="j3" kp="300" kv="30"/><position name="j4" joint="j4" kp="100" kv="10"/>
<position name="j5" joint="j5" kp="100" kv="10"/></actuator></mujoco>"""


@pytest.mark.slow
def test_five_rotors_of_an_arm(tmp_path: Path) -> None:
    """All are believed to be 0.01; each is found as well as gains are known, and the gap falls to twice the noise.

    A motor that is 3 % weaker with a rotor that is 3 % lighter moves nearly alike.
    """
    rotors = np.array([0.5, 0.4, 0.3, 0.2, 0.1])
    real = mujoco.MjModel.from_xml_string(FIVE)
    real.dof_armature[:], real.opt.timestep = rotors, 1e-4
    believed, rng, recordings = mujoco.MjModel.from_xml_string(FIVE), np.random.default_rng(0), []
    time = np.arange(1600) / 400
    for k in range(6):
        hertz, phase, size = (rng.uniform(*r, (3, 5)) for r in ((0.4, 2.0), (0.0, 6.28), (0.1, 0.3)))

        def command(t: float, own: tuple = (hertz, phase, size)) -> np.ndarray:
            waves = own[2] * (np.sin(6.283 * own[0] * t + own[1]) - np.sin(own[1]))
            return waves.sum(0) * min(1.0, 2 * t)

        data, states = mujoco.MjData(real), []
        for t in time:
            states.append(np.concatenate([data.qpos, data.qvel]))
            while data.time < t + 1 / 400 - 5e-5:
                data.ctrl[:] = command(data.time)
                mujoco.mj_step(real, data)
        seen = np.array(states) + rng.normal(size=(1600, 10)) * np.repeat([1e-4, 1e-2], 5)
        ctrl, split = np.array([command(t) for t in time]), "fit" if k < 4 else "test"
        measured = np.zeros(5, bool)  # velocities, which are not read
        recordings.append(Recording(f"r{k}", time, ctrl, seen[:, :5], seen[:, 5:], measured, split, believed))
    save_dataset(tmp_path, FIVE, recordings, DatasetDescription(interpolation="cubic"))
    found = identify(load(tmp_path))
    (named,) = found.effects
    assert named.name == "armature@each:all"
    values = np.array([named.parameters[f"armature[j{i}]"].value for i in range(1, 6)])
    np.testing.assert_allclose(values, rotors - 0.01, rtol=0.015)
    for truth, own in zip(rotors - 0.01, named.parameters.values(), strict=True):
        assert own.low < truth < own.high
    assert found.chi2.after < 2 * found.chi2.nulls


@pytest.mark.parametrize(("factors", "expected"), [((1.1, -0.5), True), ((0.3, 0.5), True), ((3.0, 0.5), False)])
def test_members_a_little_beyond_calibration_are_no_name(factors: tuple[float, float], expected: bool) -> None:
    """Sizes in units of the largest that is not called by name, of each joint."""

    usual = Bench(dataset(seed=5), LIBRARY, QUICK)
    each = next(c for c in usual.candidates if c.name == NAME)
    most = [
        max(parameter.negligible, TOLERANCES * usual.tolerances[single.name])
        for parameter, single in zip(each.parameters, each.singles, strict=True)
    ]

    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[:] += np.multiply(factors, most)

    bench = Bench(dataset(damped, seed=5), LIBRARY, QUICK)
    candidate = next(c for c in bench.candidates if c.name == NAME)
    start = bench.started(bench.base, candidate, [np.multiply(factors, most)])
    found = bench.refined(bench.fit, [start], [3], bench.reference[0])
    (judged,) = bench.judge([start[0].replaced(found[0].values, False)], found, (bench.fit, bench.test))
    assert within_calibration(bench, judged) is expected
