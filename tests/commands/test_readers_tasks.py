"""Tasks of readers: a log in a format of its own beside an MJCF, from files to findings with one command.

Each log is of a small robot in which nothing is missing or whose elbow has dry friction; most tasks end at the findings
before the search, and one searches.
"""

import shlex
from pathlib import Path

import h5py
import mujoco
import numpy as np
import pytest
from robot_logs import ARM, RobotLog, simulated_log

from btr_mjx import diagnose
from btr_mjx.errors import InputError
from btr_mjx.gap import examine
from btr_mjx.gap.data import Dataset, open_dataset
from btr_mjx.gap.effects import selected_effects
from btr_mjx.gap.preflight import Finding, refuse_errors
from btr_mjx.runs import read_json

PENDULUM = """<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <body name="rod"><joint name="p1" axis="0 1 0" damping="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2"/>
      <body name="tip" pos="0 0 -0.3"><joint name="p2" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.1"/></body></body>
  </worldbody>
</mujoco>"""


def findings_of(model: Path, *logs: Path) -> tuple[Dataset, list[Finding]]:
    """What the command reads and finds before it searches."""
    dataset, findings = examine(model, selected_effects(("all",)), "trajectory", logs=logs)
    assert isinstance(dataset, Dataset)
    refuse_errors(findings)
    return dataset, findings


def told(findings: list[Finding], text: str) -> bool:
    return any(text in finding.message for finding in findings)


def same_motion(dataset: Dataset, log: RobotLog, atol: float) -> None:
    for one in dataset.recordings:
        rows = np.round(1000 * one.time).astype(int)
        np.testing.assert_allclose(one.qpos, log.qpos[rows], atol=atol)
        np.testing.assert_allclose(one.ctrl, log.ctrl[rows], atol=atol)


def test_a_spreadsheet_in_degrees_with_decimal_commas(tmp_path: Path) -> None:
    """Semicolons, a comment, a row of units, epochs in milliseconds, Windows line ends, a hole of 0.3 s."""
    log = simulated_log(ARM, 4.0).every(5)
    (tmp_path / "arm.xml").write_text(ARM)
    lines = ["# arm 3, operator: K.", "Timestamp;Shoulder Pos;Elbow Pos;Shoulder Cmd;Elbow Cmd", "[ms];[°];[°];[°];[°]"]
    for t, q, u in zip(log.time, log.qpos, log.ctrl, strict=True):
        seen = [f"{v:.5f}" for v in np.degrees(q)] if not 2.0 < t < 2.3 else ["", ""]
        stamp = f"{1.76e12 + 1000 * t:.1f}"
        lines.append(";".join([stamp, *seen, *(f"{v:.5f}" for v in np.degrees(u))]).replace(".", ","))
    (tmp_path / "Messung 7.csv").write_bytes(("\ufeff" + "\r\n".join(lines)).encode())
    dataset, findings = findings_of(tmp_path / "arm.xml", tmp_path / "Messung 7.csv")
    for one in dataset.recordings:
        rows = np.round(1000 * one.time).astype(int)
        np.testing.assert_allclose(one.qpos, simulated_log(ARM, 4.0).qpos[rows], atol=1e-6)
    for text in (
        "Shoulder Pos = qpos/shoulder",
        "Elbow Cmd from deg",
        "in ms (as stated)",
        "split into 2 parts at 1 hole,",
    ):
        assert told(findings, text), text
    assert not told(findings, "gaps")
    assert 'file = "Messung 7.csv"' in dataset.inferred
    assert sorted(path.name for path in tmp_path.iterdir()) == ["Messung 7.csv", "arm.xml"]
    copied = tmp_path / "dataset.toml"
    copied.write_text(dataset.inferred)
    again = open_dataset(tmp_path)
    assert [r.name for r in again.recordings] == [r.name for r in dataset.recordings]
    np.testing.assert_array_equal(again.recordings[0].qpos, dataset.recordings[0].qpos)


