"""From recordings of the arm to a verdict: robots that are as believed, and robots that lack one thing."""

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY
from gap_forces import arm_dataset
from gap_systems import SYSTEMS

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import EFFECTS, LAW_EFFECTS
from btr_mjx.gap.forces import identify_forces, prepare_forces
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import Counter

OWN = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "dry_friction", "offset_torque", "actuator_gain"))


def diagnosis(
    seed: int, fit: int = 2, test: int = 2, most: int = 1, effects=OWN, residual: bool = False, **how
) -> Diagnosis:
    prepared = prepare_forces(arm_dataset(seed, fit, test, **how))
    assert prepared is not None
    return identify_forces(prepared, effects, most, lambda _: None, Counter(), residual)


@pytest.mark.parametrize("how", [{"jitter": 2e-4}, {"quantum": 2e-3, "noise": 0.0, "known": False}])
def test_a_robot_that_is_as_believed_lacks_nothing(how):
    """Whether time stamps are a little wrong, or encoders are coarse and velocities not measured at all."""
    found = diagnosis(1, most=2, **how)
    assert found.verdict == "none"
    assert found.effects == ()
    assert found.confounds == ()


def stronger(model: mujoco.MjModel, actuator: int) -> None:
    model.actuator_gainprm[actuator] *= 1.05
    model.actuator_biasprm[actuator] *= 1.05


def test_friction_is_named_at_its_joint_and_is_no_part_of_calibration():
    def sticky(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.25
        stronger(model, 1)

    found = diagnosis(8, change=sticky)
    assert found.verdict == "effect"
    assert [named.name for named in found.effects] == ["dry_friction@joint:shoulder"]
    (own,) = found.effects[0].parameters.values()
    assert own.value == pytest.approx(0.25, rel=0.1)
    assert own.low <= own.value <= own.high
    assert own.unit == "N m"
    assert found.chi2.after < found.chi2.before
    assert found.open_loop.after < found.open_loop.before
    assert found.misfit.noise_reached
    assert found.ranking[0].effect == "dry_friction"
    names = [one.name for one in found.calibration]
    assert "dry_friction@joint:shoulder" not in names
    assert names[0].startswith("actuator_gain")


def test_an_offset_is_named_at_its_joint():
    found = diagnosis(3, force=lambda q, v, t: np.array([0.0, -0.4]))
    assert found.verdict == "effect"
    assert [named.name for named in found.effects] == ["offset_torque@joint:elbow"]
    (own,) = found.effects[0].parameters.values()
    assert own.value == pytest.approx(-0.4, rel=0.05)


def test_a_library_without_calibration_finds_nothing_missing():
    found = diagnosis(9, effects=tuple(e for e in EFFECTS if e.name == "backlash"))
    assert (found.verdict, found.effects, found.calibration) == ("none", (), ())


def test_a_motor_that_is_a_little_stronger_is_calibration():
    """It is no missing effect; the calibrated model predicts recordings that were not fitted."""

    found = diagnosis(7, change=lambda model: stronger(model, 0))
    assert (found.verdict, found.effects) == ("none", ())
    own = next(one for one in found.calibration if one.effect == "actuator_gain")
    assert own.location.startswith("actuator:")
    (gain,) = own.parameters.values()
    assert gain.value == pytest.approx(0.05, rel=0.2)
    assert found.misfit.after < 0.5 * found.misfit.before
    assert found.mended_kind == "calibrated"


DELAY = (*OWN, *(e for e in EFFECTS if e.name == "actuator_delay"))


@pytest.mark.parametrize("late", [-0.0025, 0.0025])
def test_when_commands_act_within_a_sample_belongs_to_the_log(late):
    """The believed model predicts down to the noise, with its commands at the time at which they acted."""
    found = diagnosis(7, effects=DELAY, late=late)
    assert (found.verdict, found.effects) == ("none", ())
    assert found.misfit.noise_before
    assert found.misfit.before == pytest.approx(1, abs=0.1)


def test_commands_that_act_before_their_stamps_are_a_fault_of_the_log():
    found = diagnosis(6, most=2, effects=DELAY, late=0.012)
    assert found.verdict == "none"
    (told,) = [note for note in found.notes if "stamps" in note]
    assert "12 ms before" in told or "11.9 ms before" in told or "12.1 ms before" in told


def test_commands_that_act_after_their_stamps_are_delayed():
    found = diagnosis(6, effects=DELAY, late=-0.02)
    assert [named.name for named in found.effects] == ["actuator_delay@all"]
    assert found.effects[0].parameters["delay"].value == pytest.approx(0.02, rel=0.1)
    assert not any("stamps" in note for note in found.notes)


def ripple(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    return np.array([0.6 * np.sin(8 * q[0] + 0.7), 0.0])


def test_a_force_of_no_known_kind_is_not_named_and_may_be_a_table():
    found = diagnosis(4, test=4, force=ripple, residual=True)
    assert found.verdict == "unexplained"
    assert found.effects == ()
    assert "shoulder" in " ".join(found.unexplained)
    assert [table.joint for table in found.residual] == ["shoulder"]
    assert "shoulder" in found.notes[-1]


def test_a_law_that_may_be_named_is_named_with_its_equation():
    found = diagnosis(4, force=ripple, effects=(*OWN, *LAW_EFFECTS))
    assert found.verdict == "effect"
    assert [named.name for named in found.effects] == ["law_ripple@joint:shoulder"]
    numbers = {name: own.value for name, own in found.effects[0].parameters.items()}
    assert np.hypot(numbers["a"], numbers["b"]) == pytest.approx(0.6, rel=0.05)
    assert numbers["ripples"] == pytest.approx(8, rel=0.02)
    assert np.arctan2(numbers["b"], numbers["a"]) == pytest.approx(0.7, abs=0.1)
    assert found.effects[0].latex.startswith(r"\tau = 0.")
    shown = found.joint_forces[0]
    assert (shown.joint, shown.follows) == ("joint shoulder", ("position",))
    np.testing.assert_allclose(shown.law, 0.6 * np.sin(8 * shown.position + 0.7), atol=0.06)
    assert (shown.after**2).mean() < 0.1 * (shown.before**2).mean()


def test_robots_that_touch_the_world_or_do_not_move_are_not_of_this_kind():
    assert prepare_forces(SYSTEMS["toss"].dataset(1, 1)) is None
    assert prepare_forces(SYSTEMS["torque control"].dataset(1, 1)) is not None
    still = arm_dataset(5, 1, 1)
    for recording in still.recordings:
        recording.qpos[:] = 0.0
    prepared = prepare_forces(still)
    assert prepared is not None
    with pytest.raises(InputError, match="does not move"):
        identify_forces(prepared, LIBRARY, 1, lambda _: None, Counter())
