"""Names of columns matched to a model: what they mean, what is asked for, and units."""

import mujoco
import numpy as np
import pytest
from robot_logs import ARM, FLOATER

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.matching import match_columns
from btr_mjx.gap.data.columns.required import check_matched, may_be
from btr_mjx.gap.data.columns.units import TIME_UNITS, time_unit, to_seconds

MODEL, FLOATING = mujoco.MjModel.from_xml_string(ARM), mujoco.MjModel.from_xml_string(FLOATER)
DRIVES = (
    '<position name="shoulder" joint="shoulder" kp="20" kv="0.5"/>',
    '<position name="elbow" joint="elbow" kp="10" kv="0.3"/>',
)
MOTORS = mujoco.MjModel.from_xml_string(
    ARM.replace(DRIVES[0], '<motor name="m1" joint="shoulder"/>').replace(DRIVES[1], '<motor name="m2" joint="elbow"/>')
)


def names_of(columns: list[str], model: mujoco.MjModel = MODEL) -> dict[str, str]:
    return {
        column: target for (_, column), target in match_columns([("log", columns)], model, {}, "log.csv").names.items()
    }


@pytest.mark.parametrize(
    ("columns", "target"),
    [
        ("q_shoulder|Shoulder|pos_shoulder|shoulder.position|joint_states/shoulder/position|shoulderPos|shoulder [deg]"
         "|/joint_states/position/shoulder|measured_shoulder_pos|observation.state.shoulder.pos|SHOULDER_joint_pos_deg"
         "|feedback/positions/shoulder",
         "qpos/shoulder"),
        ("dq_shoulder|qd_shoulder|shoulder_vel|joint_velocities/shoulder|shoulder_speed [rpm]|shoulder/qdot",
         "qvel/shoulder"),
        ("shoulder_cmd|cmd/shoulder|des_pos_shoulder|shoulder_ref|u_shoulder|action.shoulder.pos|target_q_shoulder"
         "|qdes_shoulder",
         "ctrl/shoulder"),
        ("tau_shoulder|shoulder_torque|joint_states/effort/shoulder", "force/shoulder"),
        ("shoulder_temperature|shoulder_error|shoulder_acceleration|des_vel_shoulder|shoulderx|battery", None),
    ],
)  # fmt: skip
def test_names_of_the_field(columns: str, target: str | None) -> None:
    for column in columns.split("|"):
        found = names_of(["time", column, "elbow"])
        assert found.get(column) == target, column
        assert found["elbow"] == "qpos/elbow"


@pytest.mark.parametrize(
    ("columns", "target"),
    [
        ("base_x|odom/pose/pose/position/x|pose.position.x|trunk_pos_x|root x|x|base_px", "qpos/root/x"),
        ("base_qw|pose.orientation.w|trunk_quat_w|qw|/odom/pose/pose/orientation/w", "qpos/root/qw"),
        ("base_qx|orientation_x|qx", "qpos/root/qx"),
    ],
)
def test_names_of_a_free_joint(columns: str, target: str) -> None:
    for column in columns.split("|"):
        assert names_of(["time", column, "hip"], FLOATING).get(column) == target, column


def test_velocities_of_a_free_joint_are_all_or_none() -> None:
    spin = ["gyro_x", "angular_velocity.y", "base_wz"]
    move = ["twist.linear.x", "lin_vel_y", "base_vz"]
    whole = names_of(["time", *spin, *move], FLOATING)
    assert [whole[c] for c in spin + move] == [f"qvel/root/{part}" for part in ("wx", "wy", "wz", "vx", "vy", "vz")]
    matched = match_columns([("log", ["time", *spin])], FLOATING, {}, "log.csv")
    assert not [target for target in matched.names.values() if target.startswith("qvel/")]
    assert any("estimated" in note for note in matched.notes)


def test_numbers_are_taken_in_the_order_of_the_model_and_said() -> None:
    matched = match_columns([("log", ["t", "q1", "q2", "dof_vel/0", "dof_vel/1", "u[0]", "u[1]"])], MODEL, {}, "x")
    found = {column: target for (_, column), target in matched.names.items()}
    assert (found["q1"], found["q2"], found["u[1]"]) == ("qpos/shoulder", "qpos/elbow", "ctrl/elbow")
    assert found["dof_vel/0"] == "qvel/shoulder"
    assert sum("order of the model" in note for note in matched.notes) == 3


