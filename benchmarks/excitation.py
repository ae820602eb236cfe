"""How alike two effects look in a recording: the table of docs/excitation.md.

    uv run python benchmarks/excitation.py

An arm of two joints with position servos follows commands of several kinds. The signature of an effect is how the
residuals change with its first parameter, starting states of windows projected out. Printed is, for pairs of effects
and kinds of recordings, the absolute cosine of their signatures: 1 means that these recordings cannot tell one from the
other as long as both are small, 0 that they have nothing in common.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from btr_mjx.gap.data import Recording, make_recording
from btr_mjx.gap.effects import EFFECTS, Candidate, candidates
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import MakeWorld, Span, Windows, linearise, prepare, scales_of, signatures

ARM = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <geom type="capsule" size="0.02" contype="0" conaffinity="0"/>
    <joint axis="0 1 0" damping="0.05" armature="0.005"/>
    <position kp="30" kv="1.5"/>
  </default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder"/>
      <geom fromto="0 0 0 0 0 -0.3" mass="0.8"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow"/>
        <geom name="fore" fromto="0 0 0 0 0 -0.25" mass="{mass}"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="shoulder" joint="shoulder"/><position name="elbow" joint="elbow"/></actuator>
</mujoco>"""
INTERVAL, DURATION, WINDOW, WINDOWS = 0.004, 4.0, 75, 12
SIGMA = np.repeat([5e-4, 5e-3], 2)
"""Noise of positions [rad] and velocities [rad/s]."""

PAIRS = (
    ("viscous_damping@joint:shoulder", "dry_friction@joint:shoulder"),
    ("viscous_damping@joint:shoulder", "air_drag@world"),
    ("dry_friction@joint:shoulder", "load_friction@joint:shoulder"),
    ("dry_friction@joint:shoulder", "stribeck_friction@joint:shoulder"),
    ("dry_friction@joint:shoulder", "backlash@joint:shoulder"),
    ("backlash@joint:shoulder", "actuator_delay@actuator:shoulder"),
    ("actuator_delay@actuator:shoulder", "actuator_lag@actuator:shoulder"),
    ("armature@joint:shoulder", "actuator_gain@actuator:shoulder"),
    ("armature@joint:shoulder", "payload@body:upper"),
    ("actuator_gain@actuator:shoulder", "payload@body:upper"),
    ("actuator_gain@actuator:elbow", "payload@body:fore"),
    ("payload@body:upper", "link_length@body:upper"),
    ("payload@body:fore", "link_length@body:fore"),
    ("joint_stiffness@joint:shoulder", "joint_offset@joint:shoulder"),
    ("constant_force@body:fore", "ground_slope@world"),
)


def commands() -> dict[str, np.ndarray]:
    """Commands (K, 2) [rad] by kind."""
    time, rng = np.arange(0, DURATION, INTERVAL), np.random.default_rng(0)

    def sines(frequencies: Sequence[float], amplitudes: Sequence[float]) -> np.ndarray:
        phases = rng.uniform(0, 2 * np.pi, (2, len(frequencies)))
        waves = np.sin(2 * np.pi * np.array(frequencies) * time[:, None, None] + phases)
        return waves @ np.array(amplitudes)

    def ramps(knots: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, at, own) for own in knots.T], axis=1)

    turns = np.arange(0, DURATION + 1, 1.0)
    bends = np.array([0, 1.2, 1.6, 1.9, 2.7, 2.9, 3.5, DURATION])  # the way between is fast, slow, or a stop
    return {
        "one sine": sines([1.0], [0.6]),
        "one speed": ramps(np.stack([0.7 * (-1.0) ** np.arange(len(turns))] * 2, axis=1), turns),
        "ramps, stops": ramps(np.array([[0, 0.7, 0.7, -0.7, -0.7, 0.4, -0.2, 0.6]] * 2).T, bends),
        "sines": sines([0.5, 1.3, 3.1], [0.4, 0.3, 0.15]),
        "steps": np.repeat(rng.uniform(-0.8, 0.8, (8, 2)), len(time) // 8, axis=0),
    }


def arm(mass: float) -> mujoco.MjModel:
    """The arm with a forearm of some mass [kg]; body_simple is 0, since effects edit inertia."""
    spec = mujoco.MjSpec.from_string(ARM.format(mass=mass))
    for body in spec.bodies:
        body.simple = 0
    return spec.compile()


def record(model: mujoco.MjModel, command: np.ndarray, name: str) -> Recording:
    """A recording without noise of the arm that follows a command (K, 2)."""
    time, data = np.arange(len(command)) * INTERVAL, mujoco.MjData(model)
    data.qpos[:], rows = command[0], []
    for k in range(len(time)):
        rows.append([*data.qpos, *data.qvel])
        for step in range(round(INTERVAL / model.opt.timestep)):
            now = time[k] + step * model.opt.timestep
            data.ctrl[:] = [np.interp(now, time, own) for own in command.T]
            mujoco.mj_step(model, data)
    joints = ("shoulder", "elbow")
    names = [f"{kind}/{joint}" for kind in ("qpos", "qvel") for joint in joints]
    columns = dict(zip(names, np.array(rows).T, strict=True)) | {
        f"ctrl/{j}": own for j, own in zip(joints, command.T, strict=True)
    }
    return make_recording({"time": time} | columns, model, "benchmark", name)


def cosines(recordings: Sequence[Recording]) -> list[float]:
    """Absolute cosines of the signatures of `PAIRS`."""
    data = prepare(recordings, SIGMA, Span(3, 6))
    first = np.linspace(4, min(len(r.time) for r in recordings) - WINDOW - 6, WINDOWS).astype(int)
    of = np.repeat(np.arange(len(recordings)), WINDOWS)
    windows = Windows(data, of, np.tile(first, len(recordings)), WINDOW)
    windows = linearise(windows, World.of, steps=2)
    found = {own.name: own for own in candidates(recordings[0].model, scales_of(data), EFFECTS)}
    names = sorted({name for pair in PAIRS for name in pair})
    flat = signatures(windows, World.of, [_with(found[name]) for name in names], False).reshape(len(names), -1)
    unit = dict(zip(names, flat.astype(float) / np.linalg.norm(flat, axis=1, keepdims=True), strict=True))
    return [abs(float(unit[a] @ unit[b])) for a, b in PAIRS]


def _with(candidate: Candidate) -> MakeWorld:
    values = np.array(candidate.null, float)
    values[0] += candidate.parameters[0].step
    return lambda model: candidate.apply(World.of(model), values)


def table() -> Mapping[str, list[float]]:
    """Cosines by kind of recordings."""
    light, heavy = arm(0.5), arm(1.0)
    kinds = {name: record(light, command, name) for name, command in commands().items()}
    loaded = [record(heavy, commands()[name], f"{name}, loaded") for name in ("sines", "steps")]
    columns = {name: [recording] for name, recording in kinds.items()}
    columns["all"] = list(kinds.values())
    columns["all, payload"] = [*kinds.values(), *loaded]
    return {name: cosines(recordings) for name, recordings in columns.items()}


def main() -> None:
    """Print the table as Markdown."""
    found = table()
    print("| | | " + " | ".join(found) + " |")
    print("|" + "---|" * (2 + len(found)))
    for i, (a, b) in enumerate(PAIRS):
        print(f"| `{a}` | `{b}` | " + " | ".join(f"{values[i]:.2f}" for values in found.values()) + " |")


if __name__ == "__main__":
    main()
