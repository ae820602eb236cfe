"""Forces that do not carry a flying robot, and drives that do not move their joint, are told; sound logs are not."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, noise_of
from btr_mjx.gap.preflight.balances import carried_weight, idle_drives
from tests.support.convention_logs import ARM, FLYER, dataset, log, sines

WEIGHT = 9.81
"""Of the flying body of 1 kg [N]."""


def flight(share: float, thrown: bool = False) -> Dataset:
    """A body that hovers, with a thruster that has this share of the force that the model believes."""
    centred = FLYER.replace('pos="0.02 0.01 0"', 'pos="0 0 0"')

    def thrust(times: np.ndarray) -> np.ndarray:
        return np.full((len(times), 1), 0.0 if thrown else WEIGHT / share) * (1 + 0.1 * np.sin(6 * times))[:, None]

    def edit(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[0, 0] *= share

    return dataset(centred, [log(centred, thrust, i, edit=edit) for i in range(2)])


@pytest.mark.parametrize("share", [1.0, 0.9, 1.1])
def test_thrust_that_carries_the_weight_is_sound(share: float) -> None:
    assert carried_weight(flight(share)) == []


def test_a_body_that_is_thrown_is_carried_by_nothing() -> None:
    assert carried_weight(flight(1.0, thrown=True)) == []


@pytest.mark.parametrize("share", [0.53, 2.0])
def test_thrust_that_does_not_carry_the_weight_is_told(share: float) -> None:
    (found,) = carried_weight(flight(share))
    assert found.level == "warning"
    assert found.evidence["force_to_weight"] == pytest.approx(1 / share, rel=0.03)
    assert "weight of 9.81 N" in found.message


def arm(edit: Callable[[mujoco.MjModel], None]) -> Dataset:
    rng = np.random.default_rng(0)
    return dataset(ARM, [log(ARM, sines(rng, [0.9, 0.8, 0.8]), i, edit=edit) for i in range(2)])


def test_a_drive_that_is_off_is_told() -> None:
    def off(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[1], model.actuator_biasprm[1] = 0.0, 0.0

    data = arm(off)
    (found,) = idle_drives(data, noise_of(data))
    assert found.level == "warning"
    assert "ctrl/elbow does not move elbow" in found.message


@pytest.mark.parametrize("gain", [1.0, 0.4])
def test_a_drive_that_is_weak_is_not_off(gain: float) -> None:
    def weak(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[1] *= gain
        model.actuator_biasprm[1] *= gain

    data = arm(weak)
    assert idle_drives(data, noise_of(data)) == []
