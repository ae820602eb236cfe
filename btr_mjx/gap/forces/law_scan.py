"""Laws at joints, beside what was named: a scan without simulations, and a round of the search.

A force phi(q, v, tau, t) at one joint moves the state by G_k phi_k over an interval, so that the columns of a whole
dictionary cost one pass of the filter. Numbers within a term (ripples per radian, a frequency) start where the missing
force shows them. What the scan proposes is simulated and refined like any effect.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.effects import Candidate, Hypothesis, LawState, LawTerm
from btr_mjx.gap.forces.evidence import least_squares
from btr_mjx.gap.forces.kalman_filter import filtered, smoothed
from btr_mjx.gap.forces.missing_force import missing_force
from btr_mjx.gap.forces.points import Fitted, ForceSide
from btr_mjx.gap.forces.scan import Scanned, price
from btr_mjx.gap.forces.stretches import Stretches

_AT_JOINT = 3
"""Terms of a law at one joint, at most."""

_SLOW = 0.05
"""Part of the usual speed below which friction is not at its full size."""

_ROWS = 4000
"""Points at which the missing force is searched for numbers within a term, at most."""


@dataclass(frozen=True, eq=False)
class LawScan:
    """What laws would explain beside a fit.

    Attributes:
      leads: best first.
      choices: terms, joints and numbers within terms among which each was chosen.
    """

    leads: tuple[Scanned, ...]
    choices: int


def scan_laws(side: ForceSide, fit: Fitted, laws: Sequence[Candidate]) -> LawScan:
    """Rank laws by what they explain beside a fit.

    Args:
      side: the recordings to fit.
      fit: with all that was named before.
      laws: terms of the dictionary at joints.
    """
    linear, p, n = fit.linear, fit.point.numbers, len(side.library.calibrated)
    model = side.stretches.data.recordings[0].model
    force = smoothed(linear, np.zeros_like(linear.defect), fit.variances).force
    states = joint_states(linear.stretches, fit.point.hypothesis(side.library))
    tried: list[tuple[Candidate, float]] = []
    columns, choices = [], 0
    for candidate, law in _open(laws, fit):
        dof, other = (int(model.jnt_dofadr[j]) for j in (candidate.place.joints[0], candidate.place.joints[-1]))
        at = states.of(dof, other)
        turn = -states.turns(dof) if law.friction else np.ones_like(at.v)
        number, choices_of = _number(law, at, turn * force[..., dof])
        basis = np.stack([turn * f for f in law.basis(at, number)], -1)
        columns.append(linear.force[..., dof, None] * basis[:, :, None, :])
        tried.append((candidate, number))
        choices += choices_of
    if not columns:
        return LawScan((), 1)
    every = np.concatenate([fit.columns, *columns], -1)
    gram = filtered(linear, every, fit.variances).gram.sum(0)
    size, eye = every.shape[-1], np.eye(every.shape[-1])
    prior = replace(side.library.calibration, design=eye[:, p : p + n], at=fit.point.calibration)
    before = least_squares(gram, eye[:, :p], prior).loss
    count, first, leads = fit.whitened.count * len(side.stretches), p + n, []
    for (candidate, number), own in zip(tried, columns, strict=True):
        width = own.shape[-1]
        free = np.concatenate([eye[:, :p], eye[:, first : first + width]], 1)
        first += width
        found = least_squares(gram, free, prior)
        gain, values = before - found.loss, found.values[p:]
        within = (number,) if len(candidate.parameters) > width else ()
        score = gain - price(len(candidate.parameters), count, choices)
        bounded = [
            float(np.clip(v, q.low, q.high)) for v, q in zip((*values, *within), candidate.parameters, strict=True)
        ]
        leads.append(Scanned(candidate, tuple(bounded), found.values[:p], found.calibration, gain, score))
    assert first == size
    return LawScan(tuple(sorted(leads, key=lambda lead: -lead.score)), choices)


def _open(laws: Sequence[Candidate], fit: Fitted) -> Iterator[tuple[Candidate, LawTerm]]:
    """Laws that may still be added: at no joint more than a few, and none twice."""
    named = [candidate for candidate, _ in fit.point.named if candidate.effect.law is not None]
    taken = [candidate.place.joints[0] for candidate in named]
    names = {candidate.name for candidate in named}
    for candidate in laws:
        law, joint = candidate.effect.law, candidate.place.joints[0]
        if law is not None and candidate.name not in names and taken.count(joint) < _AT_JOINT:
            yield candidate, law


@dataclass(frozen=True, eq=False)
class JointStates:
    """States in the middle of all intervals.

    Attributes:
      q: (S, K, nv) positions of hinges and slides.
      v: (S, K, nv) velocities.
      load: (S, K, nv) forces of the actuators.
      time: (S, K) [s].
    """

    q: np.ndarray
    v: np.ndarray
    load: np.ndarray
    time: np.ndarray

    def of(self, dof: int, other: int) -> LawState:
        """What a law at a joint may depend on, (S, K) each.

        Args:
          dof: of the joint.
          other: of another joint.
        """
        time = np.broadcast_to(self.time, self.q.shape[:2])
        return LawState(
            self.q[..., dof], self.v[..., dof], self.load[..., dof], time, self.q[..., other], self.v[..., other]
        )

    def turns(self, dof: int) -> np.ndarray:
        """Direction of the motion, from -1 to 1."""
        v = self.v[..., dof]
        return np.tanh(v / (_SLOW * np.sqrt((v**2).mean()) + 1e-12))


def joint_states(stretches: Stretches, hypothesis: Hypothesis) -> JointStates:
    """States along stretches.

    Args:
      stretches: with smoothed states.
      hypothesis: whose actuators' forces are taken.
    """
    model = stretches.data.recordings[0].model
    q = np.zeros((len(stretches), stretches.intervals, model.nv))
    for j in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        own = stretches.qpos[..., model.jnt_qposadr[j]]
        q[..., model.jnt_dofadr[j]] = 0.5 * (own[:, 1:] + own[:, :-1])
    missing = missing_force(stretches, hypothesis)
    return JointStates(q, missing.velocity, missing.actuator, 0.5 * (stretches.time[:, 1:] + stretches.time[:, :-1]))


def _number(law: LawTerm, at: LawState, force: np.ndarray) -> tuple[float, int]:
    """The number within a term with which it explains most of a force (S, K), and how many were tried."""
    if law.tried is None:
        return 0.0, 1
    values = law.tried.values(at.q)
    every = max(1, at.q.size // _ROWS)
    few = LawState(*(getattr(at, name).ravel()[::every] for name in LawState.__dataclass_fields__))
    target = force.ravel()[::every]
    always = np.stack([np.ones_like(few.q), few.q], -1)
    rest = always @ np.linalg.lstsq(always, target, rcond=None)[0]
    best, most = float(values[0]), -np.inf
    for value in values:
        columns = np.concatenate([always, np.stack(law.basis(few, float(value)), -1)], -1)
        weights = np.linalg.lstsq(columns.T @ columns, columns.T @ target, rcond=1e-9)[0]
        fall = float(((target - rest) ** 2).sum() - ((target - columns @ weights) ** 2).sum())
        if fall > most:
            best, most = float(value), fall
    return best, len(values)


def law_words(model: mujoco.MjModel, lead: Scanned) -> str:
    """A law that is not named, in words.

    Args:
      model: the believed model.
      lead: of a scan.
    """
    assert lead.candidate.effect.law is not None
    joint = model.joint(lead.candidate.place.joints[0]).name
    return f"joint {joint}: what is left there looks like {lead.candidate.effect.law.title}"
