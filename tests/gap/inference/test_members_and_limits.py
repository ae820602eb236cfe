"""Names of effects whose sizes differ between joints, and of limits, of an arm."""

import dataclasses

import numpy as np
import pytest
from gap_arm import LIBRARY, QUICK, dataset, recording

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, identify
from btr_mjx.gap.inference.scoring.screening import screen
from btr_mjx.gap.simulate import Command


def test_each_joint_has_a_number_of_its_own() -> None:
    def heavier(model):
        model.dof_armature[:] += [0.05, 0.015]

    found = identify(dataset(heavier, seed=3), LIBRARY, options=QUICK)
    (named,) = found.effects
    assert named.name == "armature@each:all"
    shoulder, elbow = named.parameters["armature[shoulder]"], named.parameters["armature[elbow]"]
    for estimate, truth in ((shoulder, 0.05), (elbow, 0.015)):
        assert estimate.low < truth < estimate.high
        assert estimate.high - estimate.low < 0.02 * truth
    assert found.gap.before > 1e3
    assert found.gap.after < 1.2


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
