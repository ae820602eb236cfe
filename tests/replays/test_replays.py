"""Films show what a run found: the right motions, labelled, in the right number of frames."""

import shutil
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from PIL import Image
from robot_logs import ARM, simulated_log

from btr_mjx import coevolve, diagnose
from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, Recording, control_columns, open_dataset
from btr_mjx.gap.data.columns.model_columns import state_columns
from btr_mjx.gap.data.model_file import load_model
from btr_mjx.gap.simulate import World
from btr_mjx.models import base_model, light_meshes
from btr_mjx.plotting import camera_for, rendering
from btr_mjx.replay import ReplayConfig, main, replay
from btr_mjx.replays import Replay, ReplayedMotion, draw_film, film, read_replay, write_film
from btr_mjx.replays.diagnosis_motions import _drawn_model, _mended_world, diagnosis_replay, open_loop_positions
from btr_mjx.replays.film import FOOT, GAP, LABEL, picture_height
from btr_mjx.replays.replay_records import frame_times, hold_last_valid
from btr_mjx.robots import hexapod
from btr_mjx.runs import RunFolder, content_digest, read_json, write_json, write_table

SMALL_RUN = (
    *("--engine=native", "--duration=0.2", "--controllers=8", "--controller-generations=2", "--trials=3"),
    *("--simulations=6", "--simulation-generations=2", "--iterations=1", "--no-figures", "--no-progress"),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "small"
    coevolve.main([*SMALL_RUN, "--out", str(folder)])
    return folder


needs_gl = pytest.mark.skipif("rendering.working_backend() is None", reason="no OpenGL on this machine")


def frames_of(path: Path) -> np.ndarray:
    with Image.open(path) as film:
        frames = []
        for k in range(film.n_frames):  # type: ignore[attr-defined]
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), int))
    return np.stack(frames)


def test_a_coevolution_is_shown_before_and_after_in_simulation_and_reality(run: Path) -> None:
    shown = read_replay(run, 9, 6.0)
    titles = [[motion.title for motion in row] for row in shown.rows]
    assert titles == [["before: simulation", "before: reality"], ["after: simulation", "after: reality"]]
    assert len(shown.times) == 9
    assert shown.times[0] == 0
    assert shown.times[-1] == pytest.approx(0.2)
    for motion in shown.motions:
        assert motion.qpos.shape == (9, motion.model.nq)
        np.testing.assert_array_equal(motion.qpos[0], motion.model.qpos0)
    result = read_json(run / "result.json")
    # Saved numbers of the run's own engine, native here: those of the film are the same.
    numbers = [float(motion.number.split()[0]) for motion in shown.motions]
    with np.load(run / "trials.npz") as trials:
        promised = np.flatnonzero((trials["iteration"] == 1) & (trials["f_s"] == trials["f_s"][1:].max()))[0]
        assert numbers[0] == pytest.approx(trials["f_s"][promised], rel=5e-3)
        assert numbers[1] == pytest.approx(trials["f_r"][promised], rel=5e-3)
    assert numbers[3] == pytest.approx(result["f_r_best"], rel=5e-3)
    assert shown.rows[0][0].detail == "nominal parameters, iteration 1"
    assert shown.rows[1][1].detail == "best measured, iteration 1"


def test_motions_are_those_of_a_loop_over_steps(run: Path) -> None:
    """The controller with the best prediction in the nominal simulation, stepped one by one."""
    shown = read_replay(run, 5, 6.0)
    robot = hexapod()
    model = base_model(robot)
    with np.load(run / "trials.npz") as trials:
        controller = trials["controllers"][1 + trials["f_s"][1:].argmax()]
    data, dt = mujoco.MjData(model), model.opt.timestep
    states = [data.qpos.copy()]
    for k in range(round(0.2 / dt)):
        data.ctrl[:] = robot.signal(controller[:, None], k * dt, np)[:, 0]
        mujoco.mj_step(model, data)
        if np.isclose(shown.times, (k + 1) * dt, atol=dt / 4).any():
            states.append(data.qpos.copy())
    np.testing.assert_allclose(shown.rows[0][0].qpos, states, atol=1e-6)


