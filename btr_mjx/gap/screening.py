"""Screening: signatures of every candidate, of the tolerances and of what may be refitted, and their linear scan."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effect import Candidate
from btr_mjx.gap.hypotheses import DELICATE, Hypothesis, believed_steps
from btr_mjx.gap.refine import Nuisance
from btr_mjx.gap.score import Evidence, fit, scan, weight
from btr_mjx.gap.sensitivity import signatures
from btr_mjx.gap.windows import MakeWorld, Windows
from btr_mjx.gap.worlds import fields_of

_SHAPES_CONTACT = frozenset({"geom_pos", "geom_quat", "geom_size", "body_pos", "body_quat", "jnt_pos", "qpos0"})
_SHAPES_CONTACT |= {"geom_friction", "geom_solref", "geom_solimp", "geom_margin"}
_CLAMPS = ("actuator_forcerange", "actuator_forcelimited", "actuator_ctrlrange", "jnt_actfrcrange")

_CLAMP_PROBES = (0.15, 0.35, 0.6)
"""Where a limit is tried, as parts of the way from where it does nothing to its tightest."""


@dataclass(frozen=True)
class Entry:
    """A candidate with the steps that its signature is taken at.

    Attributes:
      candidate: the candidate.
      steps: (p,) from its null.
      probe: whether the first step is a guess of the value itself, far from linear, rather than a small change.
    """

    candidate: Candidate
    steps: np.ndarray
    probe: bool = False


@dataclass(frozen=True)
class Screen:
    """Signatures of candidates around a base world.

    Attributes:
      entries: all candidates, groups and probes included.
      columns: (C, W, R) signatures, one per simulated number.
      groups: per entry and number the columns and their factors: a sum of members for a group.
    """

    entries: tuple[Entry, ...]
    columns: np.ndarray
    groups: tuple[tuple[tuple[np.ndarray, np.ndarray], ...], ...]

    def signature(self, index: int) -> np.ndarray:
        """(p, W, R) signatures of an entry, per step of each of its numbers."""
        return np.stack([np.tensordot(f.astype(np.float32), self.columns[c], 1) for c, f in self.groups[index]])


def simulated(candidate: Candidate) -> bool:
    """Whether a candidate is simulated itself; others are sums of their members."""
    return not (candidate.effect.summable and candidate.place.members)


def changed_fields(candidate: Candidate, model: mujoco.MjModel, base: Hypothesis) -> set[str]:
    """Fields of the model that a small step of a candidate changes, derived constants included."""
    own = base(model)
    values = candidate.null
    values[0] += candidate.parameters[0].step
    return set(fields_of(base.with_effect(candidate, values)(model), own.model))


def moves_contact(fields: set[str]) -> bool:
    """Whether a change of these fields moves or alters contacts, where linear signatures mislead."""
    return not fields.isdisjoint(_SHAPES_CONTACT)


def entries_of(
    candidates: Sequence[Candidate], fields: Mapping[str, set[str]], delicate: Collection[str] = ()
) -> list[Entry]:
    """Entries of candidates: each at its own steps, and limits at a few values of their own.

    Args:
      candidates: the candidates.
      fields: what each changes, by name.
      delicate: names of those that need smaller steps.
    """
    out = []
    for candidate in candidates:
        steps = np.array([parameter.step for parameter in candidate.parameters])
        if candidate.name in delicate:
            steps = steps * DELICATE
        out.append(Entry(candidate, steps))
        if not fields.get(candidate.name, set()).isdisjoint(_CLAMPS):
            first = candidate.parameters[0]
            tightest = first.low if first.step < 0 else first.high
            for share in _CLAMP_PROBES:
                probe = steps.copy()
                probe[0] = share * (tightest - first.null)
                if abs(probe[0]) > 1.5 * abs(first.step):
                    out.append(Entry(candidate, probe, probe=True))
    return out


def screen(windows: Windows, base: Hypothesis, entries: Sequence[Entry], single: bool) -> Screen:
    """Simulate every entry's signature.

    Args:
      windows: linearised around `base`.
      base: the base world.
      entries: all of them; members come with their groups.
      single: see `sensitivity.signatures`.
    """
    makes: list[MakeWorld] = []
    minus: list[int] = []
    first: dict[int, int] = {}
    members: dict[str, tuple[int, Entry]] = {}
    for index, entry in enumerate(entries):
        candidate = entry.candidate
        if not simulated(candidate):
            continue
        first[index] = len(makes)
        if not entry.probe:
            members[candidate.name] = (len(makes), entry)
        for i, parameter in enumerate(candidate.parameters):
            values = candidate.null
            values[i] += entry.steps[i]
            if parameter.shape:
                values[0] += entry.steps[0]
            makes.append(base.with_effect(candidate, values))
            minus.append(first[index] if parameter.shape else -1)
    columns = signatures(windows, base, makes, single)
    for i, other in enumerate(minus):
        if other >= 0:
            columns[i] -= columns[other]
    groups = []
    for index, entry in enumerate(entries):
        own = []
        for i in range(len(entry.steps)):
            if index in first:
                own.append((np.array([first[index] + i]), np.ones(1)))
                continue
            parts = [members[name] for name in _member_names(entry.candidate) if name in members]
            factors = [entry.steps[i] / other.steps[i] for _, other in parts]
            own.append((np.array([column + i for column, _ in parts], int), np.array(factors)))
        groups.append(tuple(own))
    return Screen(tuple(entries), columns, tuple(groups))


def _member_names(candidate: Candidate) -> list[str]:
    return [f"{candidate.effect.name}@{label}" for label in candidate.place.members]


def tolerance_of(candidate: Candidate, given: Mapping[str, float]) -> float:
    """1 sigma of a candidate's first number that calibration always leaves; 0 for groups and where none is known."""
    if candidate.place.members:
        return 0.0
    return float(given.get(candidate.effect.name, candidate.parameters[0].tolerance))


