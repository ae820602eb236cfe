"""Systems of many kinds, simulated: without actuators, tossed, driven at sites or by cables, measured in part."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from stepping import stepped

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.data.writing import recording_columns
from btr_mjx.models import integrate

STEP = 1e-4
"""Time step of reality [s]."""

OPTION = '<option timestep="0.002" integrator="implicitfast"/>'
LINKS = """
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.02" armature="0.002"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.6" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.25">
        <joint name="elbow" axis="0 1 0" damping="0.02" armature="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>"""


def _links(rest: str) -> str:
    return f"<mujoco>{OPTION}<worldbody>{LINKS}</worldbody>{rest}</mujoco>"


CUBE = f"""<mujoco>{OPTION}
  <worldbody>
    <geom name="table" type="plane" size="3 3 0.1" friction="1 0.005 0.0001"/>
    <body name="cube" pos="0 0 0.1">
      <freejoint name="cube"/>
      <geom name="cube" type="box" size="0.05 0.05 0.05" mass="0.4" friction="1 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>"""

DRONE = f"""<mujoco>{OPTION}
  <worldbody>
    <body name="frame" pos="0 0 1">
      <freejoint name="frame"/>
      <geom type="box" size="0.1 0.1 0.02" mass="0.5" contype="0" conaffinity="0"/>
      <site name="a" pos="0.1 0.1 0"/><site name="b" pos="-0.1 0.1 0"/>
      <site name="c" pos="-0.1 -0.1 0"/><site name="d" pos="0.1 -0.1 0"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="a" site="a" gear="0 0 1 0 0 0.01"/><motor name="b" site="b" gear="0 0 1 0 0 -0.01"/>
    <motor name="c" site="c" gear="0 0 1 0 0 0.01"/><motor name="d" site="d" gear="0 0 1 0 0 -0.01"/>
  </actuator>
</mujoco>"""

CABLES = _links("""
  <tendon>
    <fixed name="long"><joint joint="shoulder" coef="0.03"/><joint joint="elbow" coef="0.02"/></fixed>
    <fixed name="short"><joint joint="shoulder" coef="0.03"/></fixed>
  </tendon>
  <actuator><motor name="long" tendon="long"/><motor name="short" tendon="short"/></actuator>""")


@dataclass(frozen=True)
class System:
    """A system in which one thing is missing.

    Attributes:
      xml: the believed model.
      change: makes reality of the believed model, in place.
      effect: what is missing, effect@place.
      value: its first parameter.
      start: (qpos, qvel) from a generator; None for rest in the model's reference configuration.
      amplitude, offset: of the commands, sums of two sines.
      sigma: noise of positions and of velocities.
      seconds, rate: of a recording [s], [1/s].
      measured: whether velocities are measured.
    """

    xml: str
    change: Callable[[mujoco.MjModel], None]
    effect: str
    value: float
    start: Callable[[mujoco.MjModel, np.random.Generator], tuple[np.ndarray, np.ndarray]] | None = None
    amplitude: float = 0.0
    offset: float = 0.0
    sigma: tuple[float, float] = (1e-3, 1e-2)
    seconds: float = 1.5
    rate: float = 200.0
    measured: bool = True

    def recording(self, name: str, seed: int, split: str, believed: mujoco.MjModel) -> Recording:
        """A recording of reality."""
        rng = np.random.default_rng(seed)
        model = mujoco.MjModel.from_xml_string(self.xml)
        self.change(model)
        model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICIT
        mujoco.mj_setConst(model, mujoco.MjData(model))
        start = None if self.start is None else self.start(model, rng)
        phase, speed = rng.uniform(0, 6.28, (2, model.nu)), rng.uniform((3, 8), (7, 14), (model.nu, 2)).T

        def ctrl(times: np.ndarray) -> np.ndarray:
            return self.offset + self.amplitude * 0.5 * np.sin(speed * times[:, None, None] + phase).sum(1)

        every = round(1 / self.rate / STEP)
        count = round(self.seconds * self.rate) + 1
        qpos, qvel = (x[::every] for x in stepped(model, ctrl(np.arange((count - 1) * every) * STEP), start))
        qpos = integrate(model, qpos, self.sigma[0] * rng.standard_normal(qvel.shape))
        qvel = qvel + self.sigma[1] * rng.standard_normal(qvel.shape)
        time = np.arange(count) / self.rate
        seen = np.full(model.nv, self.measured)
        return Recording(name, time, ctrl(time), qpos, qvel, seen, split, believed, interpolation="cubic")  # type: ignore[arg-type]

    def dataset(self, fit: int = 3, test: int = 2, seed: int = 0) -> Dataset:
        """Recordings of reality, with the believed model."""
        believed = mujoco.MjModel.from_xml_string(self.xml)
        recordings = tuple(
            self.recording(f"r{i}", 100 * seed + i, "fit" if i < fit else "test", believed) for i in range(fit + test)
        )
        return Dataset(Path("system"), believed, Path("model.xml"), self.xml, (), recordings)


