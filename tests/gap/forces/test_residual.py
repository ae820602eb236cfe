"""A smooth table of a force that no term of any dictionary is."""

import json

import mujoco
import numpy as np
import pytest
from gap_arm import XML, arm
from gap_forces import arm_side, arm_stretches, believed, moved_arm

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import ResidualTable
from btr_mjx.gap.forces.residual import fit_residual
from btr_mjx.gap.forces.search import start
from btr_mjx.gap.results import Callback, mend, with_residual


def strange(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    return np.array([0.0, 0.5 * np.tanh(3 * v[1]) * np.exp(-4 * q[1] ** 2)])


def tables(force) -> tuple[ResidualTable, ...]:
    sides = [
        arm_side(arm_stretches([moved_arm(f"r{i}", 10 * k + i, force=force, seconds=1.2) for i in range(3)]), [])
        for k in range(2)
    ]
    side, fit = sides[0], start(sides[0], believed())
    return fit_residual(side, sides[1], fit.point, fit.variances)


def test_a_strange_force_becomes_a_table_that_a_callback_plays():
    found = tables(strange)
    assert [table.joint for table in found] == ["elbow"]
    mended = with_residual(mend(XML, []), found)
    model = mujoco.MjModel.from_xml_string(mended.xml)
    missing = Callback(model, json.loads(json.dumps(mended.terms)))
    data, fresh = mujoco.MjData(model), moved_arm("fresh", 99, force=strange, seconds=1.2)
    true, played = [], []
    for q, v, u in zip(fresh.qpos, fresh.qvel, fresh.commands[1], strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(model, data)
        missing(model, data)
        true.append(strange(q, v, 0.0)[1])
        played.append(data.qfrc_applied[1])
        assert data.qfrc_applied[0] == 0
    error = np.sqrt(np.mean(np.subtract(played, true) ** 2) / np.mean(np.square(true)))
    assert error < 0.4


def test_nothing_becomes_no_table():
    assert tables(None) == ()


def test_a_table_ends_with_the_recorded_range():
    centres = np.random.default_rng(0).uniform(0, 1, (7, 3))
    centres[:3, 1] = np.nan
    table = ResidualTable("elbow", np.zeros(3), np.full(3, 2.0), centres, np.full(7, 0.3), np.zeros(7))
    again = ResidualTable.from_json(json.loads(json.dumps(table.as_json())))
    ends = [
        of.features(*(np.array([x]) for x in at)) for of, at in ((table, (9.0, -9.0, 1.0)), (again, (2.0, 0.0, 1.0)))
    ]
    np.testing.assert_array_equal(*ends)
    np.testing.assert_array_equal(*(table.features(1.0, v, 1.0)[:3] for v in (0.2, 1.7)))


def test_another_robot_is_refused():
    table = ResidualTable("wrist", np.zeros(3), np.ones(3), np.zeros((1, 3)), np.full(1, 0.3), np.zeros(1))
    with pytest.raises(InputError, match="wrist"):
        table.candidate(arm())
