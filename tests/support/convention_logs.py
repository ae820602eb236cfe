"""Small robots and logs of them, in which tests plant errors of convention."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from stepping import stepped

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.models import integrate

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
<body pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="0.1" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.018" mass="0.5" contype="0" conaffinity="0"/>
<body pos="0 0 -0.25"><joint name="wrist" axis="1 0 0" damping="0.05" armature="0.003"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.015" mass="0.2" contype="0" conaffinity="0"/></body></body></body>
</worldbody><actuator><position name="shoulder" joint="shoulder" kp="40" kv="1.5"/>
<position name="elbow" joint="elbow" kp="25" kv="0.8"/><position name="wrist" joint="wrist" kp="8" kv="0.2"/></actuator>
</mujoco>"""

FLOATER = """<mujoco><compiler angle="radian"/><option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/>
<worldbody><body pos="0 0 1"><freejoint name="root"/>
<geom type="box" size="0.1 0.08 0.05" mass="2" contype="0" conaffinity="0"/>
<body pos="0.1 0 0"><joint name="j1" axis="0 1 0" damping="0.05" armature="0.002"/>
<geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6" contype="0" conaffinity="0"/></body>
<body pos="0 0.08 0"><joint name="j2" axis="1 0 0" damping="0.05" armature="0.002"/>
<geom type="capsule" fromto="0 0 0 0 0.25 0" size="0.02" mass="0.6" contype="0" conaffinity="0"/></body></body>
</worldbody>
<actuator><position name="j1" joint="j1" kp="8" kv="0.5"/><position name="j2" joint="j2" kp="8" kv="0.5"/></actuator>
</mujoco>"""

CART = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="slider" type="slide" axis="1 0 0" damping="2"/>
<geom type="box" size="0.08 0.05 0.04" mass="0.6" contype="0" conaffinity="0"/>
<body><joint name="pole" axis="0 1 0" damping="0.001"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.01" mass="0.15" contype="0" conaffinity="0"/></body></body>
</worldbody>
<actuator><motor name="force" joint="slider"/></actuator></mujoco>"""

SPINNER = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="j7" axis="0 0 1" damping="0.05" armature="0.01"/>
<geom type="box" size="0.1 0.02 0.02" pos="0.05 0 0" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><velocity name="j7" joint="j7" kv="0.6"/></actuator></mujoco>"""

FLYER = """<mujoco><option timestep="0.002"/><worldbody><body pos="0 0 2"><freejoint name="root"/>
<geom type="box" size="0.12 0.1 0.03" mass="1" contype="0" conaffinity="0"/><site name="s" pos="0.02 0.01 0"/></body>
</worldbody><actuator><motor name="thrust" site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>"""

Command = Callable[[np.ndarray], np.ndarray]
"""Commands (N, nu) at times (N,)."""


def sines(rng: np.random.Generator, amplitude: list[float], low: float = 2.0, high: float = 10.0) -> Command:
    """Sums of two sines for each control, at rest at time 0."""
    size = np.array(amplitude)
    frequency, phase = rng.uniform(low, high, (2, len(size))), rng.uniform(0, 6, (2, len(size)))

    def command(times: np.ndarray) -> np.ndarray:
        angle = frequency * times[:, None, None] + phase
        return 0.5 * size * np.sum(np.sin(angle) - np.sin(phase) * np.exp(-8 * times[:, None, None]), axis=1)

    return command


def log(
    xml: str,
    command: Command,
    seed: int,
    seconds: float = 3.0,
    rate: int = 250,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    edit: Callable[[mujoco.MjModel], None] = lambda model: None,
) -> Recording:
    """Simulate a robot with a time step of 0.5 ms and log it with noise of 0.3 mrad.

    Args:
      xml: the believed model.
      command: what is commanded.
      seed: of the noise; recordings with seed 1 are held out.
      seconds: duration.
      rate: samples per second.
      start: initial qpos and qvel; None for those of the model.
      edit: makes the real model of the believed one.
    """
    model, believed = mujoco.MjModel.from_xml_string(xml), mujoco.MjModel.from_xml_string(xml)
    edit(model)
    model.opt.timestep, every = 5e-4, round(2000 / rate)
    rng, count = np.random.default_rng(seed), round(2000 * seconds)
    qpos, qvel = (x[::every] for x in stepped(model, command((np.arange(count) + 0.5) * 5e-4), start))
    time = np.arange(len(qpos)) * every * 5e-4
    qpos = integrate(believed, qpos, 3e-4 * rng.normal(size=qvel.shape))
    qvel = qvel + 5e-3 * rng.normal(size=qvel.shape)
    split = "test" if seed == 1 else "fit"
    return Recording(f"r{seed}", time, command(time), qpos, qvel, np.ones(model.nv, bool), split, believed)


def dataset(xml: str, recordings: list[Recording]) -> Dataset:
    """A dataset in memory."""
    model = mujoco.MjModel.from_xml_string(xml)
    return Dataset(Path("robot"), model, Path("robot.xml"), xml, (), tuple(recordings))


def planted(data: Dataset, change: Callable[[dict[str, np.ndarray]], None], measured: bool = True) -> Dataset:
    """A copy whose arrays time, ctrl, qpos, qvel are changed in place by `change`."""
    out = []
    for recording in data.recordings:
        arrays = {name: getattr(recording, name).copy() for name in ("time", "ctrl", "qpos", "qvel")}
        change(arrays)
        known = np.full_like(recording.qvel_measured, measured)
        out.append(dataclasses.replace(recording, **arrays, qvel_measured=known))
    return dataclasses.replace(data, recordings=tuple(out))
