"""Datasets: a folder with `dataset.toml`, the MJCF of the believed model, and recordings.

    [model]
    file = "robot.xml"                  # MJCF of the believed model
    unmeasured = ["passive_knee"]       # optional: joints without an encoder

    [[parameter]]                       # parameters that may be refitted (any number, or none)
    name = "knee damping"
    path = "joint:knee/damping"         # see `btr_mjx.models.parse_path`; a list of paths is set together
    bounds = [0.0, 2.0]                 # SI units, angles in rad
    relative = false                    # true: the value is a factor on the number in each recording's model

    [[recording]]
    file = "walk_1.csv"                 # or another format of `files`; a list of files of one time
    split = "fit"                       # or "test" (held out); default: the last third is held out
    model = "heavy.xml"                 # optional: its own model, with the same joints and actuators
    overrides = {"body:arm/mass" = 0.5} # optional: numbers that differ in this recording

    [control]
    interpolation = "linear"            # of the command between samples: "hold", "linear" or "cubic", or a table of
                                        # these by recording, { walk_1 = "hold" }; by default "hold" for stairs, "cubic"
                                        # for smooth commands, else "linear"; or "hold" where that predicts better
    shift = -0.12                       # optional: seconds that are added to the times of the commands, where their
                                        # clock differs; or a table of these by recording
    measured = "force"                  # optional: measured forces force/<actuator> drive the model, and the robot's
                                        # controllers may be unknown; by default where a log has no commands

    [tolerances]                        # optional: 1 sigma of residual calibration errors, by effect
    viscous_damping = 0.1

    [columns]                           # optional: names of the log = names of the model, see `columns`
    "Hip angle" = "qpos/hip"

    [units]                             # optional: units of columns whose names state none, see `columns.units`
    "Hip angle" = "deg"
    "Knee encoder" = "turn/4096"        # ticks
    "Knee current" = "0.48 Nm/A"        # a torque constant

    [topics]                            # optional: of ROS recordings, see `files.ros_bag`
    joint_states = "/joint_states"

    [noise]                             # optional: 1 sigma of the sensors; default: estimated
    qpos = 0.001                        # hinges [rad] and slides [m]
    qvel = 0.05                         # [rad/s], [m/s]
    position = 0.001                    # free joints [m]
    rotation = 0.002                    # free and ball joints [rad]
    velocity = 0.02                     # free joints [m/s]
    angular_velocity = 0.03             # free and ball joints [rad/s]
    "qpos/knee" = 0.002                 # of one joint; also "qvel/knee", and any single column

An IMU is logged in columns of the model's sensors, `sensor/<gyro>/x`, see `columns`; a base with one needs no columns
of its pose: `recording.base_unmeasured`.

Velocities that were not measured are estimated by local cubic fits and marked in `Recording.qvel_measured`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.control import Control, read_control
from btr_mjx.gap.data.inferred import control_lines, inferred_toml
from btr_mjx.gap.data.lerobot.scales import JointScale
from btr_mjx.gap.data.measured_forces import driven_by_forces
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.data.recordings.noise import Noise, estimate_noise, read_noise, without_sensor
from btr_mjx.gap.data.recordings.recording import Recording
from btr_mjx.models import PathParameter, part_names, read_path_parameter
from btr_mjx.runs import check_keys, file_inside, is_number, read_toml, toml_rows, toml_section

DATASET_FILE = "dataset.toml"
"""Name of the file that describes a dataset folder."""
TABLES = ("model", "parameter", "recording", "control", "tolerances", "noise", "columns", "units", "topics")
"""Tables that dataset.toml may hold."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings of one robot and its believed model.

    Attributes:
      folder: its folder.
      model: the believed model.
      model_file: MJCF file of the model.
      spec_xml: MJCF text of the model.
      parameters: parameters that may be refitted.
      recordings: all recordings, in the order of the file.
      control: what dataset.toml says about commands.
      tolerances: 1 sigma of residual calibration errors, by effect name.
      noise: sensor noise as given; None if it must be estimated.
      notes: warnings of the loader, reported by preflight.
      described: model and recordings as a dataset.toml has them, where these were given instead of one; else "".
      sources: names of columns in the logs, by name of the model; empty where they have the model's names.
      factors: from columns of the log to those of the model, by name of the model; 1 where absent.
      scales: how numbers of a LeRobot dataset became positions, by joint; empty for other formats.
      coarse_step: time step of the model as written [s], where `model` and the recordings' have a finer one; else None.
      forces: whether measured forces of the actuators drive the model, instead of commands; `model` has motors then.
    """

    folder: Path
    model: mujoco.MjModel
    model_file: Path
    spec_xml: str
    parameters: tuple[PathParameter, ...]
    recordings: tuple[Recording, ...]
    control: Control = field(default_factory=Control)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    noise: Noise | None = None
    notes: tuple[str, ...] = ()
    described: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    scales: Mapping[str, JointScale] = field(default_factory=dict)
    forces: bool = False
    coarse_step: float | None = None

    @property
    def inferred(self) -> str:
        """The dataset.toml that says what was inferred from the logs; "" where there is one."""
        if not self.described:
            return ""
        told = [*self.notes, *(line for one in self.recordings for line in one.notes)]
        control = control_lines(self.recordings, self.control.shift, self.forces)
        scales = [scale.lines() for scale in self.scales.values()]
        return inferred_toml(self.described, self.folder, told, control, scales)

    @property
    def fit(self) -> tuple[Recording, ...]:
        """Recordings with split "fit"."""
        return tuple(r for r in self.recordings if r.split == "fit")

    @property
    def test(self) -> tuple[Recording, ...]:
        """Recordings with split "test" (held out)."""
        return tuple(r for r in self.recordings if r.split == "test")

    @property
    def reporting(self) -> list[int]:
        """Indices of the actuators whose drives report their forces in all recordings, beside commands."""
        names = part_names(self.model, "actuator") if not self.forces else []
        return [i for i, name in enumerate(names) if all(name in r.force for r in self.recordings)]


def read_header(folder: str | Path, more: Sequence[str] = ()) -> tuple[Dataset, dict[str, Any]]:
    """Read everything in dataset.toml except the recordings.

    Args:
      folder: the folder, or its dataset.toml.
      more: names of further tables that it may hold.

    Returns:
      A dataset without recordings, and the file's tables.

    Raises:
      InputError, DamagedFile, OSError: see `load`.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == DATASET_FILE and folder.is_file() else folder
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give a folder that holds {DATASET_FILE}")
    path = folder / DATASET_FILE
    if not path.is_file():
        raise InputError(f"{folder}: it holds no {DATASET_FILE}; see docs/gap.md")
    table = read_toml(path)
    return header_of(table, folder, path, more), table


