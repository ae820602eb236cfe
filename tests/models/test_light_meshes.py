"""Models with large meshes: masses, motion and contacts are those of the whole mesh."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data.model_file import load_model
from btr_mjx.models import light_meshes
from btr_mjx.models.light_meshes import with_light_meshes

XML = """<mujoco><compiler angle="radian"/><option timestep="0.002"/><default><default class="seen">
<geom contype="0" conaffinity="0" group="2"/></default></default>
<asset><mesh name="bean" vertex="{points}" scale="1 0.7 0.5" refpos="0.01 0.02 0"/>
<mesh name="flat" vertex="0 0 0 1 0 0 0 1 0 1 1 0.01"/></asset>
<worldbody><geom type="plane" size="2 2 0.1"/>
<body pos="0 0 0.15"><joint name="lift" axis="0 1 0"/><geom type="mesh" mesh="bean" class="seen" pos="0.1 0 0"/>
<geom type="mesh" mesh="flat" class="seen" mass="0.01"/>
<body pos="0.2 0.1 0" euler="0.3 0.2 0.1"><joint name="elbow" axis="1 0 1"/>
<geom name="touching" type="mesh" mesh="bean" euler="0.2 0 0.1"/></body></body></worldbody></mujoco>"""


def text(count: int) -> str:
    """The model with a mesh of so many points, a few of them on its hull."""
    rng = np.random.default_rng(0)
    inner = rng.normal(size=(count, 3))
    inner *= 0.05 * rng.uniform(0, 1, (count, 1)) / np.linalg.norm(inner, axis=1, keepdims=True)
    corners = rng.normal(size=(30, 3))
    corners *= 0.1 / np.linalg.norm(corners, axis=1, keepdims=True)
    return XML.format(points=" ".join(f"{x:.5f}" for x in np.vstack([inner, corners]).ravel()))


def test_a_light_model_moves_and_collides_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_meshes, "_HEAVY", 0)
    path = tmp_path / "model.xml"
    path.write_text(text(60_000))
    whole = mujoco.MjModel.from_xml_path(str(path))
    light, _ = load_model(path, tmp_path)
    assert mujoco.mj_sizeModel(light) < mujoco.mj_sizeModel(whole) / 5
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "geom_contype", "geom_bodyid"):
        np.testing.assert_allclose(getattr(light, field), getattr(whole, field), rtol=1e-12, err_msg=field)
    states, touched = [], 0
    for model in (whole, light):
        data, rows = mujoco.MjData(model), []
        data.qvel[:] = 1.0
        for _ in range(300):
            mujoco.mj_step(model, data)
            rows.append(np.concatenate([data.qpos, data.qvel]))
            touched += data.ncon
        states.append(np.array(rows))
    assert touched
    np.testing.assert_allclose(*states, atol=1e-3)


def test_small_models_stay_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(text(10))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert with_light_meshes(path, model) is model