def test_a_plotjuggler_table_of_three_clocks(tmp_path: Path) -> None:
    """Rows at the union of all times in seconds since 1970; commands by number."""
    log = simulated_log(ARM, 3.0, hold=20)
    joints, sent = log.every(4), log.every(20, 2)
    rows = [
        (t, [f"{v:.9f}" for v in (*q, *v)] + ["", ""])
        for t, q, v in zip(joints.time, joints.qpos, joints.qvel, strict=True)
    ]
    rows += [(t, ["", "", "", ""] + [f"{v:.9f}" for v in u]) for t, u in zip(sent.time, sent.ctrl, strict=True)]
    names = [f"/joint_states/{what}/{joint}" for what in ("position", "velocity") for joint in ("shoulder", "elbow")]
    names += ["/arm/commands/data.0", "/arm/commands/data.1"]
    text = [",".join(["__time", *names]), *(",".join([f"{1.7e9 + t:.6f}", *v]) for t, v in sorted(rows))]
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "run.csv").write_text("\n".join(text))
    dataset, findings = findings_of(tmp_path)
    assert dataset.recordings[0].interpolation == "hold"
    assert all(one.qvel_measured.all() for one in dataset.recordings)
    assert sum(len(one.time) for one in dataset.recordings) > 740
    assert told(findings, "were taken in the order of the model: shoulder, elbow")
    assert told(findings, "held on the clock of")
    for one in dataset.recordings:
        rows_of = np.round(1000 * (one.time - joints.time[0])).astype(int)
        np.testing.assert_allclose(one.qpos, log.qpos[rows_of], atol=1e-8)


def test_an_hdf5_file_beside_a_model_in_another_folder(tmp_path: Path) -> None:
    log = simulated_log(ARM, 3.0, hold=20)
    joints, sent = log.every(2), log.every(20)
    (tmp_path / "robots").mkdir()
    (tmp_path / "logs").mkdir()
    (tmp_path / "robots" / "arm.xml").write_text(ARM)
    with h5py.File(tmp_path / "logs" / "run.h5", "w") as file:
        for group, part, values in (("state", joints, joints.qpos), ("action", sent, sent.ctrl)):
            file[f"{group}/time_us"] = np.round(1e6 * part.time).astype("i8")
            file[f"{group}/joint_pos"] = values
            file[f"{group}/joint_pos"].attrs["names"] = ["shoulder", "elbow"]
    dataset, findings = findings_of(tmp_path / "robots" / "arm.xml", tmp_path / "logs" / "run.h5")
    same_motion(dataset, log, 1e-12)
    assert told(findings, "time stamps are in us (as stated)")
    assert dataset.folder == tmp_path
    assert 'file = "logs/run.h5"' in dataset.inferred


def test_a_free_swing_in_nanoseconds(tmp_path: Path) -> None:
    """No actuators, no commands, spaces between the columns, two logs."""
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    for i, start in enumerate((0.9, -0.6)):
        data = mujoco.MjData(model)
        data.qpos[:] = start, 0.2
        rows = ["stamp p1 p2"]
        for k in range(2000):
            rows.append(f"{1760000000000000000 + 1_000_000 * k} {data.qpos[0]:9.6f} {data.qpos[1]:9.6f}")
            mujoco.mj_step(model, data)
        (tmp_path / f"swing{i}.txt").write_text("\n".join(rows))
    dataset, findings = findings_of(tmp_path)
    assert [one.name for one in dataset.recordings] == ["swing0", "swing1"]
    assert dataset.recordings[0].ctrl.shape == (2000, 0)
    assert told(findings, "in ns (told by intervals of 1e+06)")
    np.testing.assert_allclose(dataset.recordings[0].time, 1e-3 * np.arange(2000), atol=6e-7)


