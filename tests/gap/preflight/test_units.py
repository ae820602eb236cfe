"""Logs in other units than the model's are refused with the factor, and mended by the lines that are printed.

What is printed as an instruction, once followed, is neither repeated nor taken back.
"""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset, Recording, open_dataset
from btr_mjx.gap.preflight import Finding, preflight
from tests.support.convention_logs import ARM, CART, SPINNER, log, planted, sines
from tests.support.convention_logs import dataset as in_memory

MOTORS = ARM.replace(
    ARM[ARM.index("<actuator>") : ARM.index("</actuator>")],
    '<actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/>'
    '<motor name="wrist" joint="wrist"/>',
)
TURN = 2 * np.pi
Change = Callable[[dict[str, np.ndarray]], None]


def recorded(xml: str, size: list[float], edit: Callable[[mujoco.MjModel], None] = lambda model: None) -> Dataset:
    rng = np.random.default_rng(5)
    return in_memory(xml, [log(xml, sines(rng, size), i, seconds=4.0, edit=edit) for i in range(2)])


@pytest.fixture(scope="module")
def servos() -> Dataset:
    return recorded(ARM, [0.9, 0.8, 0.8])


@pytest.fixture(scope="module")
def motors() -> Dataset:
    return recorded(MOTORS, [3.0, 1.0, 0.2])


def in_files(folder: Path, data: Dataset, change: Change) -> Path:
    """The folder of a model and CSV files with names of the field, after a change of their columns."""
    model = data.model
    names = [model.joint(j).name for j in range(model.njnt)]
    drives = [model.actuator(a).name for a in range(model.nu)]
    header = ["time", *(f"q_{n}" for n in names), *(f"dq_{n}" for n in names), *(f"{n}_cmd" for n in drives)]
    folder.mkdir()
    (folder / "robot.xml").write_text(data.spec_xml)
    for recording in data.recordings:
        arrays = {name: getattr(recording, name).copy() for name in ("time", "ctrl", "qpos", "qvel")}
        change(arrays)
        rows = np.column_stack([arrays["time"], arrays["qpos"], arrays["qvel"], arrays["ctrl"]])
        np.savetxt(folder / f"{recording.name}.csv", rows, "%.9g", ",", header=",".join(header), comments="")
    return folder


def pasted(folder: Path, lines: Sequence[str]) -> None:
    """Write what is printed between the first line and the command."""
    start = 0 if (folder / "dataset.toml").is_file() else 1
    assert lines[0].startswith(("Add this to", "Write this to")[start])
    end = next(i for i, line in enumerate(lines) if line.startswith("then run"))
    text = "\n".join(line for line in lines[1:end] if not line.startswith("(")) + "\n"
    with (folder / "dataset.toml").open("a") as file:
        file.write(text)
    tomllib.loads((folder / "dataset.toml").read_text())


def checked(folder: Path) -> list[Finding]:
    """What is told but for notes; logs are simulated with finer steps than models have, which may show, too."""
    found = preflight(open_dataset(folder))
    return [f for f in found if f.topic != "time step" and (f.level != "note" or f.lines)]


def scaled(position: float, velocity: float, command: float = 1.0, whole: bool = False) -> Change:
    def change(arrays: dict[str, np.ndarray]) -> None:
        for name, factor in (("qpos", position), ("qvel", velocity), ("ctrl", command)):
            arrays[name] /= factor
        if whole:
            arrays["qpos"][:] = np.round(arrays["qpos"])

    return change


@pytest.mark.parametrize(
    ("robot", "change", "words", "stated"),
    [
        ("motors", scaled(TURN, TURN), "of all hinges look like turns (2 pi rad)", ("turn", "turn/s")),
        ("motors", scaled(TURN, 1.0), "look like turns (2 pi rad)", ("turn", "")),
        ("motors", scaled(np.pi, np.pi), "look like half turns (pi rad)", ("turn/2", "turn/s/2")),
        ("motors", scaled(np.pi / 180, np.pi / 180), "look like degrees", ("deg", "deg/s")),
        ("motors", scaled(TURN / 8192, TURN / 8192, whole=True), "8192 a turn", ("turn/8192", "turn/s/8192")),
        (
            "servos",
            scaled(TURN, TURN, TURN),
            "positions and commands of all hinges look like turns",
            ("turn", "turn/s"),
        ),
        ("servos", scaled(np.pi, np.pi, np.pi), "half turns (pi rad)", ("turn/2", "turn/s/2")),
        ("servos", scaled(TURN / 4096, 1.0, TURN / 4096, True), "4096 a turn", ("turn/4096", "")),
    ],
)
def test_units_of_angles_are_told_and_mended(
    robot: str,
    change: Change,
    words: str,
    stated: tuple[str, str],
    tmp_path: Path,
    servos: Dataset,
    motors: Dataset,
) -> None:
    data = {"servos": servos, "motors": motors}[robot]
    folder = in_files(tmp_path / "logs", data, change)
    (found,) = checked(folder)
    assert found.level == "error"
    assert words in found.message
    assert f'"q_elbow" = "{stated[0]}"' in found.lines
    assert (f'"dq_elbow" = "{stated[1]}"' in found.lines) == bool(stated[1])
    pasted(folder, found.lines)
    assert checked(folder) == []
    mended = open_dataset(folder).recordings[0]
    np.testing.assert_allclose(mended.qpos, data.recordings[0].qpos, atol=2e-3)


