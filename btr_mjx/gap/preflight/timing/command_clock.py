"""Commands whose time stamps are late: positions follow sooner than the believed model could, or even come first.

A delay may be physics, and so may a response that is a little sooner than the believed one: of a stiffer servo, or of
one with less damping. What neither explains is a clock.
"""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, listed
from btr_mjx.gap.preflight.comparison import Comparison, compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.lerobot_tables import toml_lines
from btr_mjx.gap.preflight.predictions import Change, Predictor, Reading, typical_error
from btr_mjx.gap.preflight.timing.estimates import PredictionErrors, command_interval

_SURE = 2.0
"""Standard errors by which a response has to be early."""

_EARLY = 1.5
"""Intervals between commands that a shift exceeds: less may be when within an interval a command was read or sent."""

_REACH = 1.0
"""Largest shift [s]."""

_SPACING = 0.1
"""Distance of shifts that are tried first, as a share of a stretch."""

_RATIO = 3.0
"""Ratio of variances by which shifted commands have to predict better, as other conventions of commands have to."""

_FEWEST = 8
"""Fewest stretches by which a recording has a shift of its own."""

_FEW = 24
"""Stretches in which shifts are tried first."""

_STEPS = 5
"""Gauss-Newton steps, at most."""


def late_commands(dataset: Dataset, noise: Noise, predictor: Predictor, predictions: PredictionErrors) -> list[Finding]:
    """An error where commands are stamped late, with the shift that mends it.

    Args:
      dataset: in sound conventions.
      noise: of its sensors.
      predictor: stretches of it.
      predictions: in these stretches.
    """
    value, error = predictions.estimate().delay
    interval = command_interval(dataset.recordings)
    if value + _SURE * error > -_EARLY * interval:
        return []
    shift = _refined(dataset, noise, predictor, _roughly(dataset, predictor))
    found = {log: own for log, own in shift.items() if own[0] < -_EARLY * interval}
    if not found:
        return []
    values = np.array([found[one.log][0] if one.log in found else 0.0 for one in dataset.recordings])
    now, mended = (_errors(dataset, predictor, Reading(shift=s)) for s in (0.0, values))
    better = [compare(errors, mended) for errors in (now, *_sooner(dataset, predictor))]
    if not all(one.decisive(_RATIO) for one in better):
        return []
    return [_finding(dataset, found, better[0], predictor.seconds)]


def _errors(dataset: Dataset, predictor: Predictor, reading: Reading) -> np.ndarray:
    """(W,) error variances of all coordinates together."""
    errors = predictor.errors([Change.none(dataset.model)], reading)[0]
    return typical_error(errors, range(errors.shape[1]))


def _roughly(dataset: Dataset, predictor: Predictor) -> dict[str, float]:
    """The shift [s] of each log that predicts best, of a few."""
    predictor, spacing = predictor.few(_FEW), _SPACING * predictor.seconds
    tried = -spacing * np.arange(int(_REACH / spacing) + 1)
    errors = np.log([_errors(dataset, predictor, Reading(shift=float(s))) for s in tried])
    return {log: float(tried[np.argmin(errors[:, own].mean(1))]) for log, own in _stretches(dataset, predictor).items()}


def _refined(
    dataset: Dataset, noise: Noise, predictor: Predictor, shift: dict[str, float]
) -> dict[str, tuple[float, float]]:
    """Shifts [s] with standard errors of each log, from rough ones."""
    interval, error = command_interval(dataset.recordings), dict.fromkeys(shift, np.inf)
    for _ in range(_STEPS):
        each = np.array([shift[one.log] for one in dataset.recordings])
        predictions = PredictionErrors.of(predictor, dataset.recordings, noise.qpos, each)
        moved = 0.0
        for log, own in _rows(dataset).items():
            alone = predictions.estimate(own)
            value, error[log] = (alone if alone.stretches >= _FEWEST else predictions.estimate()).delay
            shift = shift | {log: shift[log] + value}
            moved = max(moved, abs(value))
        if moved < 0.1 * interval:
            break
    return {log: (own, error[log]) for log, own in shift.items()}


def _rows(dataset: Dataset) -> dict[str, list[int]]:
    """Indices of the recordings of each log."""
    rows: dict[str, list[int]] = {}
    for i, one in enumerate(dataset.recordings):
        rows.setdefault(one.log, []).append(i)
    return rows


def _stretches(dataset: Dataset, predictor: Predictor) -> dict[str, np.ndarray]:
    """(W,) bool of each log: the stretches that decide on it, its own or all."""
    recording = predictor.start_times()[0]
    own = {log: np.isin(recording, rows) for log, rows in _rows(dataset).items()}
    return {log: use if use.sum() >= _FEWEST else np.ones(len(recording), bool) for log, use in own.items()}


def _sooner(dataset: Dataset, predictor: Predictor) -> list[np.ndarray]:
    """(W,) errors of models that respond sooner than the believed one: of stiffer servos, and of less damping."""

    def stiffer(factor: float) -> Callable[[mujoco.MjModel], None]:
        def edit(model: mujoco.MjModel) -> None:
            model.actuator_gainprm[:, 0] *= factor
            model.actuator_biasprm[:, 1] *= factor

        return edit

    def less_damped(factor: float) -> Callable[[mujoco.MjModel], None]:
        def edit(model: mujoco.MjModel) -> None:
            model.actuator_biasprm[:, 2] *= factor
            model.dof_damping[:] *= factor

        return edit

    edits = [stiffer(2.0), stiffer(4.0), less_damped(0.5), less_damped(0.0)]
    return [_errors(dataset, predictor, Reading(edit=edit)) for edit in edits]


def _finding(dataset: Dataset, found: dict[str, tuple[float, float]], better: Comparison, seconds: float) -> Finding:
    """The error, with the lines that mend it."""
    values, interval = [own for own, _ in found.values()], command_interval(dataset.recordings)
    logs = {one.log for one in dataset.recordings}
    error = float(np.median([error for _, error in found.values()]))
    digits = int(np.clip(np.ceil(-np.log10(max(error, 1e-6))), 2, 5))
    common = len(found) == len(logs) and max(values) - min(values) < interval
    shift = {"": float(np.median(values))} if common else {log: own for log, (own, _) in found.items()}
    total = {log: round(dataset.control.shift_of(log) + own, digits) for log, own in shift.items()}
    said = ", ".join(f"{-own:.3g} s{f' in {log!r}' if log else ''}" for log, own in list(shift.items())[:3])
    said += f" and {len(shift) - 3} more" if len(shift) > 3 else ""
    control = replace(dataset.control, shift=dict(dataset.control.shift) | total)
    by_log = "{ " + ", ".join(f'"{log}" = {own:g}' for log, own in total.items()) + " }"
    line = f"shift = {total['']:g}" if "" in total else f"shift = {by_log}"
    remedy = f"{line} in [control] of dataset.toml"
    tables = [] if dataset.described else ["[control]", line]
    of = "" if len(found) == len(logs) else f" of {listed(list(found))}"
    message = (
        f"positions come before their commands{of} could move them: commands are stamped {said} late, or positions "
        f"early (+- {1e3 * error:.2g} ms, beside the model's own lag); with shifted commands the believed model "
        f"predicts {seconds:.2g} s ahead with {better.words()}; {remedy}"
    )
    evidence = {"shift": float(np.median(values)), "standard_error": error} | better.evidence()
    return Finding("error", "clocks", message, remedy, evidence, toml_lines(replace(dataset, control=control), tables))