def nuisances(
    windows: Windows, base: Hypothesis, screened: Screen, given: Mapping[str, float], single: bool
) -> Nuisance:
    """Tolerances of single places with their Gaussian priors, and what may be refitted with a wide one.

    Args:
      windows: linearised around `base`.
      base: the base world.
      screened: signatures of the candidates, tolerances among them.
      given: tolerances of the dataset by effect.
      single: see `sensitivity.signatures`.
    """
    columns, precision = [], []
    for index, entry in enumerate(screened.entries):
        tolerance = 0.0 if entry.probe else tolerance_of(entry.candidate, given)
        if tolerance > 0:
            columns.append(screened.signature(index)[0] * np.float32(tolerance / entry.steps[0]))
            precision.append(1.0)
    if base.parameters:
        steps = believed_steps(base.parameters, base.believed)
        makes = [
            base.replaced(base.values(True) + np.where(np.arange(base.values(True).size) == i, step, 0.0), True)
            for i, step in enumerate(steps)
        ]
        moved = signatures(windows, base, makes, single)
        for i, (parameter, step) in enumerate(zip(base.parameters, steps, strict=True)):
            columns.append(moved[i])
            precision.append((step / (0.5 * (parameter.high - parameter.low))) ** 2)
    stacked = np.stack(columns) if columns else np.zeros((0, *windows.residual.shape), np.float32)
    return Nuisance.of(stacked, np.array(precision))


@dataclass(frozen=True)
class Lead:
    """A candidate as the linear scan sees it.

    Attributes:
      index: of the candidate.
      gain: reduction of the loss.
      values: (p,) its numbers.
    """

    index: int
    gain: float
    values: np.ndarray


