"""Forces that drives report, with the faults that logs have."""

from dataclasses import replace

import numpy as np
import pytest
from gap_forces import arm_dataset

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.preflight.reported_torques import reported_torques


def scaled(data: Dataset, factors: dict[str, float]) -> Dataset:
    """The dataset with other reports of some drives."""
    rows = [
        replace(r, force={name: factors.get(name, 1.0) * values for name, values in r.force.items()})
        for r in data.recordings
    ]
    return replace(data, recordings=tuple(rows))


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Two drives; the second motor is weak and its joint rubs."""

    def weak(model) -> None:
        model.actuator_gainprm[1] *= 0.7
        model.actuator_biasprm[1] *= 0.7
        model.dof_frictionloss[1] = 0.1

    return arm_dataset(5, 1, 1, change=weak, reports=1.1)


def test_weak_motors_and_torque_constants_are_no_faults(dataset: Dataset) -> None:
    assert len(dataset.reporting) == 2
    assert reported_torques(dataset) == []


@pytest.mark.parametrize(
    ("factor", "topic", "said"),
    [(-1.0, "convention", "opposite sign"), (1e3, "units", "another unit"), (8.0, "units", "torque constant")],
)
def test_signs_units_and_currents_are_told_of_one_drive(dataset: Dataset, factor: float, topic: str, said: str) -> None:
    name = list(dataset.recordings[0].force)[1]
    (found,) = reported_torques(scaled(dataset, {name: factor}))
    assert (found.level, found.topic) == ("error", topic)
    assert f"force/{name}" in found.message
    assert any(line.startswith(f'"force/{name}" = "sensor/{name}"') for line in found.lines)
    assert said in found.message
    if factor > 0:
        assert found.evidence["factor"] == pytest.approx(factor, rel=0.5)


def test_without_reports_there_is_nothing_to_check(dataset: Dataset) -> None:
    bare = tuple(replace(r, force={}) for r in dataset.recordings)
    assert reported_torques(replace(dataset, recordings=bare)) == []
    assert not np.any(replace(dataset, recordings=bare, forces=True).reporting)