def test_the_order_that_was_taken_is_told_of_all_joints() -> None:
    limbs = "".join(
        f'<body><joint name="{i}{part}"/><geom size="0.1"/></body>' for i in "abcdef" for part in ("hip", "knee")
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{limbs}</worldbody></mujoco>")
    (note,) = match_columns([("log", [f"q[{i}]" for i in range(12)])], model, {}, "x").notes[:1]
    assert note == "'q[0]' to 'q[11]' were taken in the order of the model: " + ", ".join(
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(12)
    )


def test_a_prefix_between_quantity_and_joint_does_not_count() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.replace('"shoulder"', '"joint1"').replace('"elbow"', '"joint2"'))
    kinds = {"position": "qpos", "velocity": "qvel", "command": "ctrl"}
    for form in ("{}/lbr_joint{}", "/states/{}/lbr_joint{}", "lbr_joint{1}/{0}"):
        columns = [form.format(kind, i) for kind in (*kinds, "temperature") for i in (1, 2)]
        expected = {form.format(kind, i): f"{of}/joint{i}" for kind, of in kinds.items() for i in (1, 2)}
        assert names_of(["time", *columns], model) == {"time": "time", **expected}
        two_robots = [*columns, form.format("position", 1).replace("lbr", "old")]
        assert names_of(["time", *two_robots], model) == {"time": "time"}


@pytest.mark.parametrize("form", ["{kind}_robot1_{joint}", "left/arm/{kind}_{joint}", "/north/{kind}/arm1/{joint}"])
def test_unknown_words_do_not_count_where_all_names_match_without_them(form: str) -> None:
    columns = {form.format(kind=k, joint=j): f"{t}/{j}" for k, t in KINDS for j in ("shoulder", "elbow")}
    found = match_columns([("log", ["t", *columns, "battery"])], MODEL, {}, "log.csv")
    assert {column: target for (_, column), target in found.names.items()} == {"t": "time", **columns}
    assert any("in names of columns does not count" in note for note in found.notes)


KINDS = (("q", "qpos"), ("dq", "qvel"), ("cmd", "ctrl"))


@pytest.mark.parametrize("other", ["error", "temperature", "max"])
def test_words_of_other_quantities_count(other: str) -> None:
    found = names_of(["t", *(f"q_{other}_{joint}" for joint in ("shoulder", "elbow")), "u1", "u2"])
    assert set(found.values()) == {"time", "ctrl/shoulder", "ctrl/elbow"}


def test_of_two_robots_none_is_taken() -> None:
    columns = [f"{side}_{kind}_{j}" for side in ("left", "right") for kind in ("q", "u") for j in ("shoulder", "elbow")]
    assert names_of(["t", *columns]) == {"t": "time"}
    assert len(names_of(["t", *columns[:4]])) == 5


ONE_JOINT = ARM[: ARM.index('<body name="lower"')] + "</body></worldbody><actuator>{}</actuator></mujoco>"
MOTOR, SERVO = (
    mujoco.MjModel.from_xml_string(ONE_JOINT.format(f'<{kind} name="drive" joint="shoulder"{more}/>'))
    for kind, more in (("motor", ""), ("position", ' kp="5"'))
)


@pytest.mark.parametrize(
    ("model", "columns"),
    [
        (MOTOR, {"t": "time", "position": "qpos/shoulder", "velocity": "qvel/shoulder", "torque": "ctrl/drive"}),
        (MOTOR, {"time": "time", "theta [deg]": "qpos/shoulder", "omega": "qvel/shoulder", "u": "ctrl/drive"}),
        (SERVO, {"t": "time", "pos": "qpos/shoulder", "goal_pos": "ctrl/drive", "torque": "force/drive"}),
        (SERVO, {"t": "time", "motor.position": "qpos/shoulder", "motor.target": "ctrl/drive"}),
    ],
)
def test_the_only_joint_needs_no_name(model: mujoco.MjModel, columns: dict[str, str]) -> None:
    assert names_of([*columns, "battery", "state", "temperature"], model) == columns
    tables = [("log", [*columns])]
    check_matched(match_columns(tables, model, {}, "x"), tables, model, "x")


