"""Actuators with several controls or outputs: each part of the package counts them, or refuses them by name."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from small_robots import HOPPER, hopper

from btr_mjx.engines import UnsupportedModel
from btr_mjx.errors import InputError
from btr_mjx.evaluation import choose_engine, evaluate
from btr_mjx.gap.data import load
from btr_mjx.models import control_names, parse_path, part_names, set_values
from btr_mjx.models.controller_table import controls_at_start
from btr_mjx.robots import Robot

ACTUATORS = {
    "pid": '<pid name="a" joint="hip" kp="20" kv="0.5"/>',
    "feedforward": '<pid name="a" joint="hip" kp="20" kv="0.5" input="pos vel ff"/>',
    "orientation": '<orientation name="a" joint="neck" kp="3"/>',
}
LAST = '<position name="b" joint="hip" kp="5" gear="2" ctrlrange="-0.3 0.4"/>'
NECK = '<body pos="0 0 0.1"><joint name="neck" type="ball"/><geom size="0.03" pos="0 0 0.1"/></body>'


def text(case: str) -> str:
    changed = HOPPER.replace("<freejoint/>", f"<freejoint/>{NECK}")
    return changed.replace('<position joint="hip" kp="20" kv="0.5"/>', ACTUATORS[case] + LAST)


def robot(case: str) -> Robot:
    """The hopper with several controls, which its signal knows."""
    nu = compiled(case).nu
    signal = lambda c, time, xp: xp.stack([c[0] * xp.sin(20.0 * time + k * c[1]) for k in range(nu)])  # noqa: E731
    return dataclasses.replace(hopper(), template=text(case), signal=signal)


def compiled(case: str) -> mujoco.MjModel:
    filled = text(case)
    for name, value in (("height", 0.1), ("density", 800), ("length", 0.3)):
        filled = filled.replace(f"{{{{ {name} }}}}", str(value))
    return mujoco.MjModel.from_xml_string(filled)


@pytest.mark.parametrize("case", ACTUATORS)
def test_names_and_paths_are_those_of_the_actuators(case: str) -> None:
    model = compiled(case)
    assert model.nu > model.nactuator == 2
    assert part_names(model, "actuator") == ["a", "b"]
    names = control_names(model)
    assert names == [*(f"a/{i}" for i in range(model.nu - 1)), "b"]
    assert parse_path(model, "actuator:b/ctrlrange[1]").read(model) == 0.4
    assert parse_path(model, "actuator:b/gear[0]").read(model) == 2
    set_values(model, {"actuator:b/ctrlrange[0]": -0.2, "actuator:b/gear[0]": 3})
    np.testing.assert_array_equal(model.actuator_ctrlrange[-1], [-0.2, 0.4])
    assert model.actuator_gear[-1, 0] == 3
    if case != "orientation":
        set_values(model, {"actuator:a/kp": 7})
        assert model.actuator_biasprm[0, 1] == -7
        assert not model.actuator_gainprm[0].any()  # where a PID has its ki
    assert controls_at_start(model, "").shape == (model.nu,)


@pytest.mark.parametrize("case", ACTUATORS)
def test_native_evaluates_them_and_lanes_refuses_them_by_name(case: str) -> None:
    own = robot(case)
    s, c = np.array([own.nominal]), np.array([[0.5, 1.0]])
    found = evaluate(own, s, c, engine="native", states=True).outcome
    model = mujoco.MjModel.from_xml_string(own.render(s[0]))
    data = mujoco.MjData(model)
    for k in range(40):
        data.ctrl[:] = own.signal(c[0], k * model.opt.timestep, np)
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(found.qpos[0, 0, -1], data.qpos)
    for engine in ("lanes", "mjx"):
        with pytest.raises(UnsupportedModel, match="actuator 'a'"):
            evaluate(own, s, c, engine=engine)
    assert choose_engine(own).engine == "native"


@pytest.mark.parametrize("case", ACTUATORS)
def test_a_believed_model_has_one_control_for_each_actuator(case: str, tmp_path: Path) -> None:
    filled = tmp_path / "robot.xml"
    mujoco.mj_saveLastXML(str(filled), compiled(case))
    (tmp_path / "dataset.toml").write_text('[model]\nfile = "robot.xml"\n[[recording]]\nfile = "log.csv"\n')
    (tmp_path / "log.csv").write_text("time\n0\n1\n")
    with pytest.raises(InputError, match=r"robot\.xml: the actuator 'a' has \d controls and \d outputs"):
        load(tmp_path)
