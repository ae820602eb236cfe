"""Recordings: measurement tables read with the believed model.

`columns.model_columns` defines the columns of a file; `loading` reads the dataset that holds the recordings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.model_columns import (
    check_names,
    control_columns,
    imu_columns,
    sensor_parts,
    state_columns,
    ungroup_columns,
)
from btr_mjx.gap.data.control import Interpolation
from btr_mjx.gap.data.lists import listed
from btr_mjx.gap.data.recordings.clocks import check_time, on_one_clock, usual_interval
from btr_mjx.gap.data.recordings.held import held
from btr_mjx.gap.data.recordings.plausible import check_sizes, check_span
from btr_mjx.gap.data.recordings.rows import complete_rows, even_times, normalise_quaternions, whole_parts
from btr_mjx.gap.data.recordings.unmeasured import estimate_motion, unmeasured_joints
from btr_mjx.gap.data.recordings.velocities import estimate_velocity
from btr_mjx.gap.data.recordings.wraps import unwrap_hinges
from btr_mjx.models import part_names

MIN_SAMPLES = 20
"""Smallest number of samples of a recording."""

Split = Literal["fit", "test"]
"""Side of a recording: to fit, or held out."""


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """How well states are known that were estimated; NaN where they were measured.

    Attributes:
      sigma: (2 nv,) standard deviation of positions and velocities within a short time; errors that stay left out.
      spread: (2 nv,) of all errors.
    """

    sigma: np.ndarray
    spread: np.ndarray


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording.

    Attributes:
      name: by default the file name without suffix.
      time: (K,) [s], increasing.
      ctrl: (K, nu) commands.
      qpos: (K, nq), qvel: (K, nv) measured states in MuJoCo's conventions.
      qvel_measured: (nv,) bool; False where the velocity was estimated from positions.
      qpos_measured: (nv,) bool; False at joints without an encoder and at a base of which only an IMU was logged, whose
        states are estimated; None for all measured.
      split: "fit" or "test" (held out).
      model: the believed model of this recording, with its overrides.
      force: (K,) measured actuator forces by actuator.
      sensor: (K,) other measurements by name, such as "imu_gyro/x"; NaN where there is none at that time.
      notes: corrections made by the loader, reported by preflight.
      sent: times (N,) [s] and commands (N, nu), where commands were logged at other times than states.
      held_commands: whether commands of a slower clock were held between their samples.
      estimate: how well states are known that were estimated and count as measured; None for none.
      interpolation: of the command between samples.
      log: name of the [[recording]] that it is all or a part of.
    """

    name: str
    time: np.ndarray
    ctrl: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    qvel_measured: np.ndarray
    split: Split
    model: mujoco.MjModel
    force: Mapping[str, np.ndarray] = field(default_factory=dict)
    sensor: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    sent: tuple[np.ndarray, np.ndarray] | None = None
    held_commands: bool = False
    qpos_measured: np.ndarray | None = None
    estimate: StateEstimate | None = None
    interpolation: Interpolation = "linear"
    log: str = ""

    @property
    def commands(self) -> tuple[np.ndarray, np.ndarray]:
        """Times (N,) [s] and commands (N, nu): all that are known."""
        return (self.time, self.ctrl) if self.sent is None else self.sent

    @property
    def seen(self) -> np.ndarray:
        """(nv,) bool: which positions were measured."""
        return np.ones(self.model.nv, bool) if self.qpos_measured is None else self.qpos_measured

    @property
    def sensed(self) -> np.ndarray:
        """(nv,) bool: coordinates that encoders or trackers measured; others were estimated, or not known at all."""
        return self.seen if self.estimate is None else self.seen & np.isnan(self.estimate.sigma[: self.model.nv])

    def reported(self, actuators: Sequence[int] | np.ndarray) -> np.ndarray:
        """(K, m) forces that the drives of some actuators report."""
        names = part_names(self.model, "actuator")
        rows = [self.force[names[a]] for a in actuators]
        return np.stack(rows, 1) if rows else np.zeros((len(self.time), 0))

    def measured_by(self, sensor: str) -> np.ndarray | None:
        """(K, dim) values of a sensor of the model, all of whose columns were logged; else None."""
        rows = [self.sensor.get(column.partition("/")[2]) for column in sensor_parts(self.model).get(sensor, [])]
        known = [row for row in rows if row is not None]
        return np.stack(known, 1) if known and len(known) == len(rows) else None

    def part(self, rows: slice | np.ndarray, split: Split, name: str) -> "Recording":
        """A part of the recording, as a recording with another name and split."""
        return replace(
            self,
            name=name,
            split=split,
            **{key: getattr(self, key)[rows] for key in ("time", "ctrl", "qpos", "qvel")},
            force={key: value[rows] for key, value in self.force.items()},
            sensor={key: value[rows] for key, value in self.sensor.items()},
        )


