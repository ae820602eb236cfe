"""Robots of `field_cases.py`: what a user believes of them, and how they are moved.

A robot is MJCF text, a reference over time, and a controller where its motors take torques. Nothing here is shared with
the robots of `robots.py`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

GRAVITY = 9.81
Reference = Callable[[np.ndarray], np.ndarray]
"""From times (K,) [s] to references (K, n)."""
Controller = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From a reference (n,), measured qpos (nq,) and qvel (nv,) to commands (nu,)."""


@dataclass(frozen=True)
class FieldRobot:
    """A robot as its user believes it to be.

    Attributes:
      name: kind of the robot.
      xml: MJCF of the believed model.
      reference: makes the reference of one recording.
      controller: torques from the reference; None where the reference is the command.
      noise: 1 sigma of measured positions [rad, m], of a free body's position [m] and of its orientation [rad].
      rates: sampling rates that its logs have [Hz].
      servos: whether the motors are position servos.
      step: time step of the real robot [s].
    """

    name: str
    xml: str
    reference: Callable[[np.random.Generator], Reference]
    controller: Controller | None = None
    noise: tuple[float, float, float] = (2e-4, 5e-4, 1e-3)
    rates: tuple[int, ...] = (100, 125, 200, 250)
    servos: bool = True
    step: float = 1e-4


def _waves(rng: np.random.Generator, centre: np.ndarray, reach: np.ndarray, fastest: float) -> Reference:
    """Sums of three sines about a centre, which begin smoothly."""
    n = len(centre)
    frequency = rng.uniform(0.15, fastest, (3, n))
    size = rng.uniform(0.3, 1.0, (3, n)) * reach / (1 + frequency)
    phase = rng.uniform(0, 2 * np.pi, (3, n))

    def reference(times: np.ndarray) -> np.ndarray:
        t = times[:, None, None]
        begin = 1 - np.exp(-np.maximum(times, 0.0) / 0.15)
        return centre + begin[:, None] * (size * np.sin(2 * np.pi * frequency * t + phase)).sum(1)

    return reference


def _moves(rng: np.random.Generator, centre: np.ndarray, reach: np.ndarray) -> Reference:
    """Moves between random points along quintic polynomials, with rests."""
    starts, seconds, points = [0.2], list[float](), [centre]
    while starts[-1] < 60.0:
        seconds.append(float(rng.uniform(0.5, 1.3)))
        points.append(centre + reach * rng.uniform(-1, 1, len(centre)))
        starts.append(starts[-1] + seconds[-1] + float(rng.uniform(0.0, 0.3)))
    begin, length, at = np.array(starts[:-1]), np.array(seconds), np.array(points)

    def reference(times: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(begin, times, "right") - 1, 0, len(begin) - 1)
        s = np.clip((times - begin[k]) / length[k], 0.0, 1.0)[:, None]
        return at[k] + (at[k + 1] - at[k]) * (10 * s**3 - 15 * s**4 + 6 * s**5)

    return reference


def _mixed(centre: Sequence[float], reach: Sequence[float], fastest: float) -> Callable[..., Reference]:
    middle, wide = np.array(centre, float), np.array(reach, float)

    def make(rng: np.random.Generator) -> Reference:
        return _moves(rng, middle, wide) if rng.random() < 0.4 else _waves(rng, middle, wide, fastest)

    return make


def _document(bodies: str, actuators: str, step: float = 0.002) -> str:
    return (
        f'<mujoco><compiler angle="radian" autolimits="true"/><option timestep="{step}" integrator="implicitfast"/>\n'
        f'<default><geom contype="0" conaffinity="0"/></default>\n'
        f"<worldbody>\n{bodies}\n</worldbody>\n<actuator>\n{actuators}\n</actuator></mujoco>\n"
    )


def _inertia(bodies: str) -> tuple[np.ndarray, np.ndarray]:
    """Diagonal of the mass matrix, and the largest force of gravity, of hinges and slides."""
    model = mujoco.MjModel.from_xml_string(_document(bodies, ""))
    data = mujoco.MjData(model)
    weight = np.zeros(model.nv)
    for angle in np.linspace(-1.5, 1.5, 7):
        data.qpos[:] = angle
        mujoco.mj_forward(model, data)
        weight = np.maximum(weight, np.abs(data.qfrc_bias))
    return model.dof_M0.copy(), weight


def _chain(rng: np.random.Generator, names: Sequence[str], axes: Sequence[str]) -> str:
    """Links one after another, each lighter than the last."""
    text, place = "", "0 0 0.4"
    for i, (name, axis) in enumerate(zip(names, axes, strict=True)):
        length, mass = rng.uniform(0.12, 0.26) * 0.88**i, rng.uniform(0.5, 1.2) * 0.65**i
        rotor = rng.uniform(0.004, 0.015) * 0.8**i
        text += (
            f'<body name="{name}_link" pos="{place}"><joint name="{name}" axis="{axis}" damping="'
            f'{rng.uniform(0.04, 0.15) * 0.8**i:.4f}" armature="{rotor:.5f}" frictionloss="'
            f'{rng.uniform(0.02, 0.06) * 0.8**i:.4f}"/>'
            f'<geom type="capsule" fromto="0 0 0 {length:.4f} 0 0" size="{0.025 - 0.003 * i:.4f}" mass="{mass:.4f}"/>\n'
        )
        place = f"{length:.4f} 0 0"
    return text + "</body>" * len(names)


