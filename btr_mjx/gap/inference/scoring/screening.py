"""Screening: signatures of every candidate, of the tolerances and of what may be refitted."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effects import TIME_IN_SAMPLE, TIMING, Candidate, Hypothesis, believed_steps, field_tolerance
from btr_mjx.gap.inference.scoring.hypotheses import CONTACT_STEP
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.simulate import differing_fields, fingerprint
from btr_mjx.gap.windows import MakeWorld, Windows, signatures, step_uncertainty

_SHAPES_CONTACT = frozenset({"geom_pos", "geom_quat", "geom_size", "body_pos", "body_quat", "jnt_pos", "qpos0"})
_SHAPES_CONTACT |= {"geom_friction", "geom_solref", "geom_solimp", "geom_margin"}

FIRST_TOLERANCE = 1
"""Column of `nuisances` from which on those of candidates stand, in the order of their entries."""

_LIMIT_PROBES = (0.15, 0.35, 0.6, 0.8, 0.92)
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


def changed_fields(
    candidates: Sequence[Candidate], model: mujoco.MjModel, base: Hypothesis
) -> dict[str, frozenset[str]]:
    """Fields of the model that a small step of each candidate changes, derived constants included, by name."""
    own = base(model).model
    known, data, out = fingerprint(own), mujoco.MjData(own), {}
    for candidate in candidates:
        values = candidate.null
        values[0] += candidate.parameters[0].step
        out[candidate.name] = frozenset(differing_fields(base.with_effect(candidate, values)(model), own, known, data))
    return out


def is_contact_sensitive(fields: Collection[str]) -> bool:
    """Whether a change of these fields moves or alters contacts, where linear signatures mislead."""
    return not _SHAPES_CONTACT.isdisjoint(fields)


def entries_of(candidates: Sequence[Candidate], contact_sensitive: Collection[str] = ()) -> list[Entry]:
    """Entries of candidates: each at its own steps, and limits at a few values of their own.

    Args:
      candidates: the candidates.
      contact_sensitive: names of those that need smaller steps.
    """
    out = []
    for candidate in candidates:
        steps = np.array([parameter.step for parameter in candidate.parameters])
        if candidate.name in contact_sensitive:
            steps = steps * CONTACT_STEP
        out.append(Entry(candidate, steps))
        if candidate.effect.saturates:
            first = candidate.parameters[0]
            tightest = first.low if first.step < 0 else first.high
            for share in _LIMIT_PROBES:
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
            names = _member_names(entry.candidate)
            if entry.candidate.place.parts:
                names = names[i : i + 1]
            parts = [members[name] for name in names if name in members]
            number = 0 if entry.candidate.place.parts else i
            factors = [entry.steps[i] / other.steps[number] for _, other in parts]
            own.append((np.array([column + number for column, _ in parts], int), np.array(factors)))
        groups.append(tuple(own))
    return Screen(tuple(entries), columns, tuple(groups))


def _member_names(candidate: Candidate) -> list[str]:
    return [f"{candidate.effect.name}@{label}" for label in candidate.place.members]


def tolerances_of(
    candidates: Sequence[Candidate], given: Mapping[str, float], contact_sensitive: Collection[str], interval: float
) -> dict[str, float]:
    """1 sigma of what calibration leaves of candidates' first numbers, by name; only of those of which it leaves some.

    Groups have none, as their members have their own, but for the time of all commands.

    Args:
      candidates: all of them.
      given: tolerances of the dataset by effect.
      contact_sensitive: names of those that move contacts. Touchdowns show them so sharply, and linear pictures of them
        reach so little far, that they have the tolerances of a laboratory.
      interval: between samples of commands [s].
    """
    out = {}
    for candidate in candidates:
        name, first = candidate.effect.name, candidate.parameters[0]
        if name == TIMING and first.low < 0:  # of all actuators, see `actuators`
            usual = TIME_IN_SAMPLE * interval
        elif candidate.place.members:
            continue
        else:
            near = candidate.name in contact_sensitive
            usual = first.tolerance if near else field_tolerance(name, first.tolerance)
        if sigma := float(given.get(name, usual)):
            out[candidate.name] = sigma
    return out


def with_tolerances(entries: Sequence[Entry], tolerances: Mapping[str, float]) -> tuple[list[Entry], list[Entry]]:
    """Entries with a tolerance.

    Args:
      entries: of all candidates.
      tolerances: of `tolerances_of`.

    Returns:
      Those with a tolerance, in the order of their columns in `nuisances`, and the entries whose signatures these need:
      with the members of groups.
    """
    loose = [e for e in entries if not e.probe and e.candidate.name in tolerances]
    names = {entry.candidate.name for entry in loose}
    names |= {name for e in loose if not simulated(e.candidate) for name in _member_names(e.candidate)}
    return loose, [e for e in entries if not e.probe and e.candidate.name in names]


def nuisances(
    windows: Windows, base: Hypothesis, screened: Screen, tolerances: Mapping[str, float], single: bool
) -> Nuisance:
    """Tolerances with their Gaussian priors, and what may be refitted with a wide one.

    Tolerances are those of single places, of the time of all commands, and of the time step that data have.

    Args:
      windows: linearised around `base`.
      base: the base world.
      screened: signatures of the candidates, tolerances among them.
      tolerances: of `tolerances_of`.
      single: see `sensitivity.signatures`.
    """
    columns, precision = [step_uncertainty(windows, base).astype(np.float32)], [1.0]
    for index, entry in enumerate(screened.entries):
        tolerance = 0.0 if entry.probe else tolerances.get(entry.candidate.name, 0.0)
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
    return Nuisance.of(np.stack(columns), np.array(precision))