def negated(*columns: tuple[str, int]) -> Change:
    def change(arrays: dict[str, np.ndarray]) -> None:
        for name, column in columns:
            arrays[name][:, column] *= -1

    return change


def exchanged(a: int, b: int, *names: str) -> Change:
    def change(arrays: dict[str, np.ndarray]) -> None:
        for name in names:
            arrays[name][:, [a, b]] = arrays[name][:, [b, a]]

    return change


def several(*changes: Change) -> Change:
    def change(arrays: dict[str, np.ndarray]) -> None:
        for one in changes:
            one(arrays)

    return change


@pytest.mark.parametrize(
    "change",
    [
        negated(("qpos", 1), ("qvel", 1)),
        negated(("qpos", 1), ("qvel", 1), ("ctrl", 1)),
        negated(("ctrl", 0)),
        exchanged(0, 1, "qpos", "qvel"),
        exchanged(1, 2, "ctrl"),
        several(negated(("ctrl", 0)), exchanged(1, 2, "qpos", "qvel")),
    ],
    ids=["encoder", "axis", "command", "positions", "commands", "two"],
)
def test_an_instruction_once_followed_is_neither_repeated_nor_taken_back(
    change: Change, tmp_path: Path, motors: Dataset
) -> None:
    folder = in_files(tmp_path / "logs", motors, change)
    told = [finding for finding in checked(folder) if finding.lines]
    assert told
    pasted(folder, told[0].lines)
    assert checked(folder) == []


def weak(factor: float, *motors: int) -> Callable[[mujoco.MjModel], None]:
    def edit(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[list(motors), 0] *= factor

    return edit


def test_commands_in_amperes_are_a_warning_with_the_torque_constant(tmp_path: Path, motors: Dataset) -> None:
    folder = in_files(tmp_path / "logs", motors, scaled(1.0, 1.0, 0.48))
    (found,) = checked(folder)
    assert found.level == "warning"
    assert "a current" in found.message
    (line,) = [line for line in found.lines if line.startswith('"elbow_cmd"')]
    assert float(line.split('"')[3].removesuffix(" Nm/A")) == pytest.approx(0.48, rel=0.03)
    pasted(folder, found.lines)
    assert checked(folder) == []


def test_one_weak_motor_of_several_is_no_unit() -> None:
    found = preflight(recorded(MOTORS, [3.0, 1.0, 0.2], weak(0.5, 1)))
    assert [f.message for f in found if f.level != "note" and f.topic != "time step"] == []


@pytest.mark.parametrize("factor", [1.0, 1 / np.pi, 1 / TURN], ids=["sound", "weak", "weaker"])
def test_a_wheel_is_not_said_to_be_in_turns(factor: float) -> None:
    """Where there is no weight, a position in turns is the same as a force that is 2 pi times smaller."""
    wheel = SPINNER.replace('<velocity name="j7" joint="j7" kv="0.6"/>', '<motor name="j7" joint="j7"/>')
    found = preflight(recorded(wheel, [0.4], weak(factor, 0)))
    assert [f.message for f in found if f.level == "error"] == []
    assert any("torque constant" in f.message for f in found) == (factor < 1)


@pytest.mark.parametrize("weightless", [False, True])
def test_friction_that_the_robot_has_not_is_no_unit(weightless: bool) -> None:
    """Beside forces that are believed too large, a motion looks as if it were larger than it is."""
    dry = ARM.replace("damping=", 'frictionloss="0.4" damping=')
    dry = dry.replace("<option ", '<option gravity="0 0 0" ') if weightless else dry

    def smooth(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[:] = 0.0

    found = preflight(recorded(dry, [0.9, 0.8, 0.8], smooth))
    assert [f.message for f in found if f.level == "error"] == []


def test_slides_are_not_in_turns() -> None:
    rng = np.random.default_rng(2)
    cart = in_memory(CART, [log(CART, sines(rng, [5.0]), i, seconds=5.0, rate=100) for i in range(2)])

    def shrink(arrays: dict[str, np.ndarray]) -> None:
        arrays["qpos"][:, 0] /= TURN
        arrays["qvel"][:, 0] /= TURN

    assert not any("turns" in f.message for f in preflight(planted(cart, shrink)))


def test_a_unit_beyond_the_limits_of_a_joint_is_none(motors: Dataset, tmp_path: Path) -> None:
    """Nobody's log is in turns where that would turn a joint out of its limits."""
    narrow = MOTORS.replace('<joint name="', '<joint range="-0.01 0.01" limited="true" name="')
    limited = in_memory(narrow, [_of(r, narrow) for r in motors.recordings])
    folder = in_files(tmp_path / "logs", limited, scaled(TURN, TURN))
    assert not any("turns" in finding.message for finding in checked(folder))


def _of(recording: Recording, xml: str) -> Recording:
    from dataclasses import replace

    return replace(recording, model=mujoco.MjModel.from_xml_string(xml))