def test_suggestions_fit_in_unit_and_quantity() -> None:
    columns = [
        "t",
        "shoulder",
        "elbw_vel",
        "elbw_pos [rad]",
        "elbow1 [rpm]",
        "elbow_current",
        "elbw_cmd",
        "cmd_shoulder",
    ]
    tables = [("log", columns)]
    with pytest.raises(InputError) as raised:
        check_matched(match_columns(tables, MODEL, {}, "x"), tables, MODEL, "x")
    lines = "\n".join(raised.value.lines)
    assert '"NAME 1" = "qpos/elbow"  # nearest: \'elbw_pos [rad]\'\n' in lines
    assert '"NAME 2" = "ctrl/elbow"  # nearest: \'elbw_cmd\'\n' in lines
    assert [may_be(column, "time", MODEL) for column in ("clock", "elbw_pos", "x [rad]", "x [ms]")] == [1, 0, 0, 1]
    assert not may_be("x", "qpos/elbow", MODEL, "nm")


def test_a_column_that_has_its_place_is_not_suggested() -> None:
    tables = [("log", ["t", "shoulder", "elbow", "u_shoulder"])]
    with pytest.raises(InputError) as raised:
        check_matched(match_columns(tables, MODEL, {}, "x"), tables, MODEL, "x")
    assert '"NAME 1" = "ctrl/elbow"  # nearest: none' in raised.value.lines
    assert any("leave the actuator, and joints that stood still" in line for line in raised.value.lines)


def test_lists_in_messages_are_whole_or_say_how_much_is_missing() -> None:
    for count in (30, 41):
        tables = [("log", ["t", *(f"channel{i}" for i in range(count - 1))])]
        with pytest.raises(InputError) as raised:
            check_matched(match_columns(tables, MODEL, {}, "x"), tables, MODEL, "x")
        assert "..." not in str(raised.value)
        assert str(raised.value).count("channel") == 29
        assert ("and 11 more" in str(raised.value)) == (count == 41)


def test_numbers_of_joints_win_over_their_order() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.replace('"shoulder"', '"joint2"').replace('"elbow"', '"joint1"'))
    assert names_of(["t", "q1", "q2"], model) == {"t": "time", "q1": "qpos/joint1", "q2": "qpos/joint2"}
    assert "qpos/joint1" not in names_of(["t", "q0", "q1", "q2"], model).values()


@pytest.mark.parametrize("form", ["/joint_states/{}[{}]", "robot/joints/{}_{}", "joint_{}_{}"])
@pytest.mark.parametrize("first", [0, 1])
def test_numbers_that_begin_at_nought_are_no_numbers_of_joints_that_begin_at_one(form: str, first: int) -> None:
    model = mujoco.MjModel.from_xml_string(ARM.replace('"shoulder"', '"joint_1"').replace('"elbow"', '"joint_2"'))
    columns = [form.format(kind, first + i) for kind in ("position", "velocity") for i in (0, 1)]
    found = names_of(["__time", *columns], model)
    assert [found.get(c) for c in columns] == ["qpos/joint_1", "qpos/joint_2", "qvel/joint_1", "qvel/joint_2"]


def test_torques_are_the_commands_of_motors_where_none_is_named_so() -> None:
    alone = match_columns([("log", ["t", "tau_shoulder", "elbow_torque"])], MOTORS, {}, "log.csv")
    assert set(alone.names.values()) == {"time", "ctrl/m1", "ctrl/m2"}
    assert any("'tau_shoulder' is taken as its command" in note for note in alone.notes)
    assert "ctrl/m1" not in names_of(["t", "qdes_shoulder"], MOTORS).values()
    both = names_of(["t", "tau_shoulder", "tau_des_shoulder"], MOTORS)
    assert both["tau_des_shoulder"] == "ctrl/m1"