def base_unmeasured(recording: Recording) -> bool:
    """Whether the pose of a free joint was not logged, but an IMU on its body; its states are to be estimated."""
    model = recording.model
    return not recording.seen[model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]].all()


class EmptyRecording(InputError):
    """A recording, or a stretch of one, in which too few rows have all values."""


def make_recording(columns: Mapping[str, np.ndarray], model: mujoco.MjModel, where: str, name: str) -> Recording:
    """Build a recording without holes from the columns of a table; see `make_recordings`.

    Raises:
      InputError: see `make_recordings`; also holes.
    """
    found = make_recordings([columns], model, where, name)
    if len(found) > 1:
        raise InputError(f"{where}: {found[0].notes[-1]}; expected a recording without holes")
    return found[0]


def make_recordings(
    tables: Sequence[Mapping[str, np.ndarray]],
    model: mujoco.MjModel,
    where: str,
    name: str,
    hold: bool = True,
    shift: float = 0.0,
) -> list[Recording]:
    """Build the recordings of one log: one, or one for each part between holes.

    `tables` have arrays by name, as `readers.read_columns` returns them, and a clock of their own each. Commands of a
    slower clock are held between their samples, or interpolated without `hold`. `shift` [s] is added to the times of
    commands.

    Raises:
      InputError: missing or unknown columns, time that does not increase, quaternions that are not of unit length.
      EmptyRecording: no part has `MIN_SAMPLES` samples.
    """
    notes: list[str] = []
    flat_tables = [_with_even_times(ungroup_columns(table, model, where), model, notes) for table in tables]
    merged, held, shift = on_one_clock(flat_tables, model, hold, where, notes, shift)
    ignored = check_names(merged, model, where)
    unmeasured = unmeasured_joints(merged, model, where)
    notes += [f"columns without a use: {listed(ignored)}"] if ignored else []
    (positions, velocities), controls = state_columns(model), control_columns(model)
    positions = [c for c in positions if c in merged]
    needed = ["time", *positions, *controls, *(c for c in velocities if c in merged)]
    bases = [joint for joint in unmeasured if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE]
    needed += [column for joint in bases for column in imu_columns(merged, model, joint)]
    sound = complete_rows(merged, needed, where, notes)
    flat = {key: value[sound] for key, value in merged.items()}
    check_time(flat["time"], where)
    check_sizes(flat, needed, where)
    if len(sound) < MIN_SAMPLES:
        raise EmptyRecording(
            f"{where}: {len(sound)} samples are too short for a window; expected at least {MIN_SAMPLES}"
        )
    qpos = np.tile(model.qpos0, (len(sound), 1))
    known = ~np.isin(np.arange(model.njnt), unmeasured)
    qpos[:, np.repeat(known, np.diff([*model.jnt_qposadr, model.nq]))] = np.stack([flat[c] for c in positions], axis=1)
    normalise_quaternions(qpos, model, where)
    ctrl = np.stack([flat[c] for c in controls], axis=1) if controls else np.empty((len(sound), 0))
    unwrap_hinges(model, qpos, ctrl, notes)
    parts = whole_parts(sound, flat["time"], MIN_SAMPLES, notes)
    if not parts:
        raise EmptyRecording(f"{where}: {notes[-1]}; expected at least {MIN_SAMPLES} samples in a row with all values")
    measured = np.array([c in flat for c in velocities], bool)
    whole = Recording(
        name=name,
        time=flat["time"],
        ctrl=ctrl,
        qpos=qpos,
        qvel=np.stack([flat.get(c, np.zeros(len(sound))) for c in velocities], axis=1),
        qvel_measured=measured,
        split="fit",
        model=model,
        force={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("force/")},
        sensor={c.partition("/")[2]: v for c, v in flat.items() if c.startswith("sensor/")},
        notes=tuple(notes),
        held_commands=held,
        qpos_measured=known[model.dof_jntid],
        log=name,
    )
    names = [name if len(parts) == 1 else f"{name} (part {i + 1})" for i in range(len(parts))]
    pieces = [whole.part(rows, "fit", own) for rows, own in zip(parts, names, strict=True)]
    return [_estimated(_with_shifted_commands(one, shift, where), unmeasured, where) for one in pieces]


