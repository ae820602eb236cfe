"""Short windows of the recordings: multiple shooting, with the unknown starting state of each window projected out.

A window begins at a smoothed state that takes one Gauss-Newton step towards its own samples where that helps. What
the starting state could still explain is projected out of residuals and of signatures, so that neither noise at the
start nor chaos between windows matters. Residuals belong to a fine time step (the simulator's own error looks like
damping); how they answer to parameters comes from a longer one, see `time_steps`.
"""

import copy
from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np

from btr_mjx.gap.simulate import Counter, Job, Stretch, World, simulate
from btr_mjx.gap.windows.likelihood import project
from btr_mjx.gap.windows.memory import Memory
from btr_mjx.gap.windows.prepared import Data
from btr_mjx.gap.windows.rows import picked
from btr_mjx.gap.windows.state_estimate import smooth
from btr_mjx.models import difference

MakeWorld = Callable[[mujoco.MjModel], World]
"""The world of a hypothesis, given the believed model of a recording."""

_REACH = 2.0
"""How far a starting state may be led away from the smoothed one, in units of the noise; more where smoothing fails."""

_UNSEEN = 50.0
"""Coordinates that were not measured may be led away further by this factor."""

_PER_WINDOW = (
    *("recording", "first", "time", "since", "target_q", "target_v", "act", "qpos", "qvel", "reach"),
    *("basis", "soft", "correction", "base", "transitions", "answers", "jacobians", "inverse"),
    "tame",
)
"""Arrays with a row for every window."""

_CEILING = 1e4
"""Residuals are cut here, in units of the noise; a diverged simulation counts as this."""