def _swung(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(0.4, 1.2, model.nq) * rng.choice([-1, 1]), np.zeros(model.nv)


def _tossed(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    direction = rng.uniform(0, 6.28)
    speed = rng.uniform(0.8, 1.8)
    qpos = np.r_[0, 0, rng.uniform(0.08, 0.15), rng.normal(size=4) * 0.15 + [1, 0, 0, 0]]
    qpos[3:] /= np.linalg.norm(qpos[3:])
    return qpos, np.r_[speed * np.cos(direction), speed * np.sin(direction), 0.2, rng.normal(size=3)]


def _hovering(model: mujoco.MjModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return model.qpos0.copy(), 0.1 * rng.standard_normal(model.nv)


def _set(name: str, index: object, value: float) -> Callable[[mujoco.MjModel], None]:
    def change(model: mujoco.MjModel) -> None:
        getattr(model, name)[index] += value

    return change


SYSTEMS: Mapping[str, System] = {
    "free swing": System(
        _links(""), _set("dof_frictionloss", 0, 0.008), "dry_friction@joint:shoulder", 0.008, start=_swung
    ),
    "toss": System(
        CUBE,
        _set("geom_friction", (slice(None), 0), 0.18 - 1.0),
        "ground_friction@world",
        0.18,
        start=_tossed,
        sigma=(1e-3, 0.05),
        seconds=0.8,
    ),
    "torque control": System(
        _links('<actuator><motor joint="shoulder" gear="2"/><motor joint="elbow"/></actuator>'),
        _set("dof_damping", 1, 0.02),
        "viscous_damping@joint:elbow",
        0.02,
        amplitude=0.5,
    ),
    "velocity control": System(
        _links('<actuator><velocity joint="shoulder" kv="1"/><velocity joint="elbow" kv="0.5"/></actuator>'),
        _set("dof_frictionloss", 1, 0.05),
        "dry_friction@joint:elbow",
        0.05,
        amplitude=3.0,
    ),
    "drone": System(
        DRONE,
        _set("actuator_gainprm", (2, 0), -0.1),
        "actuator_gain@actuator:c",
        -0.1,
        start=_hovering,
        amplitude=0.2,
        offset=0.5 * 9.81 / 4,
        seconds=0.8,
    ),
    "cables": System(
        CABLES,
        _set("actuator_gainprm", (0, 0), -0.1),
        "actuator_gain@actuator:long",
        -0.1,
        amplitude=20.0,
    ),
}


PASSIVE_ELBOW = System(
    _links('<actuator><motor joint="shoulder" gear="2"/></actuator>'),
    _set("dof_damping", 1, 0.02),
    "viscous_damping@joint:elbow",
    0.02,
    amplitude=0.5,
)
"""A motor at the shoulder; the elbow moves by itself."""


def without_encoder(recording: Recording, joint: str) -> dict[str, np.ndarray]:
    """Columns of a recording without those of a joint."""
    return {n: v for n, v in recording_columns(recording).items() if n not in (f"qpos/{joint}", f"qvel/{joint}")}
