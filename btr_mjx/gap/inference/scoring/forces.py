"""What is missing, without a library: unknown generalised forces, fitted to every window.

One force per degree of freedom and part of a window explains whatever acts on the robot. How much of the residual
these forces explain bounds what any effect could; what a named effect leaves of it is lack of fit. The forces
themselves say which joint the unknown acts on and which variable it follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.inference.scoring.gains import without_wildest
from btr_mjx.gap.windows import MakeWorld, Windows, force_signatures, window_parts

_BINS = 4
"""Parts of a window with a force of their own, at least."""

_PART = 0.05
"""Longest part of a window with one force [s]."""

_MOST = 100.0
"""A force counts up to so much where its size is told, in units of its standard deviation."""

_CAP = 6.0
"""A window's excess counts up to so many standard deviations."""

_DESCRIBED = 3
"""Largest number of degrees of freedom whose unknown force is described."""


@dataclass(frozen=True)
class Circumstances:
    """What the robot does in every sample interval of every window, in the base world.

    Attributes:
      position: (W, k, nv) configuration as a tangent vector from the model's reference.
      velocity: (W, k, nv).
      acceleration: (W, k, nv).
      load: (W, k, nv) generalised force of the actuators.
      contact: (W, k, nv) bool: something below that degree of freedom touches.
      time: (W, k) since the recording's start [s].
      inverse: (W, k, nv, nv) inverse inertia.
      estimated: (nv,) bool: positions that no sensor measured.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    load: np.ndarray
    contact: np.ndarray
    time: np.ndarray
    inverse: np.ndarray
    estimated: np.ndarray


def circumstances(windows: Windows, base: MakeWorld) -> Circumstances:
    """Evaluate the base world at the base states."""
    shape = (len(windows), windows.k, windows.nv)
    position, velocity, acceleration, load = (np.zeros(shape) for _ in range(4))
    contact, inverse = np.zeros(shape, bool), np.zeros((*shape, windows.nv))
    identity = np.eye(windows.nv)
    for model, own in windows.groups:
        world = base(model)
        model = world.model
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data, below = mujoco.MjData(model), _below(model)
        commands = [world.command(c) for c in windows.data.commands]
        control = np.stack([commands[windows.recording[w]].at(windows.time[w, :-1]) for w in own])
        for i, w in enumerate(own):
            for k in range(windows.k):
                state = windows.base[w, k]
                if not np.isfinite(state).all():
                    continue
                data.qpos[:], data.qvel[:] = state[: windows.nq], state[windows.nq :]
                data.ctrl[:] = control[i, k]
                if model.na:
                    data.act[:] = windows.act[w, k]
                mujoco.mj_forward(model, data)
                mujoco.mj_differentiatePos(model, position[w, k], 1.0, model.qpos0, data.qpos)
                velocity[w, k], acceleration[w, k] = data.qvel, data.qacc
                load[w, k] = data.qfrc_actuator
                mujoco.mj_solveM(model, data, inverse[w, k], identity)
                for geoms in data.contact.geom[: data.ncon]:
                    for geom in geoms[geoms >= 0]:
                        contact[w, k] |= below[model.geom_bodyid[geom]]
    started = np.array([r.time[0] for r in windows.data.recordings])[windows.recording]
    time = windows.time[:, :-1] - started[:, None]
    estimated = np.isin(np.arange(windows.nv), windows.channels[windows.changes_only])
    return Circumstances(position, velocity, acceleration, load, contact, time, inverse, estimated)


def _below(model: mujoco.MjModel) -> np.ndarray:
    """(nbody, nv) bool: whether a degree of freedom moves the body."""
    out = np.zeros((model.nbody, model.nv), bool)
    for body in range(1, model.nbody):
        out[body] = out[model.body_parentid[body]]
        first = model.body_dofadr[body]
        if first >= 0:
            out[body, first : first + model.body_dofnum[body]] = True
    return out


@dataclass(frozen=True)
class Forces:
    """Unknown generalised forces in every window.

    Attributes:
      value: (W, bins, nv) best estimate [N m or N].
      sigma: (W, bins, nv) its standard deviation by the sensors' noise alone.
      explained: (W,) part of the residual's chi^2 that they explain.
      rank: (W,) what they would explain of pure noise.
    """

    value: np.ndarray
    sigma: np.ndarray
    explained: np.ndarray
    rank: np.ndarray


class ForceFit:
    """Fits unknown generalised forces to residuals of one set of windows.

    Attributes:
      bins: parts of a window with a force of their own.
      columns: (W, nv * bins, R) their signatures, degree of freedom first.
    """

    def __init__(self, windows: Windows, around: Circumstances) -> None:
        length = float(np.median(windows.since[:, -1]))
        self.bins = min(max(_BINS, round(length / _PART)), windows.k)
        self.part = window_parts(windows.k, self.bins)
        columns = force_signatures(windows, around.inverse, self.bins)
        self.shape = (windows.nv, self.bins)
        self._shape = (len(windows), *self.shape)
        self.columns = np.ascontiguousarray(np.moveaxis(columns, 0, 1))  # (W, nv * bins, R)
        stacked = self.columns.astype(float)
        scale = np.sqrt((stacked**2).sum(2)) + 1e-300
        tall, square = np.linalg.qr(np.swapaxes(stacked / scale[..., None], 1, 2))
        u, s, vt = np.linalg.svd(np.swapaxes(square, 1, 2), full_matrices=False)
        vt = vt @ np.swapaxes(tall, 1, 2)
        keep = s > 1e-3 * s[:, :1]
        self._rank = keep.sum(1)
        inverse = np.where(keep, 1.0 / np.maximum(s, 1e-300), 0.0)
        self._rows = vt * keep[..., None]  # (W, r, R) orthonormal
        self._back = u * inverse[:, None, :] / scale[..., None]  # (W, nv * bins, r)
        self._sigma = np.sqrt((self._back**2).sum(2))

    def __call__(self, residual: np.ndarray) -> Forces:
        """Forces that would remove a residual (W, R)."""
        inner = (self._rows @ residual[..., None])[..., 0]
        value = -(self._back @ inner[..., None])[..., 0]

        def order(x: np.ndarray) -> np.ndarray:
            return np.swapaxes(x.reshape(self._shape), 1, 2)

        return Forces(order(value), order(self._sigma), (inner**2).sum(1), self._rank)

    def average(self, values: np.ndarray) -> np.ndarray:
        """Means (W, bins, ...) of values (W, k, ...) over the parts of a window."""
        return np.stack([values[:, self.part == b].mean(1) for b in range(self.bins)], 1)


def beyond_noise(forces: Forces) -> tuple[np.ndarray, np.ndarray]:
    """Forces (W, bins, nv) without wild ones, and their variance by noise alone, by which their square exceeds them."""
    sigma = np.where(np.isfinite(forces.value), forces.sigma, 0.0)
    return np.clip(np.nan_to_num(forces.value), -_MOST * sigma, _MOST * sigma), sigma**2


def excess(forces: Forces) -> np.ndarray:
    """By how much the forces explain more than they would of noise, per window, bounded (W,)."""
    spread = np.sqrt(2.0 * forces.rank)
    return np.minimum(forces.explained - forces.rank, _CAP * spread)


def lack_of_fit(sides: Sequence[Forces]) -> float:
    """How many standard deviations the windows' excess lies above pure noise, over both sides of the split.

    The window with the largest excess does not count, on either side.
    """
    total = sum(float(without_wildest(excess(forces))) for forces in sides)
    return total / float(np.sqrt(sum(2.0 * float(forces.rank.sum()) for forces in sides)))


@dataclass(frozen=True)
class Description:
    """The unknown, as well as the unknown forces tell.

    Attributes:
      dof: degree of freedom on which most of it acts.
      share: part of the significant force that acts there.
      follows: variables that the force there follows, most telling first: (name, dof or None, correlation).
      size: root mean square of the force there [N m or N].
    """

    dof: int
    share: float
    follows: tuple[tuple[str, int | None, float], ...]
    size: float


def describe(fit: ForceFit, forces: Forces, around: Circumstances) -> list[Description]:
    """Where the unknown acts and what it follows, by weighted sparse regression.

    Args:
      fit: of the same windows.
      forces: what is left of the residual.
      around: circumstances of the windows.
    """
    nv = forces.value.shape[2]
    weight = 1.0 / np.maximum(forces.sigma, 1e-300) ** 2
    z2 = np.minimum(forces.value**2 * weight, 100.0)
    strength = np.maximum(z2.mean((0, 1)) - 1.0, 0.0)
    total = max(float(strength.sum()), 1e-12)
    features = _features(fit, around)
    bounded, noise = beyond_noise(forces)
    sizes = np.sqrt(np.maximum((bounded**2 - noise).mean((0, 1)), 0.0)).tolist()
    out = []
    for dof in np.argsort(-strength)[:_DESCRIBED]:
        if strength[dof] < 0.05 * total or strength[dof] <= 0:
            break
        y, w = forces.value[..., dof].ravel(), weight[..., dof].ravel()
        w = w * np.where(z2[..., dof].ravel() >= 100.0, 0.1, 1.0)
        follows, left = [], y - np.average(y, weights=w)
        for _ in range(2):
            best = None
            for name, other, x in features:
                if other is not None and name.endswith(" here"):
                    if other != dof:
                        continue
                elif other == dof:
                    continue
                x = x.ravel() - np.average(x.ravel(), weights=w)
                scale = np.average(x**2, weights=w)
                if scale <= 0:
                    continue
                corr = np.average(x * left, weights=w) / np.sqrt(scale * max(np.average(left**2, weights=w), 1e-300))
                if best is None or abs(corr) > abs(best[2]):
                    best = (name, other, float(corr), x)
            if best is None or abs(best[2]) < 0.15:
                break
            follows.append((best[0].removesuffix(" here"), best[1], best[2]))
            slope = np.average(best[3] * left, weights=w) / np.average(best[3] ** 2, weights=w)
            left = left - slope * best[3]
        out.append(Description(int(dof), float(strength[dof]) / total, tuple(follows), sizes[dof]))
    return out if nv else []


def _features(fit: ForceFit, around: Circumstances) -> Sequence[tuple[str, int | None, np.ndarray]]:
    """Variables (W, bins) that a force may follow: (name, degree of freedom, values)."""
    position, velocity = fit.average(around.position), fit.average(around.velocity)
    acceleration, load = fit.average(around.acceleration), fit.average(around.load)
    time = fit.average(around.time)
    out: list[tuple[str, int | None, np.ndarray]] = [("time", None, time)]
    for dof in range(position.shape[2]):
        q, v, load_here = position[..., dof], velocity[..., dof], load[..., dof]
        out += [
            ("position here", dof, q),
            ("position cubed here", dof, q**3),
            ("velocity here", dof, v),
            ("direction of motion here", dof, np.sign(v)),
            ("velocity squared here", dof, v * np.abs(v)),
            ("acceleration here", dof, acceleration[..., dof]),
            ("load here", dof, load_here),
            ("load against motion here", dof, np.abs(load_here) * np.sign(v)),
            ("load growing with time here", dof, load_here * time),
            ("position", dof, q),
            ("velocity", dof, v),
            ("load", dof, load_here),
        ]
    return out
