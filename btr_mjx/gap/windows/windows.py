"""Windows of recordings: multiple shooting with the unknown starting state of each window projected out.

Each window is simulated from a smoothed state that is corrected by Gauss-Newton steps (`starting_states`). The column
space of the Jacobian with respect to the starting state is projected out of residuals and signatures. Residuals are
corrected to a fine time step, see `time_steps`.
"""

import copy
from collections.abc import Callable, Sequence
from functools import partial

import mujoco
import numpy as np

from btr_mjx.gap.data import known_of
from btr_mjx.gap.simulate import Counter, Job, Segments, World, simulate
from btr_mjx.gap.windows.prepared import PreparedData
from btr_mjx.gap.windows.rows import select_rows
from btr_mjx.gap.windows.state_cache import StateCache
from btr_mjx.gap.windows.state_estimate import smooth
from btr_mjx.gap.windows.window_fits import project
from btr_mjx.models import difference

MakeWorld = Callable[[mujoco.MjModel], World]
"""A hypothesis: returns its world for the believed model of a recording."""

_MAX_CORRECTION = 2.0
"""Bound of the correction of a smoothed starting state, in units of the noise; scaled by chi^2 of the smoothing."""

_UNMEASURED_FACTOR = 50.0
"""Factor on this bound for coordinates that were not measured."""

_PER_WINDOW = (
    *("recording", "first", "time", "since", "target_q", "target_v", "act", "qpos", "qvel", "reach"),
    *("basis", "partial_basis", "correction", "base", "transitions", "perturbed_ends", "jacobians", "inverse"),
)
"""Attributes with one row per window."""

_MAX_RESIDUAL = 1e8
"""Residuals are clipped to this, in units of the noise; invalid states get this value. A bound that is reached by valid
states makes constants of residuals, which starting states explain."""


