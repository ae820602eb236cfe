"""Checks of IMUs: units, signs and axes of gyros and accelerometers, against the orientation that was measured.

The rotation between predicted and measured vectors is that of the mount against the site of the model (Wahba's
problem). A wrong sign, or a mount that is turned further than calibrations leave it, has to fit significantly better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, listed, quoted
from btr_mjx.gap.preflight.comparison import compare
from btr_mjx.gap.preflight.findings import Finding, Level
from btr_mjx.gap.preflight.imu_vectors import ImuVectors, imu_vectors
from btr_mjx.gap.preflight.lerobot_tables import toml_lines
from btr_mjx.models import part_names

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_STRETCHES, _FEWEST = 400, 10
"""Most stretches that are looked at, and fewest that can decide."""
_FOLLOWS = 0.7
"""Correlation, after the best rotation, from which on a gyro follows the orientation."""
_OFF = 2.0
"""Factor between a unit and what was measured in it."""
_GONE = 0.07
"""Share of gravity in a mean below which it was taken out: in g it would be 0.1."""
_FULL_SCALE = float(np.deg2rad(2000))
"""Largest rate of usual gyros [rad/s]."""
_TURNED = np.deg2rad(10.0)
"""Rotation of a mount that is no error of a calibration: five standard deviations of 2 degrees."""
_TIE = 1e-3
"""Weight of the model's own axes beside measured vectors: it decides where these are all parallel."""
_GRAVITY, _DEGREES = 9.80665, 180 / np.pi
"""Units in which IMUs count [m/s^2], [1/rad]."""


@dataclass(frozen=True, eq=False)
class _Sensor:
    """Predicted and measured vectors (N, 3) of a sensor, in the same stretches as those of its site's other sensor."""

    name: str
    columns: Sequence[str]
    predicted: np.ndarray
    measured: np.ndarray

    def errors(self, turn: "Rotation", sign: float) -> np.ndarray:
        """(N,) squared distances after a rotation, relative to the size of the vectors."""
        left = sign * self.measured - turn.apply(self.predicted)
        return np.asarray(np.sum(left**2, axis=1) / np.mean(np.sum(self.predicted**2, axis=1)))


@dataclass(frozen=True, eq=False)
class _Reading:
    """Signs of the sensors, rotation of their mount, whether no calibration leaves it so far off, and errors (N,)."""

    signs: Sequence[float]
    turn: "Rotation"
    far: bool
    errors: np.ndarray


