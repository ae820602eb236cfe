"""Tables with clocks of their own, brought onto one time axis.

The axis is the clock of the position that is sampled fastest. Values of other clocks are interpolated where measured
samples bracket the time closely, by local cubics (modified Akima); commands are held, or interpolated where the dataset
says so. Elsewhere values are missing, so that the recording is split there.

A column of a table is on a clock of its own if it has a value in every second row at most: rows of several clocks are
often written into one table.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import SUFFIXES, control_columns, sensor_parts, state_columns
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names, sign_flips

CLOSE = 3.5
"""Largest distance between samples that are interpolated, in usual intervals: two samples may be lost."""
_USUAL = 90
"""Percentile of the intervals that counts as usual. Samples that come whenever something changes are not holes."""


def usual_interval(time: np.ndarray) -> float:
    """Interval between samples at times (K,) that are increasing [s]; 0 for fewer than two."""
    return float(np.percentile(np.diff(time), _USUAL)) if len(time) > 1 else 0.0


@dataclass(frozen=True)
class _Signal:
    """Columns that were sampled at the same times."""

    time: np.ndarray
    values: Mapping[str, np.ndarray]
    sparse: bool


def on_one_clock(
    tables: Sequence[Mapping[str, np.ndarray]],
    model: mujoco.MjModel,
    hold: bool,
    where: str,
    notes: list[str],
    shift: float = 0.0,
) -> tuple[dict[str, np.ndarray], bool, float]:
    """Bring the columns (K,) of the tables of a recording onto one time axis [s].

    Commands of another clock are interpolated, or held if `hold`, and their times shifted before.

    Returns:
      Columns (N,) on one axis, NaN where a value is not known; whether commands were held; and the shift [s] that is
      left to do, where commands are on the clock of positions.

    Raises:
      InputError: tables that share no time, or times of a clock that do not increase.
    """
    signals = [signal for table in tables for signal in _signals(table)]
    positions, _ = state_columns(model)
    if len(tables) == 1 and not any(signal.sparse for signal in signals):
        return dict(tables[0]), False, shift
    for table in tables:
        _smooth_signs(table, model)
    having = [signal for signal in signals if any(name in signal.values for name in positions)]
    if not having:
        return dict(tables[0]), False, shift  # the check of names says what is missing
    axis = min(having, key=lambda signal: (usual_interval(signal.time) or np.inf, -len(signal.time)))
    commands = set(control_columns(model))
    if all(commands.issuperset(signal.values) for signal in signals if commands.intersection(signal.values)):
        signals = [
            replace(signal, time=signal.time + shift) if commands.intersection(signal.values) else signal
            for signal in signals
        ]
        shift = 0.0
    _check_overlap(axis, signals, where)
    columns = {"time": axis.time, **axis.values}
    held = False
    for signal in signals:
        if signal is axis or not signal.values:
            continue
        check_time(signal.time, f"{where}: {listed(signal.values, 3)}")
        names = list(signal.values)
        held |= hold and any(name in commands for name in names)
        for name in names:
            known = np.isfinite(signal.values[name])
            use = _hold if hold and name in commands else _interpolate
            try:
                with np.errstate(all="ignore"):  # slopes that are not finite are refused
                    columns[name] = use(axis.time, signal.time[known], signal.values[name][known])
            except ValueError:
                raise InputError(
                    f"{where}: column {name!r} cannot be interpolated on the clock of {listed(axis.values, 3)}: "
                    "its numbers are too large or its times too close together"
                ) from None
        how = "held" if hold and set(names) <= commands else "interpolated"
        notes.append(
            f"{listed(names, 3)}, sampled every {1e3 * usual_interval(signal.time):.3g} ms, {how} on the clock of "
            f"{listed(axis.values, 3)} with {1e3 * usual_interval(axis.time):.3g} ms"
        )
    return columns, held, shift


def _signals(table: Mapping[str, np.ndarray]) -> list[_Signal]:
    """The clocks of a table: that of its rows, and those of columns with values in some rows only."""
    time = table["time"]
    stamped = np.isfinite(time)
    sparse: dict[bytes, dict[str, np.ndarray]] = {}
    dense = {}
    for name, values in table.items():
        rows = np.flatnonzero(np.isfinite(values))
        if name == "time":
            continue
        if len(rows) > 1 and np.median(np.diff(rows)) > 1:
            sparse.setdefault(np.isfinite(values).tobytes(), {})[name] = values
        else:
            dense[name] = values
    found = [_Signal(time, dense, False)] if dense else []
    if dense and sparse:  # rows of other clocks are no missing values of this one
        own = np.any([np.isfinite(values) for values in dense.values()], axis=0) & stamped
        found = [_Signal(time[own], {name: values[own] for name, values in dense.items()}, False)]
    for group in sparse.values():
        known = np.isfinite(next(iter(group.values()))) & stamped
        found.append(_Signal(time[known], {name: values[known] for name, values in group.items()}, True))
    return found


def check_time(time: np.ndarray, where: str, first_row: int = 0) -> None:
    """Refuse times (K,) [s] that do not increase strictly; `first_row` rows of the file are before them."""
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0))
        what = "repeats" if steps[row] == 0 else "goes back"
        raise InputError(
            f"{where}: time {what} from {time[row]:.9g} to {time[row + 1]:.9g} s in row {first_row + row + 2}; it has "
            "to increase: sort the rows and drop duplicates"
        )


def _check_overlap(axis: _Signal, signals: Sequence[_Signal], where: str) -> None:
    for signal in signals:
        if len(signal.time) and len(axis.time):
            apart = signal.time[0] > axis.time[-1] or signal.time[-1] < axis.time[0]
            if apart:
                raise InputError(
                    f"{where}: {listed(signal.values, 3)} have times from {signal.time[0]:.6g} to "
                    f"{signal.time[-1]:.6g} s, {listed(axis.values, 3)} from {axis.time[0]:.6g} to "
                    f"{axis.time[-1]:.6g} s; give both times of one clock"
                )


def _smooth_signs(table: Mapping[str, np.ndarray], model: mujoco.MjModel) -> None:
    """Make the signs of quaternions continuous, in place: they are interpolated by their numbers."""
    joints = zip(part_names(model, "joint"), model.jnt_type, strict=True)
    groups = [[f"qpos/{name}/{part}" for part in ("qw", "qx", "qy", "qz")] for name, k in joints if int(k) in SUFFIXES]
    for keys in [*groups, *(own for own in sensor_parts(model).values() if len(own) == 4)]:
        if all(key in table for key in keys):
            rows = np.flatnonzero(np.all([np.isfinite(table[key]) for key in keys], axis=0))
            flips = sign_flips(np.stack([table[key][rows] for key in keys], axis=1))
            for key in keys:
                table[key][rows] *= flips


def _hold(axis: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The last value before each time of the axis; NaN before the first, and long after the last one."""
    if not len(time):
        return np.full(len(axis), np.nan)
    last = np.searchsorted(time, axis, side="right") - 1
    fresh = (last >= 0) & (axis - time[np.maximum(last, 0)] <= CLOSE * max(usual_interval(time), 1e-9))
    return np.where(fresh, values[np.maximum(last, 0)], np.nan)


def _interpolate(axis: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Local cubics through the samples; NaN where the samples on both sides are too far apart."""
    if len(time) < 3:
        return np.full(len(axis), np.nan)
    from scipy.interpolate import Akima1DInterpolator  # takes a second to load, and most logs have one clock

    found = Akima1DInterpolator(time, values, method="makima")(axis)
    after = np.searchsorted(time, axis, side="left").clip(0, len(time) - 1)
    before = np.where(time[after] == axis, after, after - 1).clip(0)
    found[time[after] - time[before] > CLOSE * usual_interval(time)] = np.nan
    return found
