"""How well the believed model predicts short stretches, under any change of the columns of positions and commands.

A stretch starts from the measured positions and their slope; measured velocities are not used. The model is simulated
with the recorded commands, and its positions are compared with the measured ones. An error is relative to the motion
of its coordinates, so that it does not depend on their unit.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.preflight.stretches import Stretch, choose_stretches, motion_seconds
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.models import difference, integrate

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
    def affine(
        cls, count: int, columns: Sequence[int] | np.ndarray = (), scale: float = 1.0, offset: float = 0.0
    ) -> "ColumnMap":
        """A change of some of `count` columns, which all stay in their places."""
        out, chosen = cls(np.arange(count), np.ones(count), np.zeros(count)), np.asarray(columns, int)
        out.scale[chosen], out.offset[chosen] = scale, offset
        return out

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
      frictionless: whether the model has no dry friction.
    """

    qpos: ColumnMap
    ctrl: ColumnMap
    gravity: tuple[float, float, float] | None = None
    switched_off: tuple[int, ...] = ()
    frictionless: bool = False

    @classmethod
    def none(cls, model: mujoco.MjModel) -> "Change":
        """No change."""
        return cls(ColumnMap.affine(model.nq), ColumnMap.affine(model.nu))

    def after(self, first: "Change") -> "Change":
        """This change of what `first` gives."""
        return Change(
            self.qpos.after(first.qpos),
            self.ctrl.after(first.ctrl),
            first.gravity if self.gravity is None else self.gravity,
            self.switched_off + first.switched_off,
            self.frictionless or first.frictionless,
        )


def _as_it_is(model: mujoco.MjModel) -> None:
    """No edit."""