def imu_conventions(dataset: Dataset) -> list[Finding]:
    """Findings about gyros and accelerometers: errors where they stand in for a pose that was not measured."""
    model, names = dataset.model, part_names(dataset.model, "sensor")
    free = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    measured = all(recording.sensed[free].all() for recording in dataset.recordings)
    level: Level = "warning" if measured else "error"
    kinds = int(mujoco.mjtSensor.mjSENS_GYRO), int(mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    found: dict[int, dict[int, str]] = {}
    for name, kind, site in zip(names, model.sensor_type.tolist(), model.sensor_objid.tolist(), strict=True):
        if kind in kinds and all(recording.measured_by(name) is not None for recording in dataset.recordings):
            found.setdefault(site, {})[kind] = name
    findings: list[Finding] = []
    for site, own in found.items():
        gyro, accelerometer = (own.get(kind, "") for kind in kinds)
        findings += _of_site(dataset, site, gyro, accelerometer, level)
    return findings


def _of_site(dataset: Dataset, site: int, gyro: str, accelerometer: str, level: Level) -> list[Finding]:
    """Findings about the sensors of a site; "" for one that was not logged."""
    most = max(_FEWEST, _STRETCHES // len(dataset.recordings))
    every = [imu_vectors(recording, site, gyro, accelerometer, most) for recording in dataset.recordings]
    known = all(own.turned is not None for own in every)
    every = [own for own in every if len(own.felt)]
    if gyro and not known and (found := _too_fast(dataset, gyro, level)):
        return found
    if sum(len(own.felt) for own in every) < _FEWEST:
        return []
    findings, sensors = list[Finding](), list[_Sensor]()
    for name, judge in ((gyro, _gyro), (accelerometer, _accelerometer)):
        if name and (known or judge is _accelerometer):
            sensor, said = judge(dataset, name, every, level)
            findings += said
            sensors += [sensor] if sensor is not None else []
    return findings + (_axes(dataset, site, sensors, known, level) if sensors else [])


def _too_fast(dataset: Dataset, name: str, level: Level) -> list[Finding]:
    """An error of the unit of a gyro that no orientation judges."""
    measured = [own for r in dataset.recordings if (own := r.measured_by(name)) is not None]
    fastest = max(float(np.nanmax(np.abs(own), initial=0.0)) for own in measured)
    if fastest <= _FULL_SCALE:
        return []
    what = f"looks like deg/s, as it reaches {fastest:.3g}, and gyros measure up to {_FULL_SCALE:.3g} rad/s"
    return [replace(_unit(dataset, name, what, "deg/s", level), evidence={"fastest": fastest})]


def _gyro(
    dataset: Dataset, name: str, every: Sequence[ImuVectors], level: Level
) -> tuple[_Sensor | None, list[Finding]]:
    """A gyro in rad/s, None where nothing turns; and a finding of its unit. Its bias does not count."""
    predicted = np.concatenate([own.turned - own.turned.mean(0) for own in every if own.turned is not None])
    measured = np.concatenate([own.gyro - own.gyro.mean(0) for own in every])
    sensor = _Sensor(name, _columns(dataset, name), predicted, measured)
    # The sum of singular values is the largest that a rotation, or a reflection, gives the scalar product.
    most = float(np.linalg.svd(measured.T @ predicted, compute_uv=False).sum())
    if most <= _FOLLOWS * np.linalg.norm(predicted) * np.linalg.norm(measured):
        return None, []
    ratio = most / float(np.sum(predicted**2))
    if 1 / _OFF < ratio < _OFF:
        return sensor, []
    degrees = 1 / _OFF < ratio / _DEGREES < _OFF
    what = "is in deg/s, as it" if degrees else "is in another unit: it"
    finding = _unit(
        dataset, name, f"{what} is {ratio:.3g} times the slope of the orientation", "deg/s" if degrees else "", level
    )
    finding = replace(finding, evidence={"factor": ratio})
    return replace(sensor, measured=measured / (_DEGREES if degrees else ratio)), [finding]


def _accelerometer(
    dataset: Dataset, name: str, every: Sequence[ImuVectors], level: Level
) -> tuple[_Sensor | None, list[Finding]]:
    """An accelerometer in m/s^2, None without gravity in it; and a finding of its unit, or that gravity is missing."""
    predicted, measured = (np.concatenate(rows) for rows in ([o.felt for o in every], [o.accelerometer for o in every]))
    sensor = _Sensor(name, _columns(dataset, name), predicted, measured)
    means = [np.linalg.norm([own.felt.mean(0), own.accelerometer.mean(0)], axis=1) for own in every]
    weighed = [(felt, mean) for felt, mean in means if felt > _GRAVITY / 2]
    if len(weighed) < len(means):  # of a robot that falls or tumbles
        return None, []
    mean = float(np.median([mean for _, mean in weighed]))
    ratio = float(np.median([mean / felt for felt, mean in weighed]))
    known = all(own.turned is not None for own in every)
    if not known and mean < _FOLLOWS * (size := float(np.median(np.linalg.norm(measured, axis=1)))):
        if size > _GRAVITY / 2:  # the robot tumbled, and nothing says where down was
            return None, []
        ratio = 0.0
    if 1 / _OFF < ratio < _OFF:
        return sensor, []
    evidence, instead = {"mean": mean, "factor": ratio}, f"{mean:.3g} instead of {_GRAVITY:.3g} m/s^2"
    if ratio < _GONE:
        message = (
            f"{listed(sensor.columns)}: gravity was taken out of this acceleration, as its mean is {instead}; log what "
            "the accelerometer measures (9.81 upwards at rest), or leave it out"
        )
        return None, [Finding(level, "convention", message, evidence=evidence)]
    weights = ratio * _GRAVITY < _OFF
    what = "is in g" if weights else "is in another unit"
    finding = _unit(dataset, name, f"{what}, as its mean is {instead}", "g" if weights else "", level)
    scaled = replace(sensor, measured=measured * (_GRAVITY if weights else 1 / ratio))
    return scaled, [replace(finding, evidence=evidence)]


def _unit(dataset: Dataset, name: str, what: str, unit: str, level: Level) -> Finding:
    columns = _columns(dataset, name)
    lines = toml_lines(dataset, ["[units]", *(f'{quoted(c)} = "{unit}"' for c in columns)]) if unit else ()
    remedy = f"state {quoted(unit)} in [units] of dataset.toml" if unit else "convert it to rad/s or m/s^2"
    return Finding(level, "units", f"{listed(columns)}: {name} {what}; {remedy}", remedy, lines=lines)


def _axes(dataset: Dataset, site: int, sensors: Sequence[_Sensor], known: bool, level: Level) -> list[Finding]:
    """Findings of signs and of the mount; of signs only where the orientation is presumed, rather than `known`."""
    from scipy.spatial.transform import Rotation  # slow to load

    def read(signs: Sequence[float], turn: Rotation) -> _Reading:
        errors = np.sum([s.errors(turn, sign) for s, sign in zip(sensors, signs, strict=True)], axis=0)
        return _Reading(signs, turn, bool(turn.magnitude() > _TURNED), errors)

    as_it_is = [1.0] * len(sensors)
    tried = [
        read(signs, _mount(sensors, signs) if known else Rotation.identity())
        for signs in sorted(product((1.0, -1.0), repeat=len(sensors)), key=lambda one: one.count(-1.0))
    ]
    now = best = read(as_it_is, Rotation.identity()) if tried[0].far else tried[0]
    for one in sorted(tried, key=lambda one: one.far):  # what has fewer faults comes first
        best = one if compare(best.errors, one.errors).significant else best
    evidence = {
        "error_now": float(np.sqrt(np.median(now.errors))),
        "error_with_remedy": float(np.sqrt(np.median(best.errors))),
    }
    shown = f"error {evidence['error_with_remedy']:.2g} of the motion instead of {evidence['error_now']:.2g}"
    findings = []
    for sensor, sign in zip(sensors, best.signs, strict=True):
        if sign < 0:
            message = (
                f"{listed(sensor.columns)}: {sensor.name} has the opposite sign of what the orientation "
                f"{'tells' if known else 'of the model at its start tells: it points down'} ({shown}); negate these "
                f"columns{'' if known else ', or turn the site if the IMU is mounted upside down'}"
            )
            findings.append(Finding(level, "convention", message, "negate the columns", evidence))
    if best.far:
        angle = float(np.rad2deg(best.turn.magnitude()))
        own = Rotation.from_quat(dataset.model.site_quat[site], scalar_first=True) * best.turn.inv()
        quaternion = " ".join(f"{value:.4g}" for value in own.as_quat(canonical=True, scalar_first=True).round(4) + 0.0)
        name = part_names(dataset.model, "site")[site]
        message = (
            f"{listed(c for s in sensors for c in s.columns)}: the axes of the IMU are turned by {angle:.3g} degrees "
            f'against the site {name!r} ({shown}); write quat="{quaternion}" into that site of the MJCF'
        )
        remedy = f'quat="{quaternion}"'
        findings.append(Finding(level, "convention", message, remedy, evidence | {"degrees": angle}))
    return findings


def _mount(sensors: Sequence[_Sensor], signs: Sequence[float]) -> "Rotation":
    """The rotation from the site's axes to those of the sensors that fits best."""
    from scipy.spatial.transform import Rotation

    sizes = [float(np.sqrt(np.mean(np.sum(s.predicted**2, axis=1)))) for s in sensors]
    measured = [sign * s.measured / size for s, sign, size in zip(sensors, signs, sizes, strict=True)]
    predicted = [s.predicted / size for s, size in zip(sensors, sizes, strict=True)]
    count = sum(map(len, predicted))
    weights = np.concatenate([np.ones(count), np.full(3, _TIE * count)])
    axes = np.eye(3)
    return Rotation.align_vectors(np.concatenate([*measured, axes]), np.concatenate([*predicted, axes]), weights)[0]


def _columns(dataset: Dataset, sensor: str) -> list[str]:
    """Names of a sensor's columns in the log."""
    columns = [f"sensor/{sensor}/{part}" for part in "xyz"]
    return [dataset.sources.get(column, column) for column in columns]
