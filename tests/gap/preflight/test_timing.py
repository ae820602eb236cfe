"""Time, as short predictions show it: late stamps of commands, commands between samples, the model's time step."""

import dataclasses
import re
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.preflight import Finding, checked
from btr_mjx.gap.preflight.timing.estimates import regressed
from tests.support.convention_logs import ARM, dataset, log, sines

Command = Callable[[np.ndarray], np.ndarray]
RATE = 50
COARSE = ARM.replace('timestep="0.002" integrator="implicitfast"', 'timestep="0.01" integrator="Euler"')


def smooth(seed: int = 3) -> Command:
    return sines(np.random.default_rng(seed), [0.8, 0.8, 0.6])


def held(command: Command, rate: float = RATE) -> Command:
    return lambda times: command(np.floor(times * rate + 1e-6) / rate)


def delayed(command: Command, by: float) -> Command:
    return lambda times: command(times - by)


def recorded(sent: Command, logged: Command, rate: int = 250, edit=lambda model: None, xml: str = ARM) -> Dataset:
    """Two recordings of an arm that gets one command, while another one is logged."""
    every = [log(xml, sent, seed, 5.0, rate, edit=edit) for seed in range(2)]
    return dataset(xml, [dataclasses.replace(r, ctrl=logged(r.time), interpolation="cubic") for r in every])


def of_topic(findings: list[Finding], topic: str) -> list[Finding]:
    return [finding for finding in findings if finding.topic == topic and finding.level != "note"]


def miscalibrated(model: mujoco.MjModel) -> None:
    """Gains, damping and inertia off by some per cent, which moves a response by a millisecond or two."""
    model.actuator_gainprm[:, 0] *= 0.97
    model.actuator_biasprm[:, 1] *= 0.97
    model.actuator_biasprm[:, 2] *= 1.05
    model.dof_damping[:] *= 1.05
    model.dof_armature[:] *= 1.05


@pytest.mark.parametrize("late", [0.12, 0.03])
def test_late_stamps_of_commands_are_told_with_the_shift(late: float) -> None:
    """Also where positions still come after their commands, by less than the servos need."""
    data = recorded(smooth(), delayed(smooth(), late), edit=miscalibrated)
    (found,) = of_topic(checked(data)[1], "clocks")
    assert found.level == "error"
    assert found.evidence["shift"] == pytest.approx(-late, abs=5e-3)
    shift = re.search(r"^shift = (.*)$", "\n".join(found.lines), re.MULTILINE)
    assert shift is not None
    assert float(shift[1]) == pytest.approx(-late, abs=5e-3)


@pytest.mark.parametrize("late", [0.0, -0.03])
def test_sound_clocks_and_delays_of_the_robot_are_not_accused(late: float) -> None:
    assert of_topic(checked(recorded(smooth(), delayed(smooth(), late), edit=miscalibrated))[1], "clocks") == []


def test_a_robot_that_responds_sooner_is_no_clock() -> None:
    def lively(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[:, 2] *= 0.6
        model.dof_damping[:] *= 0.6

    assert of_topic(checked(recorded(smooth(), smooth(), edit=lively))[1], "clocks") == []


def interpolations(data: Dataset) -> set[str]:
    return {one.interpolation for one in checked(data)[0].recordings}


def test_commands_are_held_where_predictions_say_so() -> None:
    assert interpolations(recorded(held(smooth()), smooth(), RATE, miscalibrated)) == {"hold"}
    assert interpolations(recorded(smooth(), smooth(), RATE, miscalibrated)) == {"cubic"}


def test_another_delay_is_the_robots() -> None:
    assert interpolations(recorded(delayed(smooth(), 0.03), smooth(), RATE, miscalibrated)) == {"cubic"}


def test_a_coarse_time_step_is_told_and_refined() -> None:
    data = recorded(smooth(), smooth(), xml=COARSE)
    mended, findings = checked(data)
    (found,) = of_topic(findings, "time step")
    assert found.level == "warning"
    assert 'set timestep="0.0025"' in found.message
    assert found.evidence["error_now"] > 3 * found.evidence["error_with_remedy"]
    steps = {one.model.opt.timestep for one in mended.recordings} | {mended.model.opt.timestep}
    assert (steps, mended.coarse_step) == ({0.0025}, 0.01)
    assert data.model.opt.timestep == 0.01


def test_missing_damping_is_no_time_step() -> None:
    """Explicit steps damp too little, so that a finer one helps a model that lacks damping a little."""

    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[:] += 0.6

    data = recorded(smooth(), smooth(), edit=damped, xml=ARM.replace("implicitfast", "Euler"))
    assert of_topic(checked(data)[1], "time step") == []


def test_regression_agrees_with_the_normal_equations_and_tells_its_errors() -> None:
    """Many sets of noise: values scatter by the standard errors, and what is known beforehand pulls."""
    rng = np.random.default_rng(0)
    columns = [rng.normal(size=(40, 4, 2)) for _ in range(3)]
    noise, truth = np.ones(2), np.array([1.0, -0.5, 0.2])
    clean, found, told = sum(t * c for t, c in zip(truth, columns, strict=True)), [], []
    for _ in range(200):
        left = clean + rng.normal(size=(40, 4, 2))
        values, errors = regressed(left, columns, noise, [np.inf] * 3)
        found.append(values)
        told.append(errors)
    size = np.sqrt(np.median(left**2, axis=(0, 1))) + noise + 1e-12
    matrix = np.stack([(c / size).ravel() for c in columns], -1)
    np.testing.assert_allclose(values, np.linalg.lstsq(matrix, (left / size).ravel())[0], rtol=1e-6)
    np.testing.assert_allclose(np.mean(found, axis=0), truth, atol=0.02)
    np.testing.assert_allclose(np.std(found, axis=0), np.mean(told, axis=0), rtol=0.2)
    pulled, _ = regressed(left, columns, noise, [np.inf, np.inf, 1e-6])
    assert abs(pulled[2]) < 1e-3


def test_a_recording_without_stretches_decides_nothing() -> None:
    values, errors = regressed(np.zeros((0, 4, 2)), [np.zeros((0, 4, 2))], np.ones(2), [np.inf])
    assert values == [0.0]
    assert errors == [np.inf]


def test_short_recordings_are_left_alone() -> None:
    short: list[Recording] = [log(ARM, smooth(), seed, 0.15) for seed in range(2)]
    assert of_topic(checked(dataset(ARM, short))[1], "time step") == []
