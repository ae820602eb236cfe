"""How well the believed model predicts short stretches, under any change of the columns of positions and commands.

A stretch starts from the measured positions and their slope; measured velocities are not used. The model is simulated
with the recorded commands, and its positions are compared with the measured ones. An error is relative to the motion
of its coordinates, so that it does not depend on their unit.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise
from btr_mjx.gap.preflight.stretches import Stretch, choose_stretches, motion_seconds
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.models import difference, integrate, part_names

WORST = 1e4
"""Largest relative error (variance), also that of a simulation that diverges."""

_SAMPLES = 4
"""Times within a stretch at which positions are compared."""

_SLOPE_SHARE = 0.3
"""Share of a stretch, on either side of its start, from which the starting state is fitted."""

_SLOPE_ROWS = 12
"""Largest number of rows on either side of the start in this fit."""


@dataclass(frozen=True)
class ColumnMap:
    """An affine change of columns: out[..., i] = x[..., source[i]] * scale[i] + offset[i]."""

    source: np.ndarray
    scale: np.ndarray
    offset: np.ndarray

    @classmethod
    def identity(cls, count: int) -> "ColumnMap":
        """No change of `count` columns."""
        return cls(np.arange(count), np.ones(count), np.zeros(count))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The changed columns."""
        return values[..., self.source] * self.scale + self.offset

    def after(self, first: "ColumnMap") -> "ColumnMap":
        """This change of what `first` gives."""
        return ColumnMap(
            first.source[self.source],
            first.scale[self.source] * self.scale,
            first.offset[self.source] * self.scale + self.offset,
        )


@dataclass(frozen=True)
class Change:
    """A change of what the data, or the model, are taken to mean.

    Attributes:
      qpos, ctrl: of the columns.
      gravity: (3,) of the model; None for that of each recording's model.
      switched_off: actuators without force.
    """

    qpos: ColumnMap
    ctrl: ColumnMap
    gravity: tuple[float, float, float] | None = None
    switched_off: tuple[int, ...] = ()

    @classmethod
    def none(cls, model: mujoco.MjModel) -> "Change":
        """No change."""
        return cls(ColumnMap.identity(model.nq), ColumnMap.identity(model.nu))

    def after(self, first: "Change") -> "Change":
        """This change of what `first` gives."""
        return Change(
            self.qpos.after(first.qpos),
            self.ctrl.after(first.ctrl),
            first.gravity if self.gravity is None else self.gravity,
            self.switched_off + first.switched_off,
        )


@dataclass(frozen=True)
class CoordinateGroup:
    """Coordinates that are judged together: a hinge or slide, or position or rotation of a free or ball joint.

    Attributes:
      joint: id of the joint.
      dofs: its coordinates.
    """

    joint: int
    dofs: slice


def groups_of(model: mujoco.MjModel) -> list[CoordinateGroup]:
    """The groups of a model, in the order of its coordinates."""
    out = []
    for joint, (kind, v) in enumerate(zip(model.jnt_type.tolist(), model.jnt_dofadr.tolist(), strict=True)):
        match kind:
            case mujoco.mjtJoint.mjJNT_FREE:
                out += [CoordinateGroup(joint, slice(v, v + 3)), CoordinateGroup(joint, slice(v + 3, v + 6))]
            case mujoco.mjtJoint.mjJNT_BALL:
                out.append(CoordinateGroup(joint, slice(v, v + 3)))
            case _:
                out.append(CoordinateGroup(joint, slice(v, v + 1)))
    return out


@dataclass(frozen=True, eq=False)
class _Cut:
    """Rows of one stretch: those around its start, those that are compared, and its command."""

    stretch: Stretch
    around: np.ndarray
    samples: np.ndarray
    command: slice


@dataclass(frozen=True)
class _Worlds:
    """Worlds by model and change of it: a model with meshes takes many megabytes, and most changes leave it alone."""

    known: dict[tuple[int, tuple[float, float, float] | None, tuple[int, ...]], World]

    def of(self, model: mujoco.MjModel, change: Change) -> World:
        """The world of a recording's model under a change."""
        key = id(model), change.gravity, change.switched_off
        if key not in self.known:
            world = self.known[key] = World.of(model)
            if change.gravity is not None:
                world.model.opt.gravity[:] = change.gravity
            for actuator in change.switched_off:
                world.model.actuator_gainprm[actuator], world.model.actuator_biasprm[actuator] = 0.0, 0.0
        return self.known[key]


