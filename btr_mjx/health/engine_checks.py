"""Checks that load JAX and MuJoCo, in a process of their own that `btr_mjx.health.installation_checks` starts.

    python -m btr_mjx.health.engine_checks NAME ...

A broken library may abort its process or hang. Each result is printed as soon as it is there, one line of JSON behind
`MARK`, so that a check that ends the process does not take the earlier ones along.
"""

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from btr_mjx.health.installation_checks import MARK, CheckResult, run_check

TOLERANCE = {"float32": 1e-4, "float64": 1e-8}
"""Accepted difference between an engine and native MuJoCo, by the engine's precision [m, rad].

Over the few tenths of a second that are simulated, rounding errors stay a hundred times below.
"""

LEAST_RATIO = 2.0
"""Speed of `lanes` over native MuJoCo below which a check warns; 5 to 13 is usual (`benchmarks/throughput.py`)."""

TIMED_STEPS = 340
"""Steps of a trial whose speed is measured."""

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 {{ height }}">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.05" frictionloss="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1"/>
      <body pos="0 0 -0.3">
        <joint name="elbow" type="hinge" axis="0 1 0" damping="0.05" limited="true" range="-40 40"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="shoulder" kp="20" kv="0.5"/>
    <position joint="elbow" kp="10" kv="0.2"/>
  </actuator>
</mujoco>
"""
"""What the hexapod does not have: a fixed base, dry friction, a limit, position servos, another integrator."""


def check_devices() -> CheckResult:
    """Devices that JAX sees: warning where it does not use an NVIDIA GPU of this machine."""
    import jax

    from btr_mjx.engines import use_all_cores

    use_all_cores()
    found = jax.devices()
    text = f"{len(found)} x {found[0].platform} ({found[0].device_kind})"
    if found[0].platform == "cpu" and Path("/dev/nvidia0").exists():
        remedy = "to use it: pip install 'jax[cuda13]'; the engine lanes runs on the CPU without it"
        return CheckResult("warning", f"{text}, but there is an NVIDIA GPU", remedy)
    return CheckResult("ok", text)


def check_engines() -> CheckResult:
    """Off where an engine's motion differs from native MuJoCo's beyond `TOLERANCE`, or is not finite."""
    precision, differences = engine_differences()
    shown = ", ".join(f"{name} {value:.1e}" for name, value in differences.items())
    if all(value <= TOLERANCE[precision] for value in differences.values()):  # NaN counts as too far
        return CheckResult("ok", f"against native, {precision}: {shown}")
    text = f"{shown} from native MuJoCo, expected at most {TOLERANCE[precision]:g}"
    return CheckResult("off", text, "remove XLA_FLAGS; use --engine native; report it with the output of this command")


def engine_differences() -> tuple[str, Mapping[str, float]]:
    """Precision, and by engine and robot the greatest difference from native MuJoCo: of positions [m] or angles [rad].

    A few pairs of two robots are simulated on every engine; mjx, which compiles slowly, gets the smaller one only.
    """
    import jax
    import numpy as np

    from btr_mjx.evaluation import Engine, evaluate
    from btr_mjx.robots import Box, Robot, hexapod

    arm = Robot(
        name="arm",
        template=ARM,
        template_path="arm.xml.j2",
        simulation_box=Box(["height"], [0.9], [1.1]),
        controller_box=Box(["a_1", "phi_1", "a_2", "phi_2"], [0.1, 0.0] * 2, [1.0, 3.0] * 2),
        signal=lambda c, time, xp: c[0::2] * xp.sin(10.0 * time + c[1::2]),
        nominal=(1.0,),
        base_body=None,
        duration=0.4,
    )

    def motion(robot: Robot, engine: Engine) -> np.ndarray:
        rng, states = np.random.default_rng(0), robot is arm
        s, c = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 3)
        times = [0.4 if states else 0.1]
        outcome = evaluate(robot, s, c, engine=engine, pairwise=True, times=times, states=states).outcome
        return np.asarray(outcome.qpos if states else outcome.position)

    pairs: list[tuple[Robot, Engine]] = [(arm, "lanes"), (arm, "mjx"), (hexapod(), "lanes")]
    found = {
        f"{engine} {robot.name}": float(np.abs(motion(robot, engine) - motion(robot, "native")).max())
        for robot, engine in pairs
    }
    return "float64" if jax.config.read("jax_enable_x64") else "float32", found


def check_speed() -> CheckResult:
    """Speed of `lanes` and of native MuJoCo: warning where `lanes` on the CPU is below `LEAST_RATIO` times native.

    A ratio compares both engines under the same load; a rate alone cannot tell a busy machine from a slow one.
    """
    import jax

    lanes, native = engine_speeds()
    text = f"hexapod, steps/s: lanes {lanes:,.0f}, native {native:,.0f}, ratio {lanes / native:.1f}"
    if jax.default_backend() == "cpu" and lanes < LEAST_RATIO * native:
        remedy = "install the versions of uv.lock (uv sync), remove XLA_FLAGS, or let other work end"
        return CheckResult("warning", f"{text}, expected at least {LEAST_RATIO:g}", remedy)
    return CheckResult("ok", text)


def engine_speeds() -> tuple[float, float]:
    """Steps per second of the hexapod with `lanes` and with native MuJoCo, the best of three rounds."""
    import numpy as np

    from btr_mjx.evaluation import Engine, evaluate
    from btr_mjx.robots import hexapod
    from btr_mjx.runs import available_cores

    robot, cores, rng = hexapod(), available_cores(), np.random.default_rng(0)
    s = robot.simulation_box.sample(rng, 4)
    pairs: Mapping[Engine, int] = {"lanes": 256 * cores, "native": 32 * cores}
    rates: dict[str, list[float]] = {engine: [] for engine in pairs}
    for number in range(4):
        for engine, count in pairs.items():
            c = robot.controller_box.sample(rng, count // len(s))
            start = time.perf_counter()
            evaluate(robot, s, c, engine=engine, times=[TIMED_STEPS * 5e-4])
            if number:  # the first round compiles
                rates[engine].append(count * TIMED_STEPS / (time.perf_counter() - start))
    return max(rates["lanes"]), max(rates["native"])


_FUNCTIONS: Mapping[str, Any] = {"devices": check_devices, "engines": check_engines, "speed": check_speed}


def main(names: Sequence[str]) -> None:
    """Run checks and print one line of JSON for each."""
    for name in names:
        print(MARK + json.dumps({name: asdict(run_check(_FUNCTIONS[name]))}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
