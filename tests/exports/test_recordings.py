"""Files for viewers of recordings, read again with the readers of those formats."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.exports import RecordedCurves, RecordedPoses, recorded_poses, write_mcap, write_rerun

UNITS = {"elbow": "rad", "base/x": "m"}


@pytest.fixture
def curves(rng: np.random.Generator) -> list[RecordedCurves]:
    out = []
    for name, count in (("measured", 40), ("believed", 23)):
        time = np.sort(rng.uniform(2, 5, count)).round(6)
        out.append(RecordedCurves("recording", name, time, {key: rng.normal(size=count) for key in UNITS}, UNITS))
    out[1].values["elbow"][-3:] = np.nan  # it diverged
    return out


@pytest.fixture
def poses(rng: np.random.Generator) -> RecordedPoses:
    model = mujoco.MjModel.from_xml_string(FLOATER)
    qpos = rng.normal(size=(5, model.nq))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return recorded_poses("measured", model, 2 + np.arange(5) / 30, qpos)


def messages_of(path: Path) -> list[tuple[str, float, dict]]:
    """Topic, time [s] and content, in the order of the file; names of channels, schemas and units are checked."""
    from mcap.reader import NonSeekingReader

    found = []
    with path.open("rb") as file:
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            assert set(content) <= set(json.loads(schema.data)["properties"])
            assert (schema.name == "foxglove.FrameTransforms") == (channel.topic == "/tf")
            assert channel.metadata == ({} if channel.topic == "/tf" else UNITS)
            found.append((channel.topic, message.log_time / 1e9, content))
    return found


def test_mcap_holds_the_numbers_in_the_order_of_time(
    curves: list[RecordedCurves], poses: RecordedPoses, tmp_path: Path
) -> None:
    write_mcap(tmp_path / "a.mcap", curves, [poses])
    found = messages_of(tmp_path / "a.mcap")
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)
    for one in curves:
        own = [(time, content) for topic, time, content in found if topic == f"/recording/{one.name}"]
        np.testing.assert_allclose([time for time, _ in own], one.time, atol=1e-9)
        for name, values in one.values.items():
            read = [content.get(name, np.nan) for _, content in own]
            np.testing.assert_array_equal(read, values)
    frames = [(time, content["transforms"]) for topic, time, content in found if topic == "/tf"]
    assert len(frames) == 5
    for k, (time, transforms) in enumerate(frames):
        assert time == pytest.approx(poses.time[k], abs=1e-9)
        for n, one in enumerate(transforms):
            assert (one["parent_frame_id"], one["child_frame_id"]) == ("world", f"measured/{poses.bodies[n]}")
            assert one["timestamp"]["sec"] + 1e-9 * one["timestamp"]["nsec"] == pytest.approx(time)
            assert [one["translation"][axis] for axis in "xyz"] == poses.positions[k, n].tolist()
            assert [one["rotation"][axis] for axis in "wxyz"] == poses.quaternions[k, n].tolist()


def test_times_below_zero_are_counted_from_the_first(tmp_path: Path) -> None:
    early = [
        RecordedCurves("recording", name, time, {key: np.zeros(2) for key in UNITS}, UNITS)
        for name, time in (("a", np.array([-3.0, 1.0])), ("b", np.array([-2.5, 2.0])))
    ]
    write_mcap(tmp_path / "a.mcap", early, [])
    times = [(topic, time) for topic, time, _ in messages_of(tmp_path / "a.mcap")]
    assert times == [("/recording/a", 0.0), ("/recording/b", 0.5), ("/recording/a", 4.0), ("/recording/b", 5.0)]


@pytest.mark.slow  # with the extra, which is large
def test_rerun_holds_the_numbers_and_the_poses(
    curves: list[RecordedCurves], poses: RecordedPoses, tmp_path: Path
) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="the extra 'rerun' is not installed")
    write_rerun(tmp_path / "a.rrd", curves, [poses])
    reader = chunk.RrdReader(str(tmp_path / "a.rrd"))
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    read: dict[str, dict[str, np.ndarray]] = {}
    for one in reader.stream():
        batch = one.to_record_batch()
        columns = {name.split(":")[-1]: batch.column(name) for name in batch.schema.names}
        lists = {
            name: np.array(column.flatten().to_pylist())
            for name, column in columns.items()
            if name in ("scalars", "translation", "quaternion", "half_sizes")
        }
        if "time" in columns:
            lists["time"] = np.array(columns["time"].cast("int64").to_pylist()) / 1e9
        read.setdefault(one.entity_path, {}).update(lists)
    for own in curves:
        for name, path in (("elbow", "elbow"), ("base/x", r"base\/x")):
            found = read[f"/recording/{path}/{own.name}"]
            np.testing.assert_array_equal(found["scalars"], own.values[name])
            np.testing.assert_allclose(found["time"], own.time, atol=1e-9)
    for k, body in enumerate(poses.bodies):
        found = read[f"/bodies/measured/{body}"]
        np.testing.assert_allclose(found["translation"], poses.positions[:, k], atol=1e-6)
        np.testing.assert_allclose(found["quaternion"], poses.quaternions[:, k][:, [1, 2, 3, 0]], atol=1e-6)
        np.testing.assert_allclose(found["half_sizes"], poses.boxes[k][:, 3:6], atol=1e-6)


def test_poses_are_those_of_mujoco_and_boxes_hold_the_surfaces(rng: np.random.Generator) -> None:
    model = mujoco.MjModel.from_xml_string(FLOATER)
    qpos = np.array([*rng.normal(size=3), 0.5, -0.5, 0.5, 0.5, 0.7])
    found = recorded_poses("measured", model, np.zeros(1), qpos[None])
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    assert list(found.bodies) == ["trunk", "arm"]
    for k, body in enumerate(found.bodies):
        np.testing.assert_allclose(found.positions[0, k], data.body(body).xpos)
        np.testing.assert_allclose(found.quaternions[0, k], data.body(body).xquat)
    # The surface of the mesh in the world, against its box in the frame of the body.
    geom = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0])
    surface = data.geom_xpos[geom] + model.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T
    (box,) = found.boxes[1]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, box[6:])
    in_body = (surface - data.body("arm").xpos) @ data.body("arm").xmat.reshape(3, 3)
    in_box = (in_body - box[:3]) @ turn.reshape(3, 3)
    np.testing.assert_allclose(np.abs(in_box).max(axis=0), box[3:6], atol=1e-6)
    np.testing.assert_allclose(in_box.min(axis=0), -box[3:6], atol=1e-6)


FLOATER = """<mujoco>
  <asset><mesh name="wedge" vertex="0 0 0  .3 0 0  0 .2 0  0 0 .1  .3 .05 .02"/></asset>
  <worldbody><geom type="plane" size="1 1 1"/>
    <body name="trunk"><freejoint name="base"/><geom type="box" size="0.2 0.1 0.05" mass="1"/>
      <body name="arm" pos="0.2 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="mesh" mesh="wedge" pos=".1 .2 .3" euler="20 30 40" mass="0.3"/></body></body>
  </worldbody>
</mujoco>"""