class Scanner:
    """Linear scans of all candidates on residuals of one set of windows.

    Signatures of groups are formed once; every scan is arithmetic on inner products.
    """

    def __init__(self, screened: Screen, nuisance: Nuisance) -> None:
        self.screened, self.nuisance = screened, nuisance
        spans, count = [], 0
        for entry in screened.entries:
            spans.append(np.arange(count, count + len(entry.steps)))
            count += len(entry.steps)
        self._spans = spans
        mixing = np.zeros((count, len(screened.columns)), np.float32)
        for span, group in zip(spans, screened.groups, strict=True):
            for row, (columns, factors) in zip(span, group, strict=True):
                mixing[row, columns] = factors
        self._mixing = mixing
        raw = np.moveaxis(screened.columns, 0, 1)  # (W, C, R)
        self._raw = raw
        own = mixing @ (raw @ np.swapaxes(raw, 1, 2)) @ mixing.T
        across = mixing @ (raw @ np.swapaxes(nuisance.columns, 1, 2))
        self._gram = np.block([[own, across], [np.swapaxes(across, 1, 2), nuisance.gram]]).astype(np.float32)
        self._count = count

    def evidence(self, residual: np.ndarray) -> Evidence:
        """Evidence of a residual (W, R) on all candidates' numbers followed by the nuisances."""
        vector = residual.astype(np.float32)[..., None]
        own = (self._raw @ vector)[..., 0] @ self._mixing.T
        moment = np.concatenate([own, (self.nuisance.columns @ vector)[..., 0]], 1)
        return Evidence((residual**2).sum(1), moment.astype(float), self._gram)

    def __call__(
        self,
        residual: np.ndarray,
        cut: float,
        extra: np.ndarray | None = None,
        thorough: int = 40,
        dispersion: float = 1.0,
    ) -> list[Lead]:
        """Scan all candidates.

        Args:
          residual: (W, R).
          cut: chi^2 above which a window counts less.
          extra: (E, W, R) free columns that are fitted along (effects that were found already).
          thorough: so many leaders are fitted again with weights of their own.
          dispersion: chi^2 per degree of freedom that no candidate falls below, beside which tolerances stay tight.

        Returns:
          Leads, best first.
        """
        data = self.evidence(residual)
        nuisance = np.arange(self._count, data.n)
        precision = self.nuisance.precision * dispersion
        if extra is not None and len(extra):
            data = self._extended(data, residual, extra)
            nuisance = np.arange(self._count, data.n)
            precision = np.concatenate([precision, np.zeros(len(extra))])
        alone = fit(data.take(nuisance), precision, cut)
        gains, _ = scan(data, self._spans, nuisance, precision, weight(alone.chi2, cut))
        open_gains, _ = scan(data, self._spans, nuisance, precision, np.sqrt(weight(alone.chi2, cut)))
        half = thorough // 2
        chosen = dict.fromkeys([*np.argsort(-gains)[:half].tolist(), *np.argsort(-open_gains)[:half].tolist()])
        leads = []
        for index in chosen:
            span = self._spans[index]
            low, high = self._bounds(index)
            ends = np.full(len(nuisance), np.inf)
            own = fit(
                data.take(np.concatenate([span, nuisance])),
                np.concatenate([np.zeros(len(span)), precision]),
                cut,
                np.concatenate([low, -ends]),
                np.concatenate([high, ends]),
            )
            values = self._values(index, own.values[: len(span)])
            leads.append(Lead(index, alone.loss - own.loss, values))
        return sorted(leads, key=lambda lead: -lead.gain)

    def _extended(self, data: Evidence, residual: np.ndarray, extra: np.ndarray) -> Evidence:
        """Evidence with more columns at the end."""
        free = np.moveaxis(extra, 0, 1).astype(np.float32)
        vector = residual.astype(np.float32)[..., None]
        own = self._mixing @ (self._raw @ np.swapaxes(free, 1, 2))
        across = np.concatenate([own, self.nuisance.columns @ np.swapaxes(free, 1, 2)], 1)  # (W, C, E)
        gram = np.block([[data.gram, across], [np.swapaxes(across, 1, 2), free @ np.swapaxes(free, 1, 2)]])
        moment = np.concatenate([data.moment, (free @ vector)[..., 0]], 1)
        return Evidence(data.energy, moment, gram)

    def _bounds(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of an entry's coefficients, in steps; those of shapes are open, those of probes near 1."""
        entry = self.screened.entries[index]
        low, high = np.full(len(entry.steps), -np.inf), np.full(len(entry.steps), np.inf)
        for i, (parameter, step) in enumerate(zip(entry.candidate.parameters, entry.steps, strict=True)):
            if not parameter.shape:
                low[i], high[i] = sorted(
                    ((parameter.low - parameter.null) / step, (parameter.high - parameter.null) / step)
                )
        if entry.probe:
            low[0], high[0] = 0.0, 1.5
        return low, high

    def _values(self, index: int, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients in steps as numbers: that of a shape stands for its product with the first number."""
        entry = self.screened.entries[index]
        values = entry.candidate.null
        for i, parameter in enumerate(entry.candidate.parameters):
            share = coefficients[i]
            if parameter.shape:
                amplitude = coefficients[0] if abs(coefficients[0]) > 0.3 else 0.3 * np.sign(coefficients[0] or 1.0)
                share = coefficients[i] / amplitude
            elif entry.probe and i == 0:
                share = 1.0
            values[i] = np.clip(values[i] + share * entry.steps[i], parameter.low, parameter.high)
        return values
