"""Columns of a search: one for every number that an effect of the library may have at a single place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effects import Candidate
from btr_mjx.gap.forces.evidence import Calibration
from btr_mjx.gap.forces.motion import Number
from btr_mjx.gap.simulate import World

_PROBES = (0.15, 0.35, 0.6, 0.8, 0.92)
"""Where a limit is tried, as parts of the way from where it does nothing to its tightest."""

_LARGE = 5.0
"""A second step at which what is no change of a model's fields is tried, in units of its own step."""

_TIME_IN_SAMPLE = 0.29
"""1 sigma of the time at which a command acts, in intervals of commands: anywhere within one."""


@dataclass(frozen=True)
class Entry:
    """A candidate as a scan sees it: numbers that are sums of columns.

    Attributes:
      candidate: the candidate.
      columns: per number the columns that are added up.
    """

    candidate: Candidate
    columns: tuple[tuple[int, ...], ...]

    def design(self, count: int) -> np.ndarray:
        """(C, p) of `evidence.least_squares`."""
        out = np.zeros((count, len(self.columns)))
        for i, own in enumerate(self.columns):
            out[list(own), i] = 1.0
        return out


@dataclass(frozen=True, eq=False)
class Library:
    """All columns.

    Attributes:
      numbers: one per column.
      entries: the candidates.
      calibrated: candidates that are calibration, one number each.
      calibration: their columns and tolerances.
    """

    numbers: tuple[Number, ...]
    entries: tuple[Entry, ...]
    calibrated: tuple[Entry, ...]
    calibration: Calibration


def library_of(
    candidates: Sequence[Candidate], model: mujoco.MjModel, tolerances: Mapping[str, float], interval: float
) -> Library:
    """Columns of candidates.

    Args:
      candidates: every effect at every place.
      model: the believed model.
      tolerances: 1 sigma of calibration by effect, as the dataset has them.
      interval: between samples of commands [s].
    """
    numbers: list[Number] = []
    entries: list[Entry] = []
    single: dict[str, int] = {}
    calibrated: list[tuple[Entry, float]] = []
    for candidate in candidates:
        if not (candidate.effect.summable and candidate.place.members):
            several = [i for i, p in enumerate(candidate.parameters) if not p.shape]
            column, at = len(numbers), tuple(float(v) for v in candidate.null)
            numbers += [Number(candidate, i, at, candidate.parameters[i].step) for i in several]
            entries.append(Entry(candidate, tuple((column + i,) for i in range(len(several)))))
            single[candidate.name] = column
            for step in _further_steps(candidate, model):
                entries.append(Entry(candidate, ((len(numbers),),)))
                numbers.append(Number(candidate, 0, at, step))
            if not candidate.place.members:
                for i in several:
                    sigma = tolerances.get(candidate.effect.name, candidate.parameters[i].tolerance)
                    if sigma > 0:
                        calibrated.append((Entry(candidate, ((column + i,),)), sigma))
        else:
            columns = [single[f"{candidate.effect.name}@{label}"] for label in candidate.place.members]
            each = tuple((c,) for c in columns) if candidate.place.parts else (tuple(columns),)
            entries.append(Entry(candidate, each))
    whole = [e for e in entries if e.candidate.effect.name == "actuator_delay" and e.candidate.parameters[0].low < 0]
    calibrated += [(entry, _TIME_IN_SAMPLE * interval) for entry in whole[:1]]
    kinds = {name: k for k, name in enumerate(dict.fromkeys(e.candidate.effect.name for e, _ in calibrated))}
    calibration = Calibration(
        np.concatenate([np.zeros((len(numbers), 0)), *(e.design(len(numbers)) for e, _ in calibrated)], 1),
        np.array([sigma for _, sigma in calibrated]),
        np.array([kinds[e.candidate.effect.name] for e, _ in calibrated], int),
        np.zeros(len(calibrated)),
    )
    return Library(tuple(numbers), tuple(entries), tuple(e for e, _ in calibrated), calibration)


def _further_steps(candidate: Candidate, model: mujoco.MjModel) -> list[float]:
    """Further steps at which a candidate is tried: what it does at its true size may be far from linear."""
    first = candidate.parameters[0]
    if candidate.effect.saturates:
        tightest = first.low if first.step < 0 else first.high
        probes = [share * (tightest - first.null) for share in _PROBES]
        return [probe for probe in probes if abs(probe) > 1.5 * abs(first.step)]
    values = candidate.null
    values[0] += first.step
    world = candidate.apply(World.of(model), values)
    large = _LARGE * first.step
    inside = first.low <= first.null + large <= first.high
    return [large] if inside and (world.command_edits or world.laws) else []
