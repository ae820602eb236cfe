"""What has changed between two sets of recordings: named where something did, nothing where nothing did."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gap_arm import XML
from gap_forces import arm_dataset
from gap_systems import SYSTEMS

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces import Changes, check_same_robot, identify_changes
from btr_mjx.gap.forces.evidence import CalibrationPrior, least_squares
from btr_mjx.models import PathParameter

OWN = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "dry_friction", "actuator_gain", "payload"))


def uncalibrated(model: mujoco.MjModel) -> None:
    """What nobody has calibrated, and is the same in both sets."""
    model.actuator_gainprm[0] *= 1.04
    model.actuator_biasprm[0] *= 1.04
    model.dof_damping[:] *= 1.6
    for body, factor in ((1, 1.04), (2, 0.97)):
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor


def stickier(model: mujoco.MjModel) -> None:
    uncalibrated(model)
    model.dof_frictionloss[1] += 0.05


@pytest.fixture(scope="module")
def found() -> Changes:
    """Three sets: nothing changes from the first to the second one, and friction and the file before the third."""
    first, second, third = (
        arm_dataset(21 + i, 2, 1, change=change) for i, change in enumerate((uncalibrated, uncalibrated, stickier))
    )
    newer = replace(third, spec_xml=XML.replace('mass="0.5"', 'mass="0.6"'), model_file=Path("newer.xml"))
    return identify_changes([first, second, newer], OWN, 1)


def test_nothing_has_changed_in_a_robot_that_nobody_has_calibrated(found: Changes):
    before, after = found.diagnoses[:2]
    assert before.verdict == "effect"
    assert (after.verdict, after.effects) == ("none", ())
    # What was named before is part of the robot now.
    assert {e.effect for e in before.effects} <= {e.effect for e in after.calibration}


def test_a_change_is_named_beside_what_the_model_lacks_in_all_sets(found: Changes):
    after = found.diagnoses[2]
    assert [e.name for e in after.effects] == ["dry_friction@joint:elbow"]
    (own,) = after.effects[0].parameters.values()
    assert own.value == pytest.approx(0.05, rel=0.1)
    row = next(q for q in found.quantities if (q.effect, q.location) == ("dry_friction", "joint:elbow"))
    assert row.named == (False, False, True)
    assert row.value[0] == row.value[1]
    assert row.value[2] - row.value[1] == pytest.approx(own.value, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_posterior_as_a_prior_is_joint_least_squares_of_both_sets(seed):
    """Effects act on the second set only, calibration on both: by all rows at once, and one set after the other."""
    rng = np.random.default_rng(seed)
    first, second = rng.standard_normal((30, 3)), rng.standard_normal((20, 3))
    first[:, 2] = first[:, 1] + 0.05 * rng.standard_normal(30)  # what the first set hardly tells apart
    effect, left = rng.standard_normal((20, 2)), (rng.standard_normal(30), rng.standard_normal(20))
    tolerance = np.array([0.3, 2.0, 2.0])
    joint = np.block([[np.zeros((30, 2)), first], [effect, second], [np.zeros((3, 2)), np.diag(1 / tolerance)]])
    expected = np.linalg.lstsq(joint, -np.concatenate([*left, np.zeros(3)]))[0]

    precision = first.T @ first + np.diag(1 / tolerance**2)
    mean = np.linalg.solve(precision, -first.T @ left[0])
    rows = np.concatenate([(left[1] + second @ mean)[:, None], effect, second], 1)
    design = np.eye(5)[:, 2:]
    sigma = np.sqrt(np.diag(np.linalg.inv(precision)))
    prior = CalibrationPrior(design, sigma, np.full(3, 99.0), np.zeros(3), precision)
    found = least_squares(rows.T @ rows, np.eye(5)[:, :2], prior)
    np.testing.assert_allclose(found.values, expected[:2], atol=1e-7)
    np.testing.assert_allclose(mean + found.calibration, expected[2:], atol=1e-7)


def test_recordings_of_other_robots_are_refused():
    own = arm_dataset(1, 1, 1)
    other = replace(own, model=mujoco.MjModel.from_xml_string(XML.replace('"elbow"', '"wrist"')))
    with pytest.raises(InputError, match=r"not the same robot, joint elbow, wrist is in one of them only"):
        check_same_robot(own, other)
    refitted = replace(own, parameters=(PathParameter("damping", ("joint:elbow/damping",), 0.0, 1.0),))
    with pytest.raises(InputError, match=r"declare the same ones in both"):
        check_same_robot(own, refitted)


def test_robots_that_touch_the_world_are_refused_in_one_sentence():
    tossed: Dataset = SYSTEMS["toss"].dataset(1, 1)
    with pytest.raises(InputError, match="diagnose both sets without --before"):
        identify_changes([tossed, tossed])
    with pytest.raises(InputError, match="expected recordings from before"):
        identify_changes([tossed])


def test_models_that_differ_are_said(found: Changes):
    said = [any("newer.xml" in note for note in diagnosis.notes) for diagnosis in found.diagnoses]
    assert said == [False, False, True]
