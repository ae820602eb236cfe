"""Units of columns: how they are stated, with and without a number, and what they are worth."""

import mujoco
import numpy as np
import pytest
from robot_logs import ARM, FLOATER

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.units import ColumnUnit, conversion, stated_unit, unit_text

FLOATING = mujoco.MjModel.from_xml_string(FLOATER)
MOTORS = mujoco.MjModel.from_xml_string(
    ARM.replace('<position name="shoulder" joint="shoulder" kp="20" kv="0.5"/>', '<motor name="m1" joint="shoulder"/>')
)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("q_hip [deg]", ("q_hip", "deg")),
        ("q_hip (°)", ("q_hip", "deg")),
        ("hip_deg", ("hip", "deg")),
        ("time_ms", ("time", "ms")),
        ("time [s]", ("time", "s")),
        ("u[0]", ("u[0]", None)),
        ("wheel_m", ("wheel_m", None)),
        ("speed (rpm)", ("speed", "rpm")),
        ("hip_pos_turns", ("hip_pos", "turn")),
        ("knee/vel [rev/s]", ("knee/vel", "turn/s")),
        ("knee_vel_turns_s", ("knee_vel", "turn/s")),
    ],
)
def test_stated_units(name: str, expected: tuple[str, str | None]) -> None:
    assert stated_unit(name) == expected


@pytest.mark.parametrize(
    ("text", "quantity", "factor"),
    [
        ("turn", "angle", 2 * np.pi),
        ("rev/s", "turning", 2 * np.pi),
        ("turn/4096", "angle", 2 * np.pi / 4096),
        ("turn/s/8192", "turning", 2 * np.pi / 8192),
        ("0.00153 rad/tick", "angle", 0.00153),
        ("0.48 Nm/A", "force", 0.48),
        ("-rad", "angle", -1.0),
        ("-2 * mm", "length", -2e-3),
    ],
)
def test_units_with_numbers(text: str, quantity: str, factor: float) -> None:
    found = ColumnUnit.of(text)
    assert found is not None
    assert found.quantity == quantity
    assert found.factor == pytest.approx(factor)


@pytest.mark.parametrize("text", ["", "parsec", "4096", "-1", "0 rad", "rad/0", "1e400 rad", "/A", "rad/A/A"])
def test_what_is_no_unit(text: str) -> None:
    assert ColumnUnit.of(text) is None


def factor_of(column: str, text: str, model: mujoco.MjModel, where: str = "") -> float:
    unit = ColumnUnit.of(text)
    assert unit is not None
    return conversion(column, unit, model, where)


def test_conversions() -> None:
    assert factor_of("qpos/hip", "deg", FLOATING) == pytest.approx(np.pi / 180)
    assert factor_of("qvel/hip", "rpm", FLOATING) == pytest.approx(2 * np.pi / 60)
    assert factor_of("qvel/hip", "turn", FLOATING) == pytest.approx(2 * np.pi)  # a second
    assert factor_of("qpos/root/x", "mm", FLOATING) == pytest.approx(1e-3)
    assert factor_of("ctrl/hip", "deg", FLOATING) == pytest.approx(np.pi / 180)
    assert factor_of("ctrl/m1", "mnm", MOTORS) == pytest.approx(1e-3)
    assert factor_of("ctrl/m1", "0.48 Nm/A", MOTORS) == pytest.approx(0.48)
    assert factor_of("ctrl/m1", "deg", MOTORS) == 1.0
    with pytest.raises(InputError, match="is in mm, 'qpos/hip' needs"):
        factor_of("qpos/hip", "mm", FLOATING, "log.csv: column 'hip'")


@pytest.mark.parametrize(
    ("column", "model"),
    [
        ("qpos/hip", FLOATING),
        ("qvel/hip", FLOATING),
        ("ctrl/hip", FLOATING),
        ("ctrl/m1", MOTORS),
        ("qpos/root/x", FLOATING),
    ],
)
def test_units_that_are_written_are_read_again(column: str, model: mujoco.MjModel) -> None:
    sizes = [1.0, 1e-2, 1e-3, 0.48, np.pi / 180, 2 * np.pi / 60, *(2 * np.pi / k for k in (1, 2, 4096, 65536))]
    for factor in [sign * size for size in sizes for sign in (1.0, -1.0)]:
        text = unit_text(column, factor, model)
        assert factor_of(column, text, model) == pytest.approx(factor, rel=1e-3), text


def test_quaternions_have_no_unit() -> None:
    assert unit_text("qpos/root/qw", -1.0, FLOATING) == ""