class Predictor:
    """Stretches of a dataset, and the error of the believed model in them.

    Attributes:
      seconds: typical length of a stretch.
      groups: coordinates by which errors are given.
    """

    def __init__(self, dataset: Dataset, noise: Noise, count: int) -> None:
        self.groups = groups_of(dataset.model)
        self._dataset, self._noise = dataset, noise
        self.seconds = motion_seconds(dataset)
        stretches = choose_stretches(dataset, self.seconds, count, _SLOPE_SHARE)
        self._cuts = [_cut(s) for s in stretches]

    def __len__(self) -> int:
        return len(self._cuts)

    def few(self, count: int) -> "Predictor":
        """The same with at most `count` stretches."""
        out = copy.copy(self)
        if len(self) > count:
            out._cuts = [self._cuts[i] for i in np.linspace(0, len(self) - 1, count).round().astype(int)]
        return out

    def start_times(self) -> tuple[np.ndarray, np.ndarray]:
        """Recording (W,) of each stretch, and time of its start since the recording's [s]."""
        rows = [(c.stretch.recording, c.stretch.first) for c in self._cuts]
        times = [self._dataset.recordings[i].time for i, _ in rows]
        since = [time[k] - time[0] for time, (_, k) in zip(times, rows, strict=True)]
        return np.array([i for i, _ in rows], int), np.array(since)

    def errors(self, changes: Sequence[Change]) -> np.ndarray:
        """Relative error variances (changes, W, groups), between the noise and `WORST`; see `motions`."""
        pairs = zip(changes, self.motions(changes), strict=True)
        return np.array([self._relative(change, *pair) for change, pair in pairs])

    def motions(
        self, changes: Sequence[Change], command_shift: float = 0.0, command_scale: float = 1.0
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Simulate all stretches under each change.

        Args:
          changes: of the data or the model.
          command_shift: delay of all commands [s].
          command_scale: factor of all commands.

        Returns:
          For each change, measured and simulated motion since the start of each stretch, (W, samples, nv) each.
        """
        jobs, ends = [], []
        worlds = _Worlds({})
        for change in changes:
            for recording in sorted({c.stretch.recording for c in self._cuts}):
                cuts = [c for c in self._cuts if c.stretch.recording == recording]
                job, end = self._job(worlds, change, recording, cuts, command_shift, command_scale)
                jobs.append(job)
                ends.append(end)
        states = simulate(jobs)
        out = []
        each = len(jobs) // max(len(changes), 1)
        nq = self._dataset.model.nq
        for i in range(len(changes)):
            pairs = []
            for (world, segments), end, found in zip(
                *(x[i * each : (i + 1) * each] for x in (jobs, ends, states)), strict=True
            ):
                start = segments.qpos[:, None]
                measured = difference(world.model, start, end)
                with np.errstate(invalid="ignore"):
                    pairs.append((measured, difference(world.model, start, found[..., :nq])))
            out.append((np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])))
        return out

    def _relative(self, change: Change, measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
        sigma = self._dof_noise(change)
        out = np.empty((len(measured), len(self.groups)))
        for g, group in enumerate(self.groups):
            with np.errstate(invalid="ignore", over="ignore"):
                left = np.mean((simulated - measured)[..., group.dofs] ** 2, axis=1).sum(axis=1)
            size = np.mean(measured[..., group.dofs] ** 2, axis=1).sum(axis=1)
            noise = float(np.sum(sigma[group.dofs] ** 2)) + 1e-12 * float(size.mean()) + 1e-300
            # A stretch in which this group hardly moves has the scale of the others.
            scale = np.maximum(size, 0.25 * float(size.mean())) + noise
            out[:, g] = np.clip(np.nan_to_num((left + noise) / scale, nan=WORST, posinf=WORST), 0, WORST)
        return out

    def _command(self, recording: int, cut: _Cut, change: Change, shift: float, scale: float) -> Command:
        """The commands around a stretch."""
        data = self._dataset.recordings[recording]
        times, values = data.commands
        low, high = np.searchsorted(times, data.time[[cut.command.start, min(cut.command.stop, len(data.time)) - 1]])
        rows = slice(max(0, int(low) - 1), int(high) + 2)
        return Command(times[rows] + shift, change.ctrl(values[rows]) * scale, self._dataset.interpolation)

    def _dof_noise(self, change: Change) -> np.ndarray:
        """Standard deviations (nv,) of the changed positions."""
        model, sigma = self._dataset.model, self._noise.qpos.copy()
        owner = {int(q): int(v) for q, v in zip(model.jnt_qposadr, model.jnt_dofadr, strict=True)}
        for group in self.groups:
            if group.dofs.stop - group.dofs.start == 1:
                q = int(model.jnt_qposadr[group.joint])
                source = owner.get(int(change.qpos.source[q]))
                if source is not None:
                    sigma[group.dofs] = self._noise.qpos[source] * abs(change.qpos.scale[q])
            elif model.jnt_type[group.joint] == mujoco.mjtJoint.mjJNT_FREE and group.dofs.start == int(
                model.jnt_dofadr[group.joint]
            ):
                sigma[group.dofs] *= abs(change.qpos.scale[int(model.jnt_qposadr[group.joint])])
        return sigma

    def _job(
        self, worlds: _Worlds, change: Change, recording: int, cuts: Sequence[_Cut], shift: float, scale: float
    ) -> tuple[tuple[World, Segments], np.ndarray]:
        """World and segments of the stretches of a recording, and measured positions (W, samples, nq) at their ends."""
        data = self._dataset.recordings[recording]
        world = worlds.of(data.model, change)
        model = world.model
        starts, speeds, acts = [], [], []
        for cut in cuts:
            near = change.qpos(data.qpos[cut.around])
            middle = change.qpos(data.qpos[cut.stretch.first])
            moves = difference(model, middle, near)
            since = data.time[cut.around] - data.time[cut.stretch.first]
            place, slope = _fitted(since, moves)
            starts.append(integrate(model, middle, place))
            speeds.append(slope)
            acts.append(_activation(model, change.ctrl(data.ctrl[cut.stretch.first]) * scale, middle))
        commands = tuple(self._command(recording, cut, change, shift, scale) for cut in cuts)
        at = np.array([cut.samples for cut in cuts])
        first = data.time[[cut.stretch.first for cut in cuts]]
        segments = Segments(
            first,
            np.array(starts),
            np.array(speeds),
            data.time[at] - first[:, None],
            commands,
            np.arange(len(cuts)),
            np.array(acts) if model.na else None,
        )
        return (world, segments), change.qpos(data.qpos[at])


def typical_error(errors: np.ndarray, groups: Sequence[int]) -> np.ndarray:
    """Geometric mean (W,) of the errors (W, G) of some groups.

    Its logarithm is, up to a factor, the log-likelihood of groups whose noise has unknown variances.
    """
    return np.exp(np.mean(np.log(errors[:, list(groups)]), axis=1))


def _cut(stretch: Stretch) -> _Cut:
    length = stretch.last - stretch.first
    side = max(3, int(_SLOPE_SHARE * length))
    offsets = np.unique(np.linspace(-side, side, 2 * min(side, _SLOPE_ROWS) + 1).round().astype(int))
    around = stretch.first + offsets
    samples = stretch.first + np.unique(np.linspace(length / _SAMPLES, length, _SAMPLES).round().astype(int))
    return _Cut(stretch, around[around >= 0], samples, slice(max(0, stretch.first - side), stretch.last + side + 1))


def _fitted(time: np.ndarray, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value and slope (nv,) at time 0 of a cubic fit to moves (N, nv)."""
    span = float(np.abs(time).max())
    powers = (time / span)[:, None] ** np.arange(min(4, len(time)))
    found = np.linalg.lstsq(powers, moves, rcond=None)[0]
    return found[0], found[1] / span


def _activation(model: mujoco.MjModel, ctrl: np.ndarray, qpos: np.ndarray) -> np.ndarray:
    """Activation states (na,) at the start of a stretch: filters follow their command, integrators their joint."""
    act = np.zeros(model.na)
    for actuator in range(model.nu if model.na else 0):
        first = int(model.actuator_actadr[actuator])
        if first < 0:
            continue
        last = first + int(model.actuator_actnum[actuator]) - 1
        joint = int(model.actuator_trnid[actuator, 0])
        integrator = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        if integrator and on_joint:
            act[last] = model.actuator_gear[actuator, 0] * qpos[int(model.jnt_qposadr[joint])]
        else:
            act[last] = ctrl[actuator]
    return act


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Name of a joint, as in columns."""
    return part_names(model, "joint")[joint]