def _with_shifted_commands(one: Recording, shift: float, where: str) -> Recording:
    """A recording without a hole, whose commands were sent `shift` [s] later than logged; its rows with a command."""
    if shift == 0:
        return one
    times = one.time + shift
    known = np.flatnonzero((one.time >= times[0]) & (one.time <= times[-1] + usual_interval(one.time)))
    if len(known) < MIN_SAMPLES:
        raise EmptyRecording(
            f"{where}: {len(known)} samples have a command after a shift of {shift:g} s; expected at least "
            f"{MIN_SAMPLES}: correct shift in [control]"
        )
    ctrl = np.array([np.interp(one.time, times, column) for column in one.ctrl.T]).reshape(one.ctrl.shape[::-1]).T
    moved = replace(one, ctrl=ctrl, sent=(times, one.ctrl))
    return moved.part(slice(int(known[0]), int(known[-1]) + 1), one.split, one.name)


def _with_even_times(table: dict[str, np.ndarray], model: mujoco.MjModel, notes: list[str]) -> dict[str, np.ndarray]:
    """The table, with even times where its positions are smoother on these than on the time stamps."""
    own = [table[name] for name in state_columns(model)[0] if name in table]
    times = even_times(table["time"], np.stack(own, axis=1)) if own and "time" in table else None
    if times is None:
        return table
    notes.append(
        f"time stamps jitter by {1e3 * np.std(table['time'] - times):.1g} ms (rms): positions are smoother on an even "
        "clock, whose times are used"
    )
    return table | {"time": times}


def _estimated(one: Recording, unmeasured: list[int], where: str) -> Recording:
    """A recording without a hole, of its fresh rows, with estimates of what was not measured."""
    check_span(one.time, where)
    model, notes, fresh = one.model, list(one.notes), held(one.qpos)
    if fresh is not None and not fresh.coarse and len(fresh.rows) >= MIN_SAMPLES:
        rate = (len(fresh.rows) - 1) / (one.time[fresh.rows[-1]] - one.time[0])
        notes.append(
            f"positions change every {fresh.every:.3g}th row only ({rate:.4g} Hz) and repeat in between: the fresh "
            "rows are used, commands in all rows"
        )
        one = replace(one.part(fresh.rows, one.split, one.name), sent=one.commands)
    qvel = one.qvel
    if not one.qvel_measured.all():
        qvel = np.where(one.qvel_measured, qvel, estimate_velocity(model, one.time, one.qpos))
    joints = part_names(model, "joint")
    free = [j for j in unmeasured if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    hinges = [j for j in unmeasured if j not in free]
    hidden = sorted(joints[j] for j in hinges)
    if hidden:
        notes.append(f"joints without an encoder, whose states are estimated: {listed(hidden)}")
    names = sorted({joints[j] for j in model.dof_jntid[~one.qvel_measured] if j not in unmeasured})
    if names:
        notes.append(f"velocity estimated from positions: {listed(names)}")
    if hinges:
        estimate_motion(model, one.time, one.ctrl, one.qpos, qvel, hinges)
    return replace(one, qvel=qvel, notes=tuple(notes))
