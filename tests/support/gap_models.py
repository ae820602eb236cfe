"""Models with every kind of place for an effect, and plain loops to hold effects against."""

import copy

import mujoco
import numpy as np

from btr_mjx.gap.effects import EFFECTS, Candidate, Effect, Scales, candidates
from btr_mjx.gap.simulate import Command, Segments, World, simulate
from btr_mjx.robots import hexapod

PENDULUM = """
<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="servo" axis="0 1 0" damping="0.01" armature="0.002" frictionloss="0.01"
        range="-170 170" stiffness=".1"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.15" size="0.005" mass="0.02"/>
      <geom name="weight" type="sphere" pos="0 0 -0.15" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="servo" kp="5" dampratio="0.7" forcerange="-2 2"/></actuator>
</mujoco>
"""

QUADRUPED = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom friction="0.9" density="500"/><joint damping="0.2"/><position kp="60" kv="1.5"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" friction="0.6"/>
    <body name="torso" pos="0 0 0.42">
      <freejoint/>
      <geom type="box" size="0.2 0.08 0.04"/>
      <body name="head" pos="0.25 0 0.02"><geom type="sphere" size="0.05"/></body>
      <body name="thigh0" pos="0.18 0.1 0">
        <joint name="hip0" axis="0 1 0"/>
        <geom type="box" size="0.02 0.02 0.1" pos="0 0 -0.1"/>
        <body name="shank0" pos="0 0 -0.2">
          <joint name="knee0" axis="0 1 0" range="-2 0.5" limited="true"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.015"/>
          <geom name="foot0" type="sphere" pos="0 0 -0.2" size="0.02" friction="1.1" solref="0.01 1"/>
          <site name="tip" pos="0 0 -0.2"/>
        </body>
      </body>
      <body name="thigh1" pos="-0.18 0 0">
        <joint name="hip1" axis="0 1 0"/>
        <inertial pos="0.01 0 -0.1" mass="0.4" diaginertia="0.002 0.002 0.0004"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/>
        <body name="shank1" pos="0 0 -0.2">
          <joint name="knee1" axis="0 1 0"/>
          <geom name="foot1" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip0" joint="hip0"/><position name="knee0" joint="knee0" forcerange="-30 30"/>
    <motor name="hip1" joint="hip1" gear="5"/><position name="knee1" joint="knee1"/>
  </actuator>
</mujoco>
"""


def hexapod_xml(**lengths: float) -> str:
    robot = hexapod()
    values = dict(zip(robot.simulation_box.names, robot.nominal, strict=True)) | lengths
    return robot.render(list(values.values()))


MODELS = {"pendulum": PENDULUM, "quadruped": QUADRUPED, "hexapod": hexapod_xml()}


def load(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODELS[name])


def one(model: mujoco.MjModel, name: str, effects: tuple[Effect, ...] = EFFECTS) -> Candidate:
    found = {c.name: c for c in candidates(model, Scales.of(model), effects)}
    return found[name]


def moderate(candidate: Candidate) -> np.ndarray:
    """Values a few steps away from the null, inside the bounds."""
    low, high, step = (np.array([getattr(p, a) for p in candidate.parameters]) for a in ("low", "high", "step"))
    return np.clip(candidate.null + 2.5 * step, low, high)


def inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    return turn @ np.diag(model.body_inertia[body]) @ turn.T


def windows(model: mujoco.MjModel, seed: int = 0, count: int = 4, length: float = 0.06) -> Segments:
    rng = np.random.default_rng(seed)
    times = np.linspace(0, 1, 60)
    phase, speed = rng.uniform(0, 6, model.nu), rng.uniform(8, 20, model.nu)
    sent = Command(times, 0.4 * np.sin(np.outer(times, speed) + phase), "cubic")
    qpos = np.tile(model.qpos0, (count, 1))
    scalar = model.jnt_qposadr[model.jnt_type >= 2]
    qpos[:, scalar] += rng.uniform(-0.2, 0.2, (count, len(scalar)))
    qvel = rng.normal(size=(count, model.nv)) * (
        1.0 if model.jnt_type[0] else np.r_[np.zeros(6), np.ones(model.nv - 6)]
    )
    start = rng.uniform(0, 0.8, count)
    return Segments(start, qpos, qvel, np.array([0.5 * length, length]), (sent,), np.zeros(count, int))


def loop(model: mujoco.MjModel, segments: Segments, row: int, act, steps: int) -> np.ndarray:
    """The equation by hand: act(model, data, command at mid-step) is called before every step."""
    model = copy.copy(model)
    data = mujoco.MjData(model)
    data.time, data.qpos[:], data.qvel[:] = segments.start[row], segments.qpos[row], segments.qvel[row]
    for k in range(steps):
        t = segments.start[row] + k * model.opt.timestep
        data.ctrl[:] = segments.commands[0].at(t)
        if k == 0:
            mujoco.mj_forward(model, data)
        act(model, data, t)
        mujoco.mj_step(model, data)
    return np.r_[data.qpos, data.qvel]


def check_loop(model: mujoco.MjModel, candidate: Candidate, values: list[float], act) -> None:
    segments = windows(model)
    states, plain = simulate([(candidate.apply(World.of(model), values), segments), (World.of(model), segments)])
    assert np.abs(states - plain).max() > 1e-4
    for row in range(len(segments)):
        np.testing.assert_allclose(states[row, -1], loop(model, segments, row, act, 60), rtol=0, atol=1e-7)


def command(seed: int, interpolation: str = "linear") -> Command:
    """Two controls, noise at uneven times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.003, 0.02, 40))
    return Command(times, rng.normal(size=(40, 2)), interpolation)  # type: ignore[arg-type]