class Windows:
    """Windows of equal numbers of samples over some recordings.

    Attributes:
      data: the recordings.
      recording: (W,) which recording each window is of.
      first: (W,) its first sample.
      k: samples of a window after the first.
      qpos, qvel: (W, nq), (W, nv) starting states, measured coordinates.
      basis: (W, R, D) orthonormal directions of the starting state, then those of `soften`.
      soft: (W, R, S) the latter.
      step: time step of residuals [s], the model's or twice that; what it does is corrected.
      stride: time steps of the model that one step takes where only directions are asked for.
      freedom: residual degrees of freedom of a window.
      tame: (W,) bool: where transitions may be multiplied, see `propagation.tame`.
      base: (W, k + 1, nq + nv) states of the base world from the starting states.
      maker: the hypothesis that they are of.
      memory: what was simulated in them and their copies.
      transitions: (W, k, 2 nv, 2 nv) from one sample to the next; this and what follows is set by `linearise`.
      answers: (W, k, 2 nv) where the nudge of `transitions.strangeness` leads.
      jacobians: (W, R, 2 nv) how residuals answer to the starting state, in units of the noise.
      inverse: (W, 2 nv, R) pseudo-inverse of these.
    """

    transitions: np.ndarray
    answers: np.ndarray
    jacobians: np.ndarray
    inverse: np.ndarray
    tame: np.ndarray

    def __init__(
        self, data: Data, recording: np.ndarray, first: np.ndarray, k: int, counter: Counter | None = None
    ) -> None:
        self.data, self.recording, self.first, self.k = data, np.asarray(recording), np.asarray(first), k
        self.counter, self.memory = counter or Counter(), Memory()
        index = self.first[:, None] + np.arange(k + 1)
        pick = [data.recordings[r] for r in self.recording]
        self.time = np.stack([r.time[i] for r, i in zip(pick, index, strict=True)])
        self.since = self.time - self.time[:, :1]
        self.target_q = np.stack([r.qpos[i] for r, i in zip(pick, index, strict=True)])
        self.target_v = np.stack([r.qvel[i] for r, i in zip(pick, index, strict=True)])
        self.target_v = np.nan_to_num(self.target_v)
        self.act = np.stack([data.acts[r][i] for r, i in zip(self.recording, index, strict=True)])
        model = pick[0].model
        self.nq, self.nv = model.nq, model.nv
        self.dt = float(model.opt.timestep) / data.finer
        self.step = self.dt
        self.groups = self._by_model()
        self.qpos, self.qvel = np.empty((len(self), self.nq)), np.empty((len(self), self.nv))
        doubt = np.ones((len(self), self.nv))
        for r in np.unique(self.recording):
            own = np.flatnonzero(self.recording == r)
            q, v, chi2 = smooth(model, data.tracks[r], self.first[own], data.sigma, data.span)
            self.qpos[own], self.qvel[own] = q, v
            doubt[own] = np.maximum(chi2, 1.0)
        self.reach = _REACH * data.sigma * np.where(data.measured, 1.0, _UNSEEN) * np.tile(doubt, 2)
        self.smoothed = self.qpos.copy(), self.qvel.copy()
        self.channels = np.flatnonzero(data.measured)
        self.correction = np.zeros((len(self), (k + 1) * len(self.channels)))
        self.basis = np.zeros((*self.correction.shape, 0))
        self.soft = self.basis
        self._raw: np.ndarray | None = None
        self._residual: np.ndarray | None = None
        self.base = np.zeros((0, 0, 0))
        self.maker: MakeWorld | None = None
        self.stride = 1

    def __len__(self) -> int:
        return len(self.first)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a window's residual."""
        return self.correction.shape[1] - 2 * self.nv

    @property
    def models(self) -> list[mujoco.MjModel]:
        """Believed models, one per group of recordings that share one."""
        return [model for model, _ in self.groups]

    def _by_model(self) -> list[tuple[mujoco.MjModel, np.ndarray]]:
        """Believed models and the windows of each."""
        groups: dict[int, tuple[mujoco.MjModel, list[int]]] = {}
        for window, r in enumerate(self.recording):
            model = self.data.recordings[r].model
            groups.setdefault(id(model), (model, []))[1].append(window)
        return [(model, np.array(own)) for model, own in groups.values()]

    def stretch(self, own: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, samples: np.ndarray) -> Stretch:
        """A stretch of windows `own` from given states at given times since their start."""
        return Stretch(
            start=self.time[own, 0],
            qpos=qpos,
            qvel=qvel,
            samples=samples,
            commands=self.data.commands,
            recording=self.recording[own],
            act=self.act[own, 0] if self.act.shape[2] else None,
        )

    def states(
        self,
        makes: Sequence[MakeWorld],
        *,
        timestep: float | None = None,
        start: tuple[np.ndarray, np.ndarray] | None = None,
        own: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        """Simulate hypotheses over windows.

        Args:
          makes: one world maker per hypothesis.
          timestep: another one than `step` [s].
          start: other starting states qpos (W, nq), qvel (W, nv).
          own: (N,) some of the windows; None for all.

        Returns:
          For each hypothesis states (N, k + 1, nq + nv).
        """
        rows = np.arange(len(self)) if own is None else own
        qpos, qvel = start or (self.qpos, self.qvel)
        step = timestep or self.step
        find = partial(self._simulated, makes, rows, qpos, qvel, step)
        names = np.stack([self.recording[rows], self.first[rows]], 1)
        keys = [b"".join(a.tobytes() for a in row) for row in zip(names, qpos[rows], qvel[rows], strict=True)]
        return self.memory([(make, step) for make in makes], keys, find)

    def _simulated(
        self,
        makes: Sequence[MakeWorld],
        rows: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
        timestep: float,
        wanted: Sequence[tuple[int, np.ndarray]],
    ) -> list[np.ndarray]:
        """Simulate what the memory does not hold: for each (i, places in `rows`) the states of hypothesis i there."""
        stretches: dict[tuple[int, bytes], Stretch] = {}
        out = [np.empty((len(asked), self.k + 1, self.nq + self.nv)) for _, asked in wanted]
        jobs: list[Job] = []
        places = []
        for states, (i, asked) in zip(out, wanted, strict=True):
            for j, (model, mine) in enumerate(self.groups):
                part = np.flatnonzero(np.isin(rows[asked], mine))
                own = rows[asked[part]]
                if not len(own):
                    continue
                key = j, own.tobytes()
                if key not in stretches:  # what hypotheses share is laid out once
                    stretches[key] = self.stretch(own, qpos[own], qvel[own], self.since[own])
                jobs.append((makes[i](model), stretches[key]))
                places.append((states, part))
        found = simulate(jobs, timestep=timestep, counter=self.counter)
        for (states, part), of_job in zip(places, found, strict=True):
            states[part] = of_job
        return out

    def whiten(self, states: np.ndarray, own: np.ndarray | slice = slice(None)) -> np.ndarray:
        """States of windows `own` minus their data in units of the noise, (W, R)."""
        return self.scaled(self.minus(states, np.concatenate([self.target_q[own], self.target_v[own]], -1)))

    def minus(self, states: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Difference of states in the tangent space (..., 2 nv)."""
        model, nq = self.groups[0][0], self.nq
        position = difference(model, other[..., :nq], states[..., :nq])
        return np.concatenate([position, states[..., nq:] - other[..., nq:]], -1)

    def scaled(self, tangent: np.ndarray) -> np.ndarray:
        """Tangent vectors (..., k + 1, 2 nv) as rows (..., R) in units of the noise; what is invalid becomes huge."""
        rows = (tangent / self.data.sigma)[..., self.channels]
        rows = np.clip(np.nan_to_num(rows, nan=_CEILING, posinf=_CEILING, neginf=-_CEILING), -_CEILING, _CEILING)
        return rows.reshape(*rows.shape[:-2], -1)

    def soften(self, directions: np.ndarray) -> None:
        """Let some directions count less in all residuals from now on.

        Args:
          directions: (W, R, D), scaled as those of `project`; what they share with starting states is left out.
        """
        state = self.basis[:, :, : 2 * self.nv]
        off = project(np.moveaxis(directions, 2, 0), state)
        self.soft = np.moveaxis(off, 0, 2)
        self.basis = np.concatenate([state, self.soft], 2)
        self._residual = None

    def copied(self) -> "Windows":
        """A copy that is about to be changed."""
        other = copy.copy(self)
        other.forget_residuals()
        return other

    def forget_residuals(self) -> None:
        """Residuals are found again when they are next asked for; call it after a change of what they depend on."""
        self._raw = self._residual = None

    def some(self, index: np.ndarray) -> "Windows":
        """Some of the windows."""
        other = self.copied()
        for name in _PER_WINDOW:
            setattr(other, name, getattr(self, name)[index])
        other.smoothed = self.smoothed[0][index], self.smoothed[1][index]
        other.groups = other._by_model()
        return other

    def calm(self) -> "Windows":
        """Those in which the linear picture holds: a small error of any number is a large one in the others."""
        return self if self.tame.all() else self.some(np.flatnonzero(self.tame))

    def joined(self, other: "Windows") -> "Windows":
        """These and others of the same recordings and of the same length and time step, all linearised."""
        both = self.copied()
        for name in _PER_WINDOW:
            setattr(both, name, np.concatenate([getattr(self, name), getattr(other, name)]))
        qpos, qvel = (np.concatenate(pair) for pair in zip(self.smoothed, other.smoothed, strict=True))
        both.smoothed, both.stride = (qpos, qvel), min(self.stride, other.stride)
        both.maker = self.maker if self.maker is other.maker else None
        both.groups = both._by_model()
        return both

    @property
    def raw(self) -> np.ndarray:
        """Residual of the base (W, R) from the starting states as they are: nothing is projected out."""
        if self._raw is None:
            self._raw = self.whiten(self.base) + self.correction
        return self._raw

    @property
    def residual(self) -> np.ndarray:
        """Projected residual of the base (W, R) in units of the noise, found when it is first asked for."""
        if self._residual is None:
            self._residual = project(self.raw, self.basis)
        return self._residual

    def based(self, make: MakeWorld) -> "Windows":
        """A copy of which another hypothesis is the base, from the same starting states."""
        other = self.copied()
        other.base, other.maker = self.at(make), make
        return other

    def at(self, make: MakeWorld) -> np.ndarray:
        """States (W, k + 1, nq + nv) of a hypothesis from the starting states; those of the base are known."""
        return self.base if make is self.maker else self.states([make])[0]

    def mixed(self, others: Sequence["Windows"], chosen: np.ndarray) -> "Windows":
        """The same with some windows as others have them: their starting states, and the directions of these.

        Args:
          others: of the same data; the first of them is number 1.
          chosen: (W,) whose each window is, 0 for its own.
        """
        if not chosen.any():
            return self
        other = self.copied()
        for name in _PER_WINDOW:
            setattr(other, name, picked(getattr(self, name), [getattr(w, name) for w in others], chosen))
        return other

    def residuals(self, makes: Sequence[MakeWorld]) -> list[np.ndarray]:
        """Projected residuals (W, R) of hypotheses, by true simulation."""
        return [project(self.whiten(s) + self.correction, self.basis) for s in self.states(makes)]