def arm(rng: np.random.Generator) -> FieldRobot:
    """An arm of three to five joints with position servos."""
    names = ["turret", "shoulder", "elbow", "forearm", "wrist"][: int(rng.integers(3, 6))]
    axes = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0"][: len(names)]
    bodies = _chain(rng, names, axes)
    inertia, weight = _inertia(bodies)
    fast = 2 * np.pi * rng.uniform(3.5, 7.0, len(names))
    kp = np.maximum(inertia * fast**2, weight / 0.25)
    kv = 2 * rng.uniform(0.3, 0.7, len(names)) * np.sqrt(kp * inertia)
    actuators = "\n".join(
        f'<position name="{name}" joint="{name}" kp="{p:.4g}" kv="{v:.4g}"/>'
        for name, p, v in zip(names, kp, kv, strict=True)
    )
    reference = _mixed(rng.uniform(-0.4, 0.4, len(names)).tolist(), [0.7] * len(names), 1.6)
    return FieldRobot("arm", _document(bodies, actuators), reference)


def torque_arm(rng: np.random.Generator) -> FieldRobot:
    """An arm of two links in a vertical plane, whose motors take torques from a controller with position feedback."""
    bodies = _chain(rng, ["upper", "lower"], ["0 1 0", "0 1 0"])
    inertia, weight = _inertia(bodies)
    fast = 2 * np.pi * rng.uniform(2.0, 3.5, 2)
    kp = np.maximum(inertia * fast**2, 2 * weight)
    kd = 1.2 * np.sqrt(kp * inertia)
    actuators = "\n".join(f'<motor name="{n}" joint="{n}"/>' for n in ("upper", "lower"))

    def controller(reference: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        return np.clip(kp * (reference - qpos) - kd * qvel, -6 * weight, 6 * weight)

    reference = _mixed([float(rng.uniform(0.2, 0.9)), float(rng.uniform(-0.5, 0.5))], [0.8, 0.8], 1.4)
    return FieldRobot(
        "torque_arm", _document(bodies, actuators), reference, controller, rates=(200, 250, 500), servos=False
    )


def pendulum(rng: np.random.Generator) -> FieldRobot:
    """A pendulum with a motor that takes torques."""
    length, mass = rng.uniform(0.15, 0.35), rng.uniform(0.2, 0.8)
    bodies = (
        f'<body name="rod" pos="0 0 1"><joint name="pivot" axis="0 1 0" damping="{rng.uniform(0.01, 0.04):.4f}" '
        f'armature="{rng.uniform(0.001, 0.004):.5f}" frictionloss="{rng.uniform(0.005, 0.02):.4f}"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 {-length:.4f}" size="0.008" mass="0.1"/>'
        f'<geom type="sphere" pos="0 0 {-length:.4f}" size="0.03" mass="{mass:.4f}"/></body>'
    )
    peak = 0.45 * mass * GRAVITY * length
    reference = _mixed([0.0], [peak], 1.6)
    actuators = '<motor name="pivot" joint="pivot"/>'
    return FieldRobot("pendulum", _document(bodies, actuators), reference, rates=(100, 200, 250, 500), servos=False)


def gantry(rng: np.random.Generator) -> FieldRobot:
    """A gantry of three slides with position servos, of which the last one lifts."""
    names, axes = ("bridge", "trolley", "lift"), ("1 0 0", "0 1 0", "0 0 1")
    mass = rng.uniform((4.0, 1.5, 0.6), (7.0, 3.0, 1.2))
    bodies = "".join(
        f'<body name="{name}_body" pos="0 0 {0.8 if i == 0 else 0}"><joint name="{name}" type="slide" axis="{axis}" '
        f'damping="{rng.uniform(8, 20) * (0.7**i):.3f}" armature="{rng.uniform(0.2, 0.6):.3f}" '
        f'frictionloss="{rng.uniform(0.5, 1.5) * (0.7**i):.3f}"/>'
        f'<geom type="box" size="0.05 0.05 0.05" mass="{m:.4f}"/>\n'
        for i, (name, axis, m) in enumerate(zip(names, axes, mass, strict=True))
    )
    bodies += "</body></body></body>"
    inertia, _ = _inertia(bodies)
    kp = inertia * (2 * np.pi * rng.uniform(4.0, 7.0, 3)) ** 2
    kv = 2 * rng.uniform(0.3, 0.7, 3) * np.sqrt(kp * inertia)
    actuators = "\n".join(
        f'<position name="{name}" joint="{name}" kp="{p:.5g}" kv="{v:.4g}"/>'
        for name, p, v in zip(names, kp, kv, strict=True)
    )
    reference = _mixed([0.0, 0.0, 0.0], [0.25, 0.2, 0.12], 1.5)
    return FieldRobot("gantry", _document(bodies, actuators), reference, noise=(5e-5, 5e-4, 1e-3))


def drone(rng: np.random.Generator) -> FieldRobot:
    """A free body with four thrusters and a controller that keeps it in the air."""
    mass, half = float(rng.uniform(0.6, 1.4)), float(rng.uniform(0.1, 0.18))
    size = mass * half**2 * np.array([0.35, 0.35, 0.6])
    corners = [(half, -half, 1), (half, half, -1), (-half, half, 1), (-half, -half, -1)]
    sites = "".join(f'<site name="hub{i}" pos="{x:.4f} {y:.4f} 0.02"/>' for i, (x, y, _) in enumerate(corners))
    inertia = " ".join(f"{value:.6f}" for value in size)
    bodies = (
        f'<body name="hull" pos="0 0 1"><freejoint name="base"/><inertial pos="0 0 0" mass="{mass:.4f}" '
        f'diaginertia="{inertia}"/><geom type="box" size="{half:.3f} {half:.3f} 0.03"/>{sites}</body>'
    )
    spin, most = 0.02, mass * GRAVITY
    actuators = "\n".join(
        f'<motor name="rotor{i}" site="hub{i}" gear="0 0 1 0 0 {spin * s}" ctrlrange="0 {most:.3f}"/>'
        for i, (_, _, s) in enumerate(corners)
    )
    share = np.linalg.inv(np.array([[1, y, -x, spin * s] for x, y, s in corners]).T)

    def controller(reference: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        place, yaw = reference[:3], reference[3]
        wish = 6.0 * (place - qpos[:3]) - 4.0 * qvel[:3] + (0.0, 0.0, GRAVITY)
        turn = 2 * qpos[4:7] * np.sign(qpos[3])
        tilt = np.clip(np.array([-wish[1], wish[0]]) / GRAVITY, -0.4, 0.4)
        torque = size * (120.0 * (np.array([*tilt, yaw]) - turn) - 18.0 * qvel[3:6])
        return np.clip(share @ np.array([mass * wish[2], *torque]), 0.0, most)

    def reference(rng: np.random.Generator) -> Reference:
        return _waves(rng, np.array([0.0, 0.0, 1.0, 0.0]), np.array([0.8, 0.8, 0.4, 0.5]), 0.9)

    text = _document(bodies, actuators)
    return FieldRobot("drone", text, reference, controller, rates=(200, 250, 500), servos=False)


def legged(rng: np.random.Generator) -> FieldRobot:
    """A robot on four legs of two joints each, which trots on flat ground."""
    bodies = '<geom name="ground" type="plane" size="20 20 1" contype="1" conaffinity="1" friction="0.8"/>'
    bodies += '<body name="hull" pos="0 0 0.345"><freejoint name="base"/>'
    bodies += f'<geom type="box" size="0.2 0.1 0.04" mass="{rng.uniform(4, 7):.3f}"/>'
    names = list[str]()
    for leg, x, y in (("lf", 1, 1), ("rf", 1, -1), ("lh", -1, 1), ("rh", -1, -1)):
        joint = 'axis="0 1 0" damping="0.4" armature="0.01" frictionloss="0.1"'
        bodies += (
            f'\n<body name="{leg}_thigh" pos="{0.18 * x} {0.12 * y} 0"><joint name="{leg}_hip" {joint}/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 -0.16" size="0.02" mass="0.5"/>'
            f'<body name="{leg}_shank" pos="0 0 -0.16"><joint name="{leg}_knee" {joint}/>'
            f'<geom type="capsule" fromto="0 0 0 0 0 -0.16" size="0.015" mass="0.2"/>'
            f'<geom name="{leg}_foot" type="sphere" pos="0 0 -0.16" size="0.022" mass="0.05" contype="1" '
            f'conaffinity="1" friction="0.8"/></body></body>'
        )
        names += [f"{leg}_hip", f"{leg}_knee"]
    bodies += "</body>"
    actuators = "\n".join(f'<position name="{n}" joint="{n}" kp="60" kv="1.5" forcerange="-18 18"/>' for n in names)

    def reference(rng: np.random.Generator) -> Reference:
        rate, swing, lift = rng.uniform(1.2, 2.2), rng.uniform(0.12, 0.25), rng.uniform(0.15, 0.35)
        legs = np.array([0.0, np.pi, np.pi, 0.0]) + rng.uniform(-0.2, 0.2, 4)

        def at(times: np.ndarray) -> np.ndarray:
            phase = 2 * np.pi * rate * times[:, None] + legs
            begin = (1 - np.exp(-np.maximum(times, 0.0) / 0.2))[:, None]
            hip = 0.45 + begin * swing * np.sin(phase)
            knee = -0.9 - begin * lift * np.maximum(np.cos(phase), 0.0)
            return np.stack([hip, knee], 2).reshape(len(times), -1)

        return at

    return FieldRobot("legged", _document(bodies, actuators), reference, rates=(250, 500))


ROBOTS: dict[str, Callable[[np.random.Generator], FieldRobot]] = {
    "arm": arm,
    "torque_arm": torque_arm,
    "pendulum": pendulum,
    "gantry": gantry,
    "drone": drone,
    "legged": legged,
}
"""Robots by name."""