def test_names_that_are_missing_are_asked_for_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The printed dataset.toml, with the names filled in, and the printed command answer it."""
    log, logs = simulated_log(ARM, 2.0), tmp_path / "logs"
    logs.mkdir()
    (tmp_path / "arm.xml").write_text(ARM)
    rows = [f"{t:.4f},{q[0]},{q[1]},{u[0]},{u[1]}" for t, q, u in zip(log.time, log.qpos, log.ctrl, strict=True)]
    (logs / "log.csv").write_text("\n".join(["t,kanal_a,kanal_b,kanal_c,kanal_d", *rows]))
    with pytest.raises(SystemExit) as stop:
        diagnose.main([str(tmp_path / "arm.xml"), str(logs / "log.csv"), "--out", str(tmp_path / "run")])
    assert stop.value.code == 2
    message, _, remedy = capsys.readouterr().err.partition("\n")
    assert "no column 'qpos/shoulder', 'qpos/elbow', 'ctrl/shoulder', 'ctrl/elbow'" in message
    assert "columns of the file: 't', 'kanal_a', 'kanal_b', 'kanal_c', 'kanal_d'" in message
    assert not (tmp_path / "run").exists()
    where, _, lines = remedy.partition("\n")
    text, _, command = lines.partition("(a joint without")
    for number, name in enumerate("abcd", 1):
        text = text.replace(f"NAME {number}", f"kanal_{name}")
    file = Path(where.removeprefix("Write this to ").partition(", with names")[0])
    file.write_text(text)
    words = shlex.split(command.partition("then run: ")[2])
    diagnose.main([*words[words.index("btr_mjx.diagnose") + 1 :], "--check"])
    dataset, findings = findings_of(file.parent)
    same_motion(dataset, log, 1e-12)
    assert told(findings, "kanal_b = qpos/elbow")


def test_units_that_no_name_states(tmp_path: Path) -> None:
    log = simulated_log(ARM, 2.0)
    (tmp_path / "arm.xml").write_text(ARM)
    scale = np.array([1e3, *np.rad2deg(np.ones(2)), *np.rad2deg(np.ones(2))])
    rows = np.column_stack([log.time, log.qpos, log.ctrl]) * scale
    np.savetxt(tmp_path / "log.csv", rows, "%.12g", ",", header="t,a,b,c,d", comments="")
    units = "\n".join(f'{name} = "deg"' for name in "abcd")
    columns = 'a = "qpos/shoulder"\nb = "qpos/elbow"\nc = "ctrl/shoulder"\nd = "ctrl/elbow"'
    head = f'[model]\nfile = "arm.xml"\n[[recording]]\nfile = "log.csv"\n[columns]\n{columns}\n[units]\n'
    (tmp_path / "dataset.toml").write_text(f'{head}t = "ms"\n{units}\n')
    dataset, findings = findings_of(tmp_path)
    same_motion(dataset, log, 1e-9)
    assert told(findings, "converted to SI units: a from deg")
    for wrong, message in (('a = "furlong"', "expected one of s, ms"), ('x = "deg"', "nearest in the file")):
        (tmp_path / "dataset.toml").write_text(f"{head}{wrong}\n")
        with pytest.raises(InputError, match=message):
            findings_of(tmp_path)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["arm.xml"], "got a model without logs"),
        (["log.csv", "arm.xml"], "the first file is the model"),
        (["arm.xml", "nowhere.csv"], "there is no such file"),
        (["arm.xml", "notes.pdf"], "is no recording; expected"),
        (["arm.xml", "log.csv", "log.csv"], "given twice"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, given: list[str], message: str) -> None:
    for name in ("arm.xml", "log.csv", "notes.pdf"):
        (tmp_path / name).write_text(ARM if name == "arm.xml" else "t,q\n1,2\n")
    with pytest.raises(InputError, match=message):
        findings_of(*(tmp_path / name for name in given))


@pytest.mark.slow
def test_from_a_log_to_the_page(tmp_path: Path) -> None:
    """Dry friction at the elbow, logged with 0.3 mrad of noise; the command writes the page and what it inferred."""
    true = simulated_log(
        ARM.replace('name="elbow" axis="0 1 0"', 'name="elbow" axis="0 1 0" frictionloss="0.3"'), 6.0, hold=4
    )
    log, rng = true.every(4), np.random.default_rng(1)
    (tmp_path / "arm.xml").write_text(ARM)
    rows = [
        "\t".join(f"{v:.6f}".replace(".", ",") for v in (t, *(q + 3e-4 * rng.standard_normal(2)), *u))
        for t, q, u in zip(log.time, log.qpos, log.ctrl, strict=True)
    ]
    (tmp_path / "log.txt").write_text("\n".join(["t\tq_shoulder\tq_elbow\tref_shoulder\tref_elbow", *rows]))
    run = tmp_path / "run"
    arguments = [str(tmp_path / "arm.xml"), str(tmp_path / "log.txt"), "--out", str(run), "--no-progress"]
    diagnose.main([*arguments, "--effects", "dry_friction", "viscous_damping"])
    result = read_json(run / "result.json")
    assert result["verdict"] == "effect"
    assert "dry_friction" in str(result["effects"][0])
    assert (run / "report.html").is_file()
    assert '[[recording]]\nfile = "log.txt"' in (run / "dataset.toml").read_text()