@needs_gl
def test_the_film_has_its_frames_and_panels_differ_where_the_parameters_do(run: Path, tmp_path: Path) -> None:
    out = replay(ReplayConfig(run, tmp_path / "film.gif", seconds=1.0, rate=5, width=160, progress=False))
    assert out is not None
    frames = frames_of(out)
    assert frames.shape == (5, 2 * (picture_height(160) + LABEL) + GAP + FOOT, 2 * 160 + GAP, 3)

    def panel(row: int, column: int) -> np.ndarray:
        rows, columns = panel_at(row, column, 160)
        return frames[:, rows, columns]

    # Nominal and hidden lengths differ by 0.24 m; what was identified differs from the nominal, too.
    differing = lambda a, b: (np.abs(a - b).max(axis=-1) > 40).mean()  # noqa: E731
    assert differing(panel(0, 0)[0], panel(0, 1)[0]) > 0.005
    assert differing(panel(0, 0)[0], panel(0, 0)[-1]) > 0.002  # it moves
    foot = frames[:, -FOOT:]
    assert (foot[0] != foot[-1]).any()  # the time


def panel_at(row: int, column: int, width: int) -> tuple[slice, slice]:
    """Rows and columns of a panel's picture."""
    top, left = row * (picture_height(width) + LABEL + GAP) + LABEL, column * (width + GAP)
    return slice(top, top + picture_height(width)), slice(left, left + width)


@needs_gl
def test_equal_parameters_give_equal_panels() -> None:
    model = base_model(hexapod())
    poses = np.repeat(model.qpos0[None], 2, axis=0)
    pair = [ReplayedMotion(title, "", "", model, poses) for title in ("a", "b")]
    film = draw_film(Replay(np.array([0.0, 1.0]), [pair]), 120)
    assert film is not None
    left, right = (film[:, *panel_at(0, column, 120)] for column in (0, 1))
    np.testing.assert_array_equal(left, right)
    assert left.std() > 5


