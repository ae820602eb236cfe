"""Columns of inertial measurement units, matched to the sensors of a model.

The kind decides, and where a model has several of a kind the words of their names.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import mujoco

from btr_mjx.gap.data.columns.model_columns import sensor_body
from btr_mjx.gap.data.columns.units import stated_unit
from btr_mjx.gap.data.columns.words import BASE, imu_words, words
from btr_mjx.gap.data.lists import listed
from btr_mjx.models import part_names

IMU_SENSORS: Mapping[int, str] = {
    int(mujoco.mjtSensor.mjSENS_GYRO): "gyro",
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER): "accelerometer",
    int(mujoco.mjtSensor.mjSENS_FRAMEQUAT): "framequat",
    int(mujoco.mjtSensor.mjSENS_MAGNETOMETER): "magnetometer",
}
"""Names of the sensors of an IMU in MJCF."""


@dataclass(frozen=True)
class ImuNames:
    """Words that name the sensors of IMUs in a model.

    Attributes:
      sensors: words of the sensor's name, and those of its body and its name, by name and by kind.
      base: name of the body of the only free joint; None without one.
    """

    sensors: Mapping[str, Mapping[str, tuple[tuple[str, ...], frozenset[str]]]]
    base: str | None

    @staticmethod
    def of(model: mujoco.MjModel) -> "ImuNames":
        """The words of a model's sensors."""
        bodies = part_names(model, "body")
        found: dict[str, dict[str, tuple[tuple[str, ...], frozenset[str]]]] = {}
        for sensor, name in enumerate(part_names(model, "sensor")):
            kind, body = IMU_SENSORS.get(int(model.sensor_type[sensor])), sensor_body(model, sensor)
            if kind is not None and body >= 0:
                named = frozenset(words(name)) | frozenset(words(bodies[body]))
                found.setdefault(kind, {})[name] = words(name), named
        free = [int(j) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
        return ImuNames(found, bodies[int(model.jnt_bodyid[free[0]])] if len(free) == 1 else None)

    def columns(self, said: tuple[str, ...], label: tuple[str, ...]) -> tuple[Sequence[str], int]:
        """Columns of the model that words may name, and how explicitly; several where no word decides.

        In a model with a free joint, an orientation is that of an IMU, and a turning that of a gyro, only where a word
        says so.
        """
        found = imu_words(said, label)
        if found is None or (self.base is not None and not found.explicit):
            return [], 0
        own = self.sensors.get(found.kind, {})
        if exact := [name for name, (named, _) in own.items() if named == said[:-1]]:
            return [f"sensor/{exact[0]}/{found.part}"], 3
        fits = [name for name, (_, named) in own.items() if found.others <= named]
        if len(fits) != 1:
            fits = [name for name, (_, named) in own.items() if found.others <= named | BASE]
        return [f"sensor/{name}/{found.part}" for name in fits], 1 if found.raw else 2

    def lacking(self, columns: Collection[str]) -> list[str]:
        """A note of columns of an IMU without a use, see `without_sensor`."""
        kinds: dict[str, list[str]] = {}
        for column in columns if self.base is not None else ():
            found = imu_words(words(stated_unit(column)[0]))
            if found is not None and found.explicit and not found.others - BASE:
                kinds.setdefault(found.kind, []).append(column)
        return self.without_sensor(kinds)

    def without_sensor(self, found: Mapping[str, Sequence[str]]) -> list[str]:
        """A note of names in a log, by kind, for which a floating robot's model has no sensor: the lines to add."""
        kinds = {kind: names for kind, names in found.items() if self.base is not None and kind not in self.sensors}
        if not kinds.keys() & {"gyro", "accelerometer"}:
            return []
        ends = {kind: 'objtype="site" objname="imu"' if kind == "framequat" else 'site="imu"' for kind in kinds}
        lines = "".join(f'<{kind} name="imu_{kind}" {end}/>' for kind, end in ends.items())
        names = dict.fromkeys(name for own in kinds.values() for name in own)
        return [
            f"measurements of an IMU without a sensor of the model have no use: {listed(names, 12)}; to have one, add "
            f'<site name="imu"/> to the body {self.base!r} of the MJCF, where and as the IMU is mounted, and '
            f"<sensor>{lines}</sensor>"
        ]