def test_labels_of_tables_say_what_bare_names_are() -> None:
    tables = [("commands", ["time", "shoulder", "elbow"]), ("joints", ["time", "shoulder", "elbow"])]
    found = match_columns(tables, MODEL, {}, "x", labelled=True).names
    assert found[0, "elbow"] == "ctrl/elbow"
    assert found[1, "elbow"] == "qpos/elbow"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            ["t", "pos_elbow", "enc_elbow", "shoulder"],
            "'pos_elbow', 'enc_elbow' may all be 'qpos/elbow'.*\\[columns\\]",
        ),
        (["t", "shoulder", "elbw", "u1", "u2"], "no column 'qpos/elbow'; columns of the file: 't'.*dataset.toml"),
        (["t", "shoulder", "elbow"], "no column 'ctrl/shoulder'"),
        (["frame", "shoulder", "elbow", "u1", "u2"], "no column 'time'"),
        (["t", "qpos/shoulder", "qpos/elbows"], "'qpos/elbows' names no joint.*'qpos/elbow'"),
    ],
)
def test_what_is_missing_or_ambiguous_is_asked_for(columns: list[str], message: str) -> None:
    tables = [("log", columns)]
    with pytest.raises(InputError, match=message):
        check_matched(match_columns(tables, MODEL, {}, "log.csv"), tables, MODEL, "log.csv")


def test_a_joint_has_no_encoder_where_no_column_is_left_or_it_is_said() -> None:
    whole, spare = ["t", "shoulder", "u1", "u2"], ["t", "shoulder", "u1", "u2", "battery"]
    for columns, unmeasured in ((whole, ()), (spare, ("elbow",))):
        tables = [("log", columns)]
        check_matched(match_columns(tables, MODEL, {}, "log.csv"), tables, MODEL, "log.csv", unmeasured)
    tables = [("log", spare)]
    with pytest.raises(InputError, match=r"no column 'qpos/elbow'") as raised:
        check_matched(match_columns(tables, MODEL, {}, "log.csv"), tables, MODEL, "log.csv")
    assert any('below [model]: unmeasured = ["elbow"]' in line for line in raised.value.lines)


def test_given_names_win() -> None:
    tables = [("log", ["t", "a", "pos_elbow", "enc_elbow"])]
    found = match_columns(tables, MODEL, {"a": "qpos/shoulder", "enc_elbow": "qpos/elbow"}, "x").names
    assert (found[0, "a"], found[0, "enc_elbow"]) == ("qpos/shoulder", "qpos/elbow")
    assert (0, "pos_elbow") not in found
    for wrong in ({"b": "qpos/elbow"}, {"a": "qpos/elbows"}):
        with pytest.raises(InputError, match="nearest"):
            match_columns(tables, MODEL, wrong, "x")


@pytest.mark.parametrize("unit", TIME_UNITS)
@pytest.mark.parametrize("rate", [20, 50, 100, 240, 1000, 4000])
@pytest.mark.parametrize("epoch", [0.0, 1.75e9])
def test_units_of_time_by_interval_and_epoch(unit: str, rate: int, epoch: float) -> None:
    true = np.arange(200) / rate
    stamps = (true + epoch) / TIME_UNITS[unit]
    if (unit, rate, epoch) == ("ms", 4000, 0.0):
        pytest.skip("a quarter of a millisecond could be a quarter of a second")
    assert time_unit(stamps) == unit
    notes: list[str] = []
    factor, origin = to_seconds(stamps, None, notes)
    np.testing.assert_allclose((stamps - origin) * factor, true, atol=6e-7)
    assert bool(notes) == (unit != "s" or epoch > 0)


def test_a_clock_that_runs_since_long_ago_starts_anew() -> None:
    """Effects may depend on the time since the recording began."""
    notes: list[str] = []
    assert to_seconds(np.array([4211.5, 4211.51]), "s", notes) == (1.0, 4211.5)
    assert to_seconds(np.array([0.0035, 0.0085]), "s", []) == (1.0, 0.0)
    assert notes == ["time counts from the first sample, at 4211.500 s"]
