"""Recordings of a servo with a pendulum load, in the JSON format of Rhoban's BAM, together with a `servo.toml`.

The servo is voltage-controlled: duty = clip(kp g (goal - q), -max_duty, max_duty),
torque = kt / R (duty vin - kt dq/dt). The equivalent MuJoCo model is exact:

    position actuator   gain kp g kt vin / R, force range +- max_duty kt vin / R
    joint damping       kt^2 / R + viscous friction
    armature            rotor inertia at the output shaft
    friction            0 nominally; solver parameters are stiff, so that added friction holds a static load

vin is the nominal supply voltage: `input_volts` is sampled within the PWM period and scatters by volts. Mass, length,
kp and vin are given per recording, so each recording has its own model; the parameters to refit are common to all.
Zero angle: the arm hangs straight down.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data.dataset import Dataset
from btr_mjx.gap.data.recordings.recording import Recording, Split, make_recordings
from btr_mjx.gap.data.recordings.splits import assign_splits
from btr_mjx.models import COMPILE_ERRORS, PathParameter, check_model
from btr_mjx.runs import check_keys, is_number, parse_json, read_limited, read_toml, toml_section

SERVO_FILE = "servo.toml"
_TIMESTEP = 0.002
"""Time step of the model [s]; its discretisation error is corrected by `windows.time_steps`."""
_HOLD = 'solreffriction="0.004 1" solimpfriction="0.9999 0.9999 0.001"'
"""Solver parameters of joint friction. With MuJoCo's defaults a sticking joint creeps under load, at a speed of about
1e-3 s times the acceleration that friction compensates; a geared servo does not."""
SETTINGS = ("mass", "length", "kp", "vin")
"""Settings that each recording file states."""
LARGEST_VALUE = 1e6
"""Largest value of a servo or a setting, in SI units."""
COLUMNS = {"timestamp": "time", "goal_position": "ctrl/servo", "position": "qpos/servo", "speed": "qvel/servo"}
"""Column name by entry of the JSON file."""
SENSORS = {entry: f"sensor/{entry}" for entry in ("input_volts", "load", "temp")}
"""Columns of other entries, read where every sample has them."""
PARAMETERS = (
    PathParameter(
        "motor strength (torque per volt)",
        ("actuator:servo/kp", "actuator:servo/forcerange[0]", "actuator:servo/forcerange[1]"),
        0.5,
        2.0,
        relative=True,
    ),
    PathParameter("back-EMF and viscous friction", ("joint:servo/damping",), 0.25, 4.0, relative=True),
    PathParameter("rotor inertia", ("joint:servo/armature",), 0.25, 4.0, relative=True),
)
"""Parameters that may be refitted: factors on the nominal values."""


@dataclass(frozen=True)
class Servo:
    """Nominal parameters of a servo at the output shaft, SI units.

    Attributes:
      kt: torque constant [N m/A], equal to the back-EMF constant [V s/rad].
      resistance: of the winding [ohm].
      error_gain: duty per rad of error and per unit of the firmware gain kp.
      max_duty: largest duty cycle.
      armature: rotor inertia [kg m^2].
      viscous_friction: [N m s/rad].
      arm_mass: mass of the uniform rod between axis and load [kg].
      gravity: [m/s^2].
    """

    kt: float
    resistance: float
    error_gain: float
    max_duty: float = 1.0
    armature: float = 0.0
    viscous_friction: float = 0.0
    arm_mass: float = 0.0
    gravity: float = 9.81


def servo_xml(servo: Servo, mass: float, length: float, kp: float, vin: float) -> str:
    """MJCF of the believed servo with a mass at the end of its arm.

    Args:
      servo: nominal values.
      mass: load [kg].
      length: distance from the axis to the load [m].
      kp: firmware gain.
      vin: supply voltage [V].
    """
    volts_to_torque = servo.kt / servo.resistance * vin
    gain, limit = kp * servo.error_gain * volts_to_torque, servo.max_duty * volts_to_torque
    damping = servo.kt**2 / servo.resistance + servo.viscous_friction
    rod = servo.arm_mass * length**2 / 12
    arm = (
        f'<inertial pos="0 0 {-length / 2!r}" mass="{servo.arm_mass!r}" diaginertia="{rod!r} {rod!r} {1e-3 * rod!r}"/>'
        if servo.arm_mass > 0
        else ""
    )
    point = 1e-6 * mass * length**2
    return f"""<mujoco model="servo_pendulum">
  <compiler angle="radian"/>
  <option timestep="{_TIMESTEP!r}" integrator="implicitfast" gravity="0 0 {-servo.gravity!r}"/>
  <worldbody>
    <body name="arm">
      {arm}
      <joint name="servo" type="hinge" axis="0 -1 0" damping="{damping!r}" armature="{servo.armature!r}" {_HOLD}/>
      <geom name="arm" type="capsule" fromto="0 0 0 0 0 {-length!r}" size="0.005" mass="0" contype="0" conaffinity="0"/>
      <body name="load" pos="0 0 {-length!r}">
        <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{point!r} {point!r} {point!r}"/>
        <geom name="load" type="sphere" size="0.02" mass="0" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="servo" kp="{gain!r}" forcerange="{-limit!r} {limit!r}"/>
  </actuator>
