"""What moves contacts against what calibration of its limb explains."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from gap_arm import elbow_off

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.inference.search import calibrated
from btr_mjx.gap.inference.search.calibrated import besides, beyond_calibration, limb_of
from btr_mjx.gap.inference.search.polish import Polisher
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.windows import Options


@pytest.fixture(scope="module")
def bench() -> Bench:
    """An arm whose elbow is 20 mrad off, as if it touched something."""
    offsets = tuple(effect for effect in EFFECTS if effect.name == "joint_offset")
    return Bench(elbow_off(), offsets, Options(steps=4e4, leaders=2, contact_leaders=0))


@pytest.fixture(scope="module")
def leading(bench: Bench) -> Judged:
    found = next(j for j in Polisher(bench)(bench.find()) if "joint_offset" in j.name)
    assert found.score > 15
    return found


def touching(bench: Bench, tolerance: float) -> Bench:
    """The same with offsets that move contacts, known to so many radians."""
    own = copy.copy(bench)
    own.delicate = {c.name for c in bench.candidates if c.effect.name == "joint_offset"}
    own.dataset = replace(bench.dataset, tolerances={"joint_offset": tolerance})
    return own


def test_a_limb_is_asked_for_all_that_moves_its_contacts(bench: Bench, leading: Judged) -> None:
    names = {c.name for c in limb_of(touching(bench, 1e-3), leading)}
    assert names == {"joint_offset@joint:shoulder", "joint_offset@joint:elbow"}
    assert limb_of(bench, leading) == []  # nothing touches
    assert limb_of(touching(bench, 0.0), leading) == []  # calibration knows it to be right


def test_what_calibration_knows_it_cannot_explain(bench: Bench, leading: Judged) -> None:
    """The looser an offset is known, the less of its gain is beyond calibration."""
    exact, loose, unknown = (beyond_calibration(touching(bench, sigma), leading).gain for sigma in (1e-5, 5e-3, 1.0))
    whole = leading.gain + leading.held_out
    assert exact == pytest.approx(whole, rel=0.5)
    assert exact > loose > unknown
    assert abs(unknown) < 0.1 * whole  # then it is calibration
    assert beyond_calibration(bench, leading).gain == np.inf


@pytest.mark.parametrize(
    ("gains", "expected", "looks"),
    [
        ([30.7, 135.0, 101.0], 30.7, 2),  # new starting states happened to suit calibration worse
        ([84.0, 20.0, 10.0], 10.0, 2),
        ([300.0, 150.0], 150.0, 1),  # clear
        ([10.0], 10.0, 0),
    ],
)
def test_a_gain_beyond_calibration_is_there_at_every_look(
    bench: Bench, leading: Judged, monkeypatch: pytest.MonkeyPatch, gains: list[float], expected: float, looks: int
) -> None:
    seen, suited = iter(gains), []
    monkeypatch.setattr(calibrated._Both, "gain", lambda self: next(seen))
    monkeypatch.setattr(calibrated._Both, "suit", lambda self, which: suited.append(which))
    monkeypatch.setattr(calibrated._Both, "refine", lambda self: None)
    assert beyond_calibration(touching(bench, 5e-3), leading).gain == expected
    assert suited == [0, 1] * looks


def test_what_calibration_explains_is_a_believed_model_for_others(bench: Bench, leading: Judged) -> None:
    """Where an offset is hardly known, calibration takes it over; the same offset beside it has nothing left to say."""
    own = touching(bench, 1.0)
    believed = beyond_calibration(own, leading).calibrated
    assert (believed.effects, believed.numbers, believed.name) == ((), 0, "nothing")
    value = {c.name: v[0] for c, v in believed.calibration}["joint_offset@joint:elbow"]
    assert value == pytest.approx(leading.hypothesis.effects[0][1][0], rel=0.2)
    (again,) = besides(bench, believed, [leading.hypothesis])
    assert again.hypothesis.calibration == believed.calibration
    assert again.score < 5
    assert besides(bench, believed, []) == []
