"""Logs that list all joints in another order than the model."""

import dataclasses
import re
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Recording, open_dataset
from btr_mjx.gap.preflight import preflight, refuse_errors
from btr_mjx.gap.preflight.alternatives.joint_orders import joint_orders
from tests.support.convention_logs import dataset, log, sines

LIMB = """<body pos="{x} {y} 0"><joint name="{name}_hip" axis="1 0 0" damping="0.2" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 {out} 0" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
<body pos="0 {out} 0"><joint name="{name}_thigh" axis="0 1 0" damping="0.2" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
<body pos="0 0 -0.2"><joint name="{name}_calf" axis="0 1 0" damping="0.1" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015" mass="0.15" contype="0" conaffinity="0"/></body></body></body>
"""
SIDES = {"L": 0.1, "R": -0.1}
PARTS = ("hip", "thigh", "calf")
SERVO = '<position name="{0}" joint="{0}" kp="{1}" kv="1"/>'
XML = f"""<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
{"".join(LIMB.format(name=name, x=0, y=y, out=y) for name, y in SIDES.items())}</worldbody><actuator>
{"".join(SERVO.format(f"{s}_{p}", 10 if p == "calf" else 30) for s in SIDES for p in PARTS)}</actuator></mujoco>"""
BY_LEVEL = [0, 3, 1, 4, 2, 5]


@cache
def sound() -> list[Recording]:
    return [log(XML, sines(np.random.default_rng(1), [0.3, 0.8, 0.9] * 2), i) for i in range(2)]


def written(folder: Path, recordings: list[Recording], qpos: list[int], ctrl: list[int]) -> list[Path]:
    """The model and logs with numbered columns in other orders than the model's."""
    (folder / "robot.xml").write_text(XML)
    paths = [folder / "robot.xml"]
    for r in recordings:
        table = {"time": r.time[:, None], "q": r.qpos[:, qpos], "dq": r.qvel[:, qpos], "target": r.ctrl[:, ctrl]}
        names = [f"{key}_{i}" if key != "time" else key for key, x in table.items() for i in range(x.shape[1])]
        paths.append(folder / f"{r.name}.csv")
        header = ",".join(names)
        np.savetxt(paths[-1], np.hstack(list(table.values())), delimiter=",", header=header, comments="", fmt="%.9g")
    return paths


@pytest.mark.parametrize(("what", "qpos", "ctrl"), [("positions and commands", True, True), ("commands", False, True)])
def test_a_whole_order_is_named_with_what_to_write(tmp_path: Path, what: str, qpos: bool, ctrl: bool) -> None:
    own = list(range(6))
    model, *logs = written(tmp_path, sound(), BY_LEVEL if qpos else own, BY_LEVEL if ctrl else own)
    data = open_dataset(model, logs=logs)
    errors = [f for f in preflight(data) if f.level == "error"]
    assert f"columns of {what} are in another order" in errors[0].message
    assert "level by level (breadth first): L_hip, R_hip, L_thigh" in errors[0].message
    assert len(errors) == 1
    with pytest.raises(InputError) as refused:
        refuse_errors(errors)
    text = "\n".join(refused.value.lines)
    table = text[text.index("[model]") : text.index("then run")]
    assert ('"q_1" = "qpos/R_hip"' in table, '"dq_1" = "qvel/R_hip"' in table) == (qpos, qpos)
    assert '"target_1" = "ctrl/R_hip"' in table

    (tmp_path / "dataset.toml").write_text(table)
    mended = open_dataset(tmp_path)
    for found, truth in zip(mended.recordings, sound(), strict=True):
        np.testing.assert_allclose(found.qpos, truth.qpos, rtol=1e-6)
        np.testing.assert_allclose(found.qvel, truth.qvel, rtol=1e-6)
        np.testing.assert_allclose(found.ctrl, truth.ctrl, rtol=1e-6)
    assert [f.message for f in preflight(mended) if f.level != "note"] == []


def test_the_models_own_order_is_not_accused(tmp_path: Path) -> None:
    def rough(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[:] = 0.3
        model.body_mass[2:] *= 2

    wave = sines(np.random.default_rng(2), [0.3, 0.8, 0.9] * 2)
    for logs in (sound(), [log(XML, wave, i, edit=rough) for i in range(2)]):
        model, *paths = written(tmp_path, logs, list(range(6)), list(range(6)))
        assert [f.message for f in preflight(open_dataset(model, logs=paths)) if f.level == "error"] == []


def test_orders_of_joints_and_actuators() -> None:
    model = mujoco.MjModel.from_xml_string(XML)
    found = dict(joint_orders(model, list(range(6)), list(range(6))))
    assert BY_LEVEL in found.values()
    assert [3, 4, 5, 0, 1, 2] in found.values()
    assert [3, 0, 4, 1, 5, 2] in found.values()
    assert list(range(6)) not in found.values()
    assert len({tuple(order) for order in found.values()}) == len(found)
    other = dict(joint_orders(model, list(range(6)), BY_LEVEL))
    assert next(key for key, order in other.items() if order == list(range(6))).startswith("in that of the model")


def test_names_that_were_given_in_the_wrong_order_are_found() -> None:
    """A program wrote the names of the model over columns of another order."""
    turned = [
        dataclasses.replace(r, qpos=r.qpos[:, BY_LEVEL], qvel=r.qvel[:, BY_LEVEL], ctrl=r.ctrl[:, BY_LEVEL])
        for r in sound()
    ]
    (found,) = (f for f in preflight(dataset(XML, turned)) if f.level == "error")
    assert re.search(r"positions and commands are in another order", found.message)
    assert '"qpos/L_thigh" = "qpos/R_hip"' in found.lines