def header_of(table: Mapping[str, Any], folder: Path, path: Path, more: Sequence[str]) -> Dataset:
    """The dataset without recordings that a dataset.toml describes; `more` names further tables that it may hold."""
    notes: list[str] = []
    check_keys(table, (*TABLES, *more), f"{path}", notes)
    about = toml_section(table, "model", path)
    check_keys(about, ("file", "unmeasured"), f"{path}: [model]", notes)
    model_file = file_inside(about, "file", folder, f"{path}: [model]")
    model, spec_xml = load_model(model_file, folder)
    control = read_control(table, path, notes)
    if control.measured == "force":
        model = driven_by_forces(model)
    return Dataset(
        folder=folder,
        model=model,
        model_file=model_file,
        spec_xml=spec_xml,
        parameters=tuple(
            read_path_parameter(row, model, f"{path}: [[parameter]] {i + 1}", notes)
            for i, row in enumerate(toml_rows(table, "parameter", path))
        ),
        recordings=(),
        control=control,
        forces=control.measured == "force",
        tolerances=_tolerances(table.get("tolerances", {}), path),
        noise=read_noise(table.get("noise", {}), model, f"{path}: [noise]", notes),
        notes=tuple(notes),
    )


def noise_of(dataset: Dataset) -> Noise:
    """The sensor noise: as given in the dataset, else estimated from all recordings; of estimated states, theirs."""
    seen = np.all([r.seen for r in dataset.recordings], axis=0)
    noise = dataset.noise
    if noise is None:
        tracks = [(r.time, r.qpos, r.qvel, r.qvel_measured) for r in dataset.recordings]
        noise = estimate_noise(dataset.model, tracks)
    sigma = known_of(dataset.recordings, "sigma").reshape(2, -1)
    known = np.isnan(sigma)
    noise = Noise(np.where(known[0], noise.qpos, sigma[0]), np.where(known[1], noise.qvel, sigma[1]))
    return without_sensor(noise, seen)


def known_of(recordings: Sequence[Recording], what: Literal["sigma", "spread"]) -> np.ndarray:
    """(2 nv,) how well states are known that were estimated, the mean over recordings; NaN for measured ones."""
    rows = [getattr(r.estimate, what) ** 2 for r in recordings if r.estimate is not None]
    return np.sqrt(np.mean(rows, axis=0)) if rows else np.full(2 * recordings[0].model.nv, np.nan)


def _tolerances(table: Any, path: Path) -> dict[str, float]:
    if not isinstance(table, Mapping):
        raise InputError(f"{path}: [tolerances]: expected a table, got {table!r}")
    for key, value in table.items():
        if not is_number(value) or value < 0:
            raise InputError(f"{path}: [tolerances] {key} = {value!r}: expected a standard deviation of 0 or more")
    return {key: float(value) for key, value in table.items()}