</mujoco>
"""


def load_servo(folder: str | Path) -> Dataset:
    """Read a folder of servo recordings and its servo.toml.

    About a third of each group of equal mass, length, kp and vin is held out, at alternating positions in the group.

    Raises:
      InputError: no recordings, a missing or invalid value, or an error of `recording.make_recordings`.
      DamagedFile: a file that does not parse.
    """
    folder = Path(folder)
    notes: list[str] = []
    servo = read_servo(folder / SERVO_FILE, notes)
    files = sorted(folder.glob("*.json"))
    if not files:
        raise InputError(f"{folder}: there is no .json recording beside {SERVO_FILE}")
    recordings, settings = [], []
    for file in files:
        entries, setting = _read_json(file)
        where = f"{file}: the servo that follows from its values"
        try:
            model = mujoco.MjModel.from_xml_string(servo_xml(servo, *setting))
        except COMPILE_ERRORS as error:
            raise InputError(f"{where}: MuJoCo does not accept it: {error}") from None
        check_model(model, where)
        parts = make_recordings([entries], model, str(file), file.stem)
        recordings += parts
        settings += [setting] * len(parts)
    refitted = [
        believed  # a factor on a nominal value of 0 changes nothing
        for believed in PARAMETERS
        if all(replace(believed, relative=False).value(recording.model) != 0 for recording in recordings)
    ]
    return Dataset(
        folder=folder,
        model=recordings[0].model,
        model_file=folder / SERVO_FILE,
        spec_xml=servo_xml(servo, *settings[0]),
        parameters=tuple(refitted),
        recordings=tuple(_held_out(recordings, settings, folder)),
        notes=tuple(notes),
    )


def read_servo(path: Path, notes: list[str]) -> Servo:
    """Read the nominal values from the table [servo] of servo.toml."""
    table = toml_section(read_toml(path), "servo", path)
    names, needed = [f.name for f in fields(Servo)], ("kt", "resistance", "error_gain")
    check_keys({k: v for k, v in table.items() if k != "motor"}, names, f"{path}: [servo]", notes)
    for name in needed:
        if name not in table:
            raise InputError(f"{path}: [servo] has no {name}; add it in SI units")
    values = {name: table[name] for name in names if name in table}
    for name, value in values.items():
        smallest = 1 / LARGEST_VALUE if name in (*needed, "max_duty") else 0
        if not is_number(value) or not smallest <= value <= LARGEST_VALUE:
            raise InputError(
                f"{path}: [servo] {name} = {value!r}: expected a positive number in SI units, at most {LARGEST_VALUE:g}"
            )
    return Servo(**{name: float(value) for name, value in values.items()})


def _read_json(file: Path) -> tuple[dict[str, np.ndarray], tuple[float, ...]]:
    """Columns of a recording, and its settings in the order of `SETTINGS`."""
    content = parse_json(read_limited(file), str(file))
    if not isinstance(content, Mapping) or not isinstance(content.get("entries"), list) or not content["entries"]:
        raise InputError(f'{file}: expected an object with a list "entries" of samples')
    for sample in content["entries"]:
        if not isinstance(sample, Mapping):
            raise InputError(f"{file}: an entry is {sample!r}; expected an object with {', '.join(COLUMNS)}")
    for name in SETTINGS:
        if not is_number(content.get(name)) or not 0 < content[name] <= LARGEST_VALUE:
            raise InputError(
                f"{file}: {name} = {content.get(name)!r}: expected a positive number, at most {LARGEST_VALUE:g}"
            )
    columns = {}
    for entry, column in (COLUMNS | SENSORS).items():
        values = [sample.get(entry) for sample in content["entries"]]
        if not any(map(is_number, values)):
            if entry in COLUMNS and entry != "speed":
                raise InputError(f"{file}: no entry has {entry!r}; an entry needs {', '.join(COLUMNS)}")
        elif entry in COLUMNS or all(map(is_number, values)):
            columns[column] = np.array([value if is_number(value) else np.nan for value in values], float)
    off = [sample.get("torque_enable") is False for sample in content["entries"]]
    if any(off):
        raise InputError(f"{file}: the motor was off in sample {off.index(True) + 1}; cut the recording before")
    return columns, tuple(float(content[name]) for name in SETTINGS)


def _held_out(
    recordings: Sequence[Recording], settings: Sequence[tuple[float, ...]], folder: Path
) -> Sequence[Recording]:
    places, numbers = Counter[tuple[float, ...]](), {setting: k for k, setting in enumerate(sorted(set(settings)))}
    words: list[Split] = []
    for setting in settings:
        words.append("test" if (places[setting] + numbers[setting]) % 3 == 2 else "fit")
        places[setting] += 1
    return assign_splits(recordings, words if len(set(words)) > 1 else [None] * len(words), str(folder))