@dataclass(frozen=True, eq=False)
class Reading:
    """How commands are read, and with what model they are followed.

    Attributes:
      shift: delay of all commands [s], a number or one for each recording.
      scale: factor of all commands.
      step_divisor: of the models' time steps.
      edit: of the models, in place.
    """

    shift: float | np.ndarray = 0.0
    scale: float = 1.0
    step_divisor: int = 1
    edit: Callable[[mujoco.MjModel], None] = _as_it_is


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
        self._stretches = choose_stretches(dataset, self.seconds, count, _SLOPE_SHARE)

    def __len__(self) -> int:
        return len(self._stretches)

    def few(self, count: int) -> "Predictor":
        """The same with at most `count` stretches."""
        out = copy.copy(self)
        if len(self) > count:
            chosen = np.linspace(0, len(self) - 1, count).round().astype(int)
            out._stretches = [self._stretches[i] for i in chosen]
        return out

    def start_times(self) -> tuple[np.ndarray, np.ndarray]:
        """Index of the recording (W,) of each stretch, and time of its start since the recording's [s]."""
        times = [self._dataset.recordings[s.recording].time for s in self._stretches]
        since = [time[s.first] - time[0] for time, s in zip(times, self._stretches, strict=True)]
        return np.array([s.recording for s in self._stretches], int), np.array(since)

    def errors(self, changes: Sequence[Change], reading: Reading = Reading()) -> np.ndarray:
        """Relative error variances (changes, W, groups), between the noise and `WORST`; see `motions`."""
        pairs = zip(changes, self.motions(changes, reading), strict=True)
        return np.array([self._relative(change, *pair) for change, pair in pairs])

    def motions(
        self,
        changes: Sequence[Change],
        reading: Reading = Reading(),
    ) -> list[np.ndarray]:
        """Simulate all stretches under each change.

        Args:
          changes: of the data or the model.
          reading: how commands are read and models simulated.

        Returns:
          For each change (2, W, samples, nv): measured and simulated motion since the start of each stretch.
        """
        jobs, ends = list[tuple[World, Segments]](), list[np.ndarray]()
        worlds: dict[tuple, World] = {}
        for change in changes:
            for number in sorted({s.recording for s in self._stretches}):
                recording = self._dataset.recordings[number]
                # A model with meshes takes many megabytes, and most changes leave it alone.
                key = id(recording.model), change.gravity, change.switched_off, change.frictionless
                if key not in worlds:
                    worlds[key] = _changed(recording.model, change)
                    worlds[key].model.opt.timestep /= reading.step_divisor
                    reading.edit(worlds[key].model)
                world = worlds[key]
                own = [s for s in self._stretches if s.recording == number]
                shift = float(np.broadcast_to(reading.shift, len(self._dataset.recordings))[number])
                segments, end = self._segments(world, change, recording, own, shift, reading.scale)
                jobs.append((world, segments))
                ends.append(end)
        moved = []
        for (world, segments), end, states in zip(jobs, ends, simulate(jobs), strict=True):
            with np.errstate(invalid="ignore"):
                both = np.stack([end, states[..., : world.model.nq]])
                moved.append(difference(world.model, segments.qpos[:, None], both))
        each = len(jobs) // max(len(changes), 1)
        return [np.concatenate(moved[i * each : (i + 1) * each], axis=1) for i in range(len(changes))]

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

    def _dof_noise(self, change: Change) -> np.ndarray:
        """Standard deviations (nv,) of the changed positions."""
        model, sigma = self._dataset.model, self._noise.qpos.copy()
        owner = dict(zip(model.jnt_qposadr.tolist(), model.jnt_dofadr.tolist(), strict=True))
        for group in self.groups:
            q, v = int(model.jnt_qposadr[group.joint]), int(model.jnt_dofadr[group.joint])
            if group.dofs.start == v:  # others are rotations of free joints, which have no unit
                source = owner.get(int(change.qpos.source[q]), v)
                width = group.dofs.stop - group.dofs.start
                sigma[group.dofs] = self._noise.qpos[source : source + width] * abs(change.qpos.scale[q])
        return sigma

    def _segments(
        self, world: World, change: Change, data: Recording, own: Sequence[Stretch], shift: float, scale: float
    ) -> tuple[Segments, np.ndarray]:
        """Segments of the stretches of a recording, and measured positions (W, samples, nq) at their ends."""
        model, starts, speeds, acts = world.model, [], [], []
        times, values = data.commands
        commands, samples = list[Command](), []
        for stretch in own:
            first, length = stretch.first, stretch.last - stretch.first
            side = max(3, int(_SLOPE_SHARE * length))
            around = first + np.unique(np.linspace(-side, side, 2 * min(side, _SLOPE_ROWS) + 1).round().astype(int))
            middle = change.qpos(data.qpos[first])
            moves = difference(model, middle, change.qpos(data.qpos[around]))
            place, slope = _fitted(data.time[around] - data.time[first], moves)
            starts.append(integrate(model, middle, place))
            speeds.append(slope)
            acts.append(_activation(model, change.ctrl(data.ctrl[first]) * scale, middle))
            low, high = np.searchsorted(times, data.time[[first - side, stretch.last + side]])
            rows = slice(max(0, int(low) - 1), int(high) + 2)
            sent = change.ctrl(values[rows]) * scale
            commands.append(Command(times[rows] + shift, sent, data.interpolation))
            samples.append(first + np.unique(np.linspace(length / _SAMPLES, length, _SAMPLES).round().astype(int)))
        start = data.time[[stretch.first for stretch in own]]
        segments = Segments(
            start,
            np.array(starts),
            np.array(speeds),
            data.time[samples] - start[:, None],
            tuple(commands),
            np.arange(len(own)),
            np.array(acts) if model.na else None,
        )
        return segments, change.qpos(data.qpos[samples])


def _changed(model: mujoco.MjModel, change: Change) -> World:
    """The world of a recording's model under a change."""
    world = World.of(model)
    if change.gravity is not None:
        world.model.opt.gravity[:] = change.gravity
    switched_off = list(change.switched_off)
    if change.frictionless:
        world.model.dof_frictionloss[:] = 0.0
    world.model.actuator_gainprm[switched_off], world.model.actuator_biasprm[switched_off] = 0.0, 0.0
    return world


def typical_error(errors: np.ndarray, groups: Sequence[int]) -> np.ndarray:
    """Geometric mean (W,) of the errors (W, G) of some groups.

    Its logarithm is, up to a factor, the log-likelihood of groups whose noise has unknown variances.
    """
    return np.exp(np.mean(np.log(errors[:, list(groups)]), axis=1))


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
