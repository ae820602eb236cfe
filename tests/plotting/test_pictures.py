"""Cameras and pictures of robots, with OpenGL and without."""

import subprocess

import mujoco
import numpy as np
import pytest
from matplotlib.figure import Figure

from btr_mjx.models import compile_mjcf
from btr_mjx.plotting import pictures, robot_figure
from btr_mjx.robots import hexapod

ROBOT = hexapod()


def test_camera_shows_every_point():
    models = [
        compile_mjcf(ROBOT, ROBOT.render(values)) for values in (ROBOT.simulation_box.low, ROBOT.simulation_box.high)
    ]
    aspect, margin = 1.3, 0.05
    camera = pictures.camera_for(models, aspect, margin=margin)
    points = np.concatenate([cloud for model in models for _, cloud in pictures.point_clouds(model)])
    flat, depth = camera.project(points)
    extent = np.abs(flat / [aspect, 1]).max(axis=0)
    assert (depth > 0).all()
    assert extent.max() == pytest.approx(1 - 2 * margin)


def test_point_clouds_of_every_kind_of_geom():
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1"/>
      <geom type="sphere" size=".1" pos="1 0 0"/><geom type="capsule" size=".1 .3" pos="0 0 1"/>
      <geom type="cylinder" size=".1 .3"/><geom type="ellipsoid" size=".1 .2 .3"/><geom type="box" size=".1 .2 .3"/>
      <geom type="box" size="1 1 1" rgba="1 1 1 0"/><geom type="box" size="1 1 1" group="4"/>
      </worldbody></mujoco>"""
    clouds = pictures.point_clouds(mujoco.MjModel.from_xml_string(xml))
    assert [geom for geom, _ in clouds] == [1, 2, 3, 4, 5]
    expected = [[0.1, 0.1, 0.1], [0.1, 0.1, 0.4], [0.1, 0.1, 0.3], [0.1, 0.2, 0.3], [0.1, 0.2, 0.3]]
    for (_, cloud), half in zip(clouds, expected, strict=True):
        np.testing.assert_allclose(np.ptp(cloud, axis=0) / 2, half, rtol=0.03)


def test_covered_spheres_are_hidden_in_a_copy():
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    shown = pictures.without_covered(model)
    assert shown.geom("foot0").rgba[3] == 0
    assert model.geom("foot0").rgba[3] == 1
    assert shown.geom("b3").rgba[3] == 1


def test_sketch_without_gl(monkeypatch):
    monkeypatch.setattr(pictures, "working_backend", lambda: None)
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    figure = Figure()
    robot_figure.draw_models([figure.subplots()], [model])
    shadows, outlines = figure.axes[0].collections
    assert len(shadows.get_paths()) == len(outlines.get_paths()) == 15  # the bodies b0..b14
    vertices = np.concatenate([path.vertices for path in outlines.get_paths()])
    assert np.abs(vertices[:, 1]).max() <= 1
    assert np.ptp(vertices[:, 1]) > 1.2 or np.ptp(vertices[:, 0]) > 1.2


@pytest.fixture
def fresh_probe(monkeypatch):
    pictures.working_backend.cache_clear()
    yield monkeypatch
    pictures.working_backend.cache_clear()


def test_no_backend_is_said_once_in_one_line(fresh_probe, capsys):
    calls = []
    fresh_probe.delenv("MUJOCO_GL", raising=False)
    fresh_probe.delenv("DISPLAY", raising=False)
    fresh_probe.setattr(pictures.platform, "system", lambda: "Linux")

    def fail(command, **options):
        calls.append(options["env"]["MUJOCO_GL"])
        raise subprocess.CalledProcessError(-11, command)

    fresh_probe.setattr(pictures.subprocess, "run", fail)
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    assert pictures.render(model) is None
    assert pictures.render(model) is None
    assert calls == ["egl", "osmesa"]
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "OpenGL" in said[0]


def test_a_backend_that_hangs_counts_as_broken(fresh_probe):
    fresh_probe.setenv("MUJOCO_GL", "egl")
    fresh_probe.setattr(pictures, "TIMEOUT", 0.01)
    assert pictures.working_backend() is None


def test_rendering_can_be_switched_off(fresh_probe):
    fresh_probe.setenv("MUJOCO_GL", "disable")
    fresh_probe.setattr(pictures, "_render", lambda *a: pytest.fail("must not try"))
    assert pictures.working_backend() is None


def test_rendered_where_gl_works(fresh_probe):
    if pictures.working_backend() is None:
        pytest.skip("no OpenGL on this machine")
    model = compile_mjcf(ROBOT, ROBOT.render(ROBOT.nominal))
    model.geom_rgba[:] = (1.0, 0.0, 0.0, 1.0)
    model.geom_matid[:] = -1
    model.geom_rgba[model.geom("ground").id] = (0.0, 0.0, 1.0, 1.0)
    width, height = 96, 72
    picture = pictures.render(model, width, height)
    assert picture.shape == (height, width, 3)
    assert picture.dtype == np.uint8
    # What is rendered lies where the sketch would draw it: both use one camera.
    camera = pictures.camera_for([model], width / height)
    for name in ("b0", "b2", "b9", "b14"):
        cloud = dict(pictures.point_clouds(model))[model.geom(name).id]
        (x, y), _ = camera.project(cloud.mean(axis=0))
        column, row = (x * height / width + 1) / 2 * width, (1 - y) / 2 * height
        patch = picture[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2].reshape(-1, 3).astype(int)
        assert (patch[:, 0] > 2 * patch[:, 2]).any(), name