class Windows:
    """Windows with equal numbers of samples over some recordings; R = (k + 1) * measured coordinates.

    Attributes:
      data: the recordings.
      recording: (W,) recording index of each window.
      first: (W,) first sample of each window.
      k: samples of a window after the first.
      channels: (c,) measured coordinates, of (2 nv,) positions and velocities.
      changes_only: (c,) bool: estimated ones, whose errors stay for the whole window; only their changes are compared.
      qpos, qvel: (W, nq), (W, nv) starting states in measured coordinates.
      basis: (W, R, D) orthonormal basis of the starting state directions, followed by `partial_basis`.
      partial_basis: (W, R, S) directions of `project_partially`.
      dt: time step of the model divided by `data.step_divisor` [s].
      step: time step of residuals [s], `dt` or twice that.
      stride: time step of derivatives in units of `dt`.
      freedom: residual degrees of freedom of a window.
      correction: (W, R) correction of the time step, see `time_steps.step_error`.
      base: (W, k + 1, nq + nv) states of the base hypothesis from the starting states.
      make_base: the base hypothesis.
      cache: simulated states, shared with copies.
      transitions: (W, k, 2 nv, 2 nv) transition matrices from one sample to the next; like the following, those of
        windows that `linearise` returns.
      perturbed_ends: (W, k, 2 nv) effect of the perturbation of `transitions.transition_change`.
      jacobians: (W, R, 2 nv) derivatives of residuals with respect to the starting state, in units of the noise.
      inverse: (W, 2 nv, R) their pseudo-inverses.
    """

    transitions: np.ndarray
    perturbed_ends: np.ndarray
    jacobians: np.ndarray
    inverse: np.ndarray

    def __init__(
        self, data: PreparedData, recording: np.ndarray, first: np.ndarray, k: int, counter: Counter | None = None
    ) -> None:
        self.data, self.recording, self.first, self.k = data, np.asarray(recording), np.asarray(first), k
        self.counter, self.cache = counter or Counter(), StateCache()
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
        self.dt = float(model.opt.timestep) / data.step_divisor
        self.step = self.dt
        self.groups = self._by_model()
        self.qpos, self.qvel = np.empty((len(self), self.nq)), np.empty((len(self), self.nv))
        scatter = np.ones((len(self), self.nv))
        for r in np.unique(self.recording):
            own = np.flatnonzero(self.recording == r)
            q, v, chi2 = smooth(model, data.tracks[r], self.first[own], data.sigma, data.span)
            self.qpos[own], self.qvel[own] = q, v
            scatter[own] = np.maximum(chi2, 1.0)
        factor = np.where(data.measured, 1.0, _UNMEASURED_FACTOR)
        spread = known_of(data.recordings, "spread")
        reach = np.where(np.isnan(spread), data.sigma * factor * np.tile(scatter, 2), spread)
        self.reach = _MAX_CORRECTION * reach
        self.smoothed = self.qpos.copy(), self.qvel.copy()
        self.channels = np.flatnonzero(data.measured)
        self.changes_only = ~np.isnan(spread[self.channels])
        self.correction = np.zeros((len(self), (k + 1) * len(self.channels)))
        self.basis = np.zeros((*self.correction.shape, 0))
        self.partial_basis = self.basis
        self._raw: np.ndarray | None = None
        self._residual: np.ndarray | None = None
        self.base = np.zeros((0, 0, 0))
        self.make_base: MakeWorld | None = None
        self.stride = 1

    def __len__(self) -> int:
        return len(self.first)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a window's residual."""
        return self.correction.shape[1] - 2 * self.nv - int(self.changes_only.sum())

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

    def segments(self, own: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, samples: np.ndarray) -> Segments:
        """Windows `own` (N,) as segments, from given starting states and with given sample times."""
        return Segments(
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
          makes: the hypotheses.
          timestep: time step [s]; None for `step`.
          start: starting states qpos (W, nq), qvel (W, nv); None for those of the windows.
          own: (N,) indices of windows; None for all.

        Returns:
          For each hypothesis states (N, k + 1, nq + nv).
        """
        rows = np.arange(len(self)) if own is None else own
        qpos, qvel = start or (self.qpos, self.qvel)
        step = timestep or self.step
        find = partial(self._simulated, makes, rows, qpos, qvel, step)
        names = np.stack([self.recording[rows], self.first[rows]], 1)
        keys = [b"".join(a.tobytes() for a in row) for row in zip(names, qpos[rows], qvel[rows], strict=True)]
        return self.cache([(make, step) for make in makes], keys, find)

    def _simulated(
        self,
        makes: Sequence[MakeWorld],
        rows: np.ndarray,
        qpos: np.ndarray,
        qvel: np.ndarray,
        timestep: float,
        wanted: Sequence[tuple[int, np.ndarray]],
    ) -> list[np.ndarray]:
        """Simulate states that are not cached: for each (i, positions in `rows`) those of hypothesis i."""
        segment_sets: dict[tuple[int, bytes], Segments] = {}
        out = [np.empty((len(positions), self.k + 1, self.nq + self.nv)) for _, positions in wanted]
        jobs: list[Job] = []
        places = []
        for states, (i, positions) in zip(out, wanted, strict=True):
            for j, (model, mine) in enumerate(self.groups):
                part = np.flatnonzero(np.isin(rows[positions], mine))
                own = rows[positions[part]]
                if not len(own):
                    continue
                key = j, own.tobytes()
                if key not in segment_sets:  # shared by hypotheses
                    segment_sets[key] = self.segments(own, qpos[own], qvel[own], self.since[own])
                jobs.append((makes[i](model), segment_sets[key]))
                places.append((states, part))
        found = simulate(jobs, timestep=timestep, counter=self.counter)
        for (states, part), of_job in zip(places, found, strict=True):
            states[part] = of_job
        return out

    def whiten(self, states: np.ndarray, own: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Whitened differences (W, R) between states of windows `own` and their data."""
        return self.scaled(self.minus(states, np.concatenate([self.target_q[own], self.target_v[own]], -1)))

    def minus(self, states: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Difference of states (..., nq + nv) in the tangent space (..., 2 nv)."""
        model, nq = self.groups[0][0], self.nq
        position = difference(model, other[..., :nq], states[..., :nq])
        return np.concatenate([position, states[..., nq:] - other[..., nq:]], -1)

    def scaled(self, tangent: np.ndarray) -> np.ndarray:
        """Measured coordinates of tangent vectors (..., k + 1, 2 nv) as rows (..., R) in units of the noise."""
        rows = (tangent / self.data.sigma)[..., self.channels]
        rows = np.clip(
            np.nan_to_num(rows, nan=_MAX_RESIDUAL, posinf=_MAX_RESIDUAL, neginf=-_MAX_RESIDUAL),
            -_MAX_RESIDUAL,
            _MAX_RESIDUAL,
        )
        if self.changes_only.any():
            rows[..., self.changes_only] -= rows[..., self.changes_only].mean(-2, keepdims=True)
        return rows.reshape(*rows.shape[:-2], -1)

    def project_partially(self, directions: np.ndarray) -> None:
        """Reduce the weight of some directions in all residuals from now on.

        Args:
          directions: (W, R, S) vectors v; a residual e becomes e - v (v . e). Their components along the starting
            state directions are removed.
        """
        state = self.basis[:, :, : 2 * self.nv]
        off = project(np.moveaxis(directions, 2, 0), state)
        self.partial_basis = np.moveaxis(off, 0, 2)
        self.basis = np.concatenate([state, self.partial_basis], 2)
        self._residual = None

    def copied(self) -> "Windows":
        """A shallow copy without cached residuals."""
        other = copy.copy(self)
        other.clear_residuals()
        return other

    def clear_residuals(self) -> None:
        """Delete cached residuals; call it after a change of anything that they depend on."""
        self._raw = self._residual = None

    def some(self, index: np.ndarray) -> "Windows":
        """A subset of the windows."""
        other = self.copied()
        for name in _PER_WINDOW:
            setattr(other, name, getattr(self, name)[index])
        other.smoothed = self.smoothed[0][index], self.smoothed[1][index]
        other.groups = other._by_model()
        return other

    @property
    def raw(self) -> np.ndarray:
        """Whitened residual (W, R) of the base, with nothing projected out."""
        if self._raw is None:
            self._raw = self.whiten(self.base) + self.correction
        return self._raw

    @property
    def residual(self) -> np.ndarray:
        """Projected residual (W, R) of the base in units of the noise, computed on first use."""
        if self._residual is None:
            self._residual = project(self.raw, self.basis)
        return self._residual

    def based(self, make: MakeWorld) -> "Windows":
        """A copy with another hypothesis as base and the same starting states."""
        other = self.copied()
        other.base, other.make_base = self.at(make), make
        return other

    def at(self, make: MakeWorld) -> np.ndarray:
        """States (W, k + 1, nq + nv) of a hypothesis from the starting states; not simulated for the base."""
        return self.base if make is self.make_base else self.states([make])[0]

    def mixed(self, others: Sequence["Windows"], chosen: np.ndarray) -> "Windows":
        """A copy with the starting states and derivatives of other `Windows` in some windows.

        Args:
          others: windows of the same data.
          chosen: (W,) integers: 0 for these windows, i for `others[i - 1]`.
        """
        if not chosen.any():
            return self
        other = self.copied()
        for name in _PER_WINDOW:
            setattr(other, name, select_rows(getattr(self, name), [getattr(w, name) for w in others], chosen))
        return other

    def residuals(self, makes: Sequence[MakeWorld]) -> list[np.ndarray]:
        """Projected residuals (W, R) of hypotheses by simulation, with the correction of the base."""
        return [project(self.whiten(s) + self.correction, self.basis) for s in self.states(makes)]