@needs_gl
def test_rendered_frames_are_those_of_the_poses() -> None:
    """Frames of a film equal pictures of the same poses, made one by one."""
    xml = """<mujoco><worldbody><light pos="0 0 3"/><body pos="0 0 1"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".05"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    poses = np.linspace(0, 1, 5)[:, None]
    camera = camera_for([model], poses=[poses])
    frames, again = rendering.render([(model, poses), (model, poses[::-1])], 64, 48, camera) or ()
    np.testing.assert_array_equal(frames, again[::-1])
    (alone,) = rendering.render([(model, poses[4:])], 64, 48, camera) or ()
    np.testing.assert_array_equal(alone[0], frames[4])
    assert (frames[0] != frames[-1]).any()
    assert frames[0, 0, 0].min() > 200  # a light background where the model has no sky


def test_without_opengl_a_line_says_that_there_is_no_film(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    rendering.working_backend.cache_clear()
    main([str(run), "--out", str(tmp_path / "film.gif"), "--no-progress"])
    rendering.working_backend.cache_clear()
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == ["no pictures of robots: MUJOCO_GL=disable"]
    assert not list(tmp_path.iterdir())


def test_a_film_that_fails_is_said_in_one_line(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("of a bug")

    monkeypatch.setattr(film, "render", fails)
    main([str(run), "--out", str(tmp_path / "film.gif"), "--no-progress"])
    assert capsys.readouterr().err.splitlines() == ["no film: ZeroDivisionError: of a bug"]


def test_a_gif_keeps_to_its_limit(tmp_path: Path, rng: np.random.Generator) -> None:
    film = rng.integers(0, 256, (6, 200, 300, 3), dtype=np.uint8)
    whole = write_film(tmp_path / "whole.gif", film, 10)
    size = write_film(tmp_path / "small.gif", film, 10, limit=whole // 2)
    assert size == (tmp_path / "small.gif").stat().st_size <= whole // 2
    assert len(frames_of(tmp_path / "small.gif")) == 6


@pytest.mark.filterwarnings("error:os.fork")
def test_mp4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reader = pytest.importorskip("imageio_ffmpeg", reason="the extra 'video' is not installed")
    monkeypatch.setenv("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")  # else its reader forks this process, which has threads
    film = np.zeros((7, 64, 96, 3), np.uint8)
    film[3:] = 200
    write_film(tmp_path / "film.mp4", film, 7)
    frames = reader.read_frames(str(tmp_path / "film.mp4"))
    about = next(frames)
    pictures = [np.frombuffer(frame, np.uint8) for frame in frames]
    assert about["size"] == (96, 64)
    assert len(pictures) == 7
    assert [picture.mean() > 100 for picture in pictures] == [False] * 3 + [True] * 4


def test_frame_times_are_whole_steps() -> None:
    times = frame_times(1.7, 72, 0.0005)
    assert len(times) == 71
    np.testing.assert_allclose(times / 0.0005, np.round(times / 0.0005), atol=1e-9)
    assert times[-1] == pytest.approx(1.7)
    assert len(frame_times(0.001, 72, 0.0005)) == 2


def test_a_diverged_state_is_held() -> None:
    qpos = np.array([[0.0], [1.0], [np.nan], [np.nan]])
    np.testing.assert_array_equal(hold_last_valid(qpos)[:, 0], [0, 1, 1, 1])


def test_open_loop_is_a_loop_over_steps() -> None:
    xml = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="j" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".05"/></body></worldbody>
      <actuator><motor joint="j"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    time = np.arange(0, 0.5, 0.01)
    ctrl = 0.3 * np.sin(8 * time)[:, None]
    zeros = np.zeros((len(time), 1))
    recording = Recording("r", time, ctrl, zeros + 0.2, zeros, np.ones(1, bool), "test", model, interpolation="linear")
    found = open_loop_positions(World.of(model), recording, time[:40])
    data = mujoco.MjData(model)
    data.qpos[0] = 0.2
    expected = [0.2]
    for k in range(39 * 5):
        data.ctrl[0] = np.interp(k * 0.002, time, ctrl[:, 0])
        mujoco.mj_step(model, data)
        if (k + 1) % 5 == 0:
            expected.append(data.qpos[0])
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-9)


def test_what_cannot_be_shown_is_said_in_one_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    write_json(tmp_path / "result.json", {"spearman": 1.0})
    (tmp_path / "scan.npz").touch()
    for arguments, said in (
        ([str(tmp_path / "nowhere")], "no result.json"),
        ([str(tmp_path)], "only runs of btr_mjx.coevolve and btr_mjx.diagnose"),
        ([str(run), "--out", "film.avi"], "ends in .gif or .mp4"),
        ([str(run), "--view"], "there is no display"),
        ([str(run), "--rate", "0"], "rate: got 0"),
        ([str(run), "--seconds", "nan"], "seconds: got nan"),
    ):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        assert stopped.value.code == 2
        error = capsys.readouterr().err.strip()
        assert said in error
        assert len(error.splitlines()) == 1


def test_a_robot_that_changed_is_refused(run: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(run, tmp_path / "copy")
    (copied / "SHA256SUMS").unlink()
    inputs = read_json(copied / "inputs.json")
    write_json(copied / "inputs.json", inputs | {"the robot": "0" * 64})
    with pytest.raises(InputError, match="the robot changed"):
        read_replay(copied, 3, 6.0)


def test_a_robot_behind_a_folder_is_shown_where_it_was_recorded(run: Path, tmp_path: Path) -> None:
    copied = shutil.copytree(run, tmp_path / "copy")
    for name in ("SHA256SUMS", "inputs.json"):
        (copied / name).unlink()
    config = read_json(copied / "config.json")
    write_json(copied / "config.json", config | {"reality": "folder"})
    shown = read_replay(copied, 4, 6.0)
    assert [[motion.title for motion in row] for row in shown.rows] == [["before: simulation", "after: simulation"]]
    model, real = base_model(hexapod()), read_replay(run, 41, 6.0).rows[0][1]
    columns = {"time": read_replay(run, 41, 6.0).times}
    columns |= dict(zip(state_columns(model)[0], real.qpos.T, strict=True))
    columns |= {name: np.zeros(41) for name in control_columns(model)}
    (copied / "exchange" / "measured").mkdir(parents=True)
    with np.load(run / "trials.npz") as trials:
        promised = 1 + trials["f_s"][1:].argmax()
    write_table(copied / "exchange" / "measured" / f"trial-{promised}.csv", columns)
    shown = read_replay(copied, 5, 6.0)
    assert [len(row) for row in shown.rows] == [2, 1]
    np.testing.assert_allclose(shown.rows[0][1].qpos, real.qpos[::10], atol=1e-12)


def test_a_diagnosis_of_a_model_and_its_logs_is_shown(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    log = simulated_log(ARM, 3.0)
    columns = {"time": log.time, "shoulder": log.qpos[:, 0], "elbow": log.qpos[:, 1]}
    write_table(tmp_path / "log.csv", columns | {"u1": log.ctrl[:, 0], "u2": log.ctrl[:, 1]})
    given = diagnose.DiagnoseConfig(tmp_path / "arm.xml", (tmp_path / "log.csv",), out=tmp_path / "run")
    inputs = {"the dataset": content_digest(open_dataset(tmp_path / "arm.xml", logs=given.logs))}
    assert given.out is not None
    with RunFolder.create(given.out, given, inputs=inputs) as run:
        write_json(run.path / "result.json", {"verdict": "none", "effects": []})
        run.seal()
    shown = read_replay(given.out, 10, 1.0)
    assert [motion.title for motion in shown.motions] == ["recording", "believed model"]
    assert np.abs(shown.motions[0].qpos - shown.motions[1].qpos).max() < 0.05


@needs_gl
def test_a_panel_without_a_recording_says_so(run: Path) -> None:
    shown = read_replay(run, 2, 6.0)
    film = draw_film(Replay(shown.times, [shown.rows[0], shown.rows[1][:1]]), 160)
    assert film is not None
    rows, columns = panel_at(1, 1, 160)
    assert film[:, rows.start - LABEL : rows.start, columns].min() < 128
    assert (film[:, rows, columns] == 255).all()


@pytest.mark.slow
def test_a_diagnosed_robot_is_shown_beside_its_recording(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    diagnose.main(["--demo", "--robot", "pendulum", "--out", str(folder), "--no-progress", "--no-figures"])
    shown = read_replay(folder, 30, 3.0)
    assert [motion.title for motion in shown.motions] == ["recording", "believed model", "mended model"]
    measured, believed, mended = (motion.qpos for motion in shown.motions)
    assert 0 < np.abs(mended - measured).mean() < np.abs(believed - measured).mean()
    out = replay(ReplayConfig(folder, seconds=1.0, rate=5, width=120, progress=False))
    assert out == folder / "replay.gif"
    assert len(frames_of(out)) == 5


def test_view_plays_every_motion(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import mujoco.viewer

    from btr_mjx.replays import viewer

    seen: list[np.ndarray] = []

    class Window:
        def __init__(self, data: Any) -> None:
            self.data, self.open = data, True

        def __enter__(self) -> "Window":
            return self

        def __exit__(self, *_: object) -> None: ...

        def is_running(self) -> bool:
            return self.open

        def sync(self) -> None:
            seen.append(self.data.qpos.copy())
            self.open = self.data.time < 0.199

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(mujoco.viewer, "launch_passive", lambda model, data: Window(data))
    monkeypatch.setattr(viewer.time, "sleep", lambda _: None)
    shown = read_replay(run, 4, 6.0)
    viewer.view_replay(shown)
    np.testing.assert_array_equal(seen, np.concatenate([motion.qpos for motion in shown.motions]))
    assert "after: reality" in capsys.readouterr().out


def test_effects_of_motors_are_in_the_film(tmp_path: Path) -> None:
    """They are named where a robot touches nothing, without being asked for."""
    xml = XML_OF_SERVO.format(mesh="")
    recording = still_recording(mujoco.MjModel.from_xml_string(xml))
    dataset = Dataset(tmp_path, recording.model, tmp_path / "a.xml", xml, (), (recording,))
    entry = {"effect": "servo_stiffness", "location": "actuator:j", "parameters": {"change": {"value": -0.5}}}
    world = _mended_world(dataset, recording, {"effects": [entry]}, ("all",))
    assert world.model.actuator_gainprm[0, 0] == 5.0


def test_meshes_that_a_dataset_leaves_out_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_meshes, "_HEAVY", 0)
    points = np.random.default_rng(0).normal(size=(300, 3)).round(3)
    mesh = f'<mesh name="m" vertex="{" ".join(map(str, points.ravel()))}"/>'
    (tmp_path / "a.xml").write_text(XML_OF_SERVO.format(mesh=mesh).replace(CAPSULE, 'type="mesh" mesh="m"'))
    model, text = load_model(tmp_path / "a.xml", tmp_path)
    dataset = Dataset(tmp_path, model, tmp_path / "a.xml", text, (), ())
    assert model.nmeshvert < 300
    assert _drawn_model(dataset, model).nmeshvert == 300
    assert _drawn_model(dataset, mujoco.MjModel.from_xml_string(ARM)).nmesh == 0


CAPSULE = 'type="capsule" fromto="0 0 0 0 0 -.5" size=".05"'
XML_OF_SERVO = """<mujoco><asset>{mesh}</asset><worldbody><body><joint name="j"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".05"/></body></worldbody>
<actuator><position name="j" joint="j" kp="10" kv="1"/></actuator></mujoco>"""


def still_recording(model: mujoco.MjModel) -> Recording:
    zeros = np.zeros((30, 1))
    return Recording("r", np.arange(30) / 50, zeros, zeros, zeros, np.ones(1, bool), "test", model)


def test_a_replay_names_recordings_that_are_gone(tmp_path: Path) -> None:
    write_json(tmp_path / "config.json", {"dataset": str(tmp_path / "gone.xml"), "logs": [str(tmp_path / "a.csv")]})
    write_json(tmp_path / "result.json", {})
    with pytest.raises(InputError, match=r"gone\.xml, .*a\.csv is not there any more.*put it back"):
        diagnosis_replay(tmp_path, 5, 1.0)
