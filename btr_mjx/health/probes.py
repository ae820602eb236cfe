"""Measures what needs JAX, MuJoCo or OpenGL, in a process of its own that `btr_mjx.health.child` starts.

    python -m btr_mjx.health.probes SECTION ...

A broken library may abort its process or hang. Each section's measurements are printed as soon as they are there, one
line of JSON behind `MARK`, so that a section that ends the process does not take the earlier ones along.
"""

import json
import os
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from btr_mjx.errors import one_line
from btr_mjx.health.child import MARK

TIMED_STEPS = 340
"""Steps of a trial whose speed is measured."""

CHUNKS_PER_DEVICE = 4
"""Chunks of 64 pairs that each device runs where the speed of `lanes` is measured."""

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


def devices() -> dict[str, Any]:
    """Devices that JAX sees and the target features of the programs that it compiles for the CPU."""
    import jax
    import jax.numpy as jnp

    from btr_mjx.engines import use_all_cores

    use_all_cores()
    found = jax.devices()
    features = ""
    if found[0].platform == "cpu":
        options = {"xla_cpu_prefer_vector_width": "512"}
        compiled = jax.jit(lambda x: jnp.sin(x) * x, compiler_options=options).lower(jnp.ones(64)).compile()
        binary = compiled.runtime_executable().serialize().decode("latin-1")  # type: ignore[union-attr]
        features = max(re.findall(r"[+-][\w.,+-]{8,}", binary), key=len, default="")
    return {
        "platform": found[0].platform,
        "count": len(found),
        "kind": found[0].device_kind,
        "features": features,
    }


def cache(token: str, process: str) -> dict[str, Any]:
    """Compile a small program with the cache of compiled programs.

    Args:
      token: the program's name, and so part of the names of its files in the cache.
      process: label of this process, since two measure the same.

    Returns:
      enabled, folder (None where there is none) and hit: whether the program came from the cache.
    """
    import jax
    import jax.numpy as jnp

    from btr_mjx.engines import use_all_cores, use_compilation_cache

    use_all_cores()
    use_compilation_cache()
    events: list[str] = []
    jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
    least = jax.config.jax_persistent_cache_min_compile_time_secs
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

    def program(x: Any) -> Any:
        return jnp.sin(x) * x

    program.__name__ = program.__qualname__ = token
    argument = jax.ShapeDtypeStruct((64,), jnp.float32)
    events.clear()
    jax.jit(program).lower(argument).compile()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least)
    return {
        "process": process,
        "enabled": bool(jax.config.jax_enable_compilation_cache),
        "folder": jax.config.jax_compilation_cache_dir,
        "hit": "/jax/compilation_cache/cache_hits" in events,
    }


def agreement(*others: str) -> dict[str, Any]:
    """Simulate a few pairs of two robots on every engine.

    Args:
      *others: engines to compare with native MuJoCo.

    Returns:
      precision ("float32" or "float64") and difference: robot -> engine -> greatest difference of positions [m] or
      joint angles [rad].
    """
    import jax
    import numpy as np

    from btr_mjx.evaluation import evaluate
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
    engines: Sequence[Any] = ("native", *others)
    difference: dict[str, dict[str, float]] = {}
    for robot, times, states in ((hexapod(), [0.1], False), (arm, [0.4], True)):
        rng = np.random.default_rng(0)
        s, c = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 3)
        motions = {}
        for engine in engines:
            outcome = evaluate(robot, s, c, engine=engine, pairwise=True, times=times, states=states).outcome
            motions[engine] = np.asarray(outcome.qpos if states else outcome.position)
        difference[robot.name] = {engine: float(np.abs(motions[engine] - motions["native"]).max()) for engine in others}
    return {"precision": "float64" if jax.config.read("jax_enable_x64") else "float32", "difference": difference}


def speed() -> dict[str, Any]:
    """Steps per second of `lanes` and of native MuJoCo, the best of three rounds, and the number of cores."""
    import numpy as np

    from btr_mjx.evaluation import Engine, evaluate
    from btr_mjx.robots import hexapod
    from btr_mjx.runs import available_cores

    robot, cores = hexapod(), available_cores()
    rng = np.random.default_rng(0)
    s = robot.simulation_box.sample(rng, 4)
    pairs: Mapping[Engine, int] = {"lanes": 64 * CHUNKS_PER_DEVICE * cores, "native": 32 * cores}
    rates: dict[str, list[float]] = {engine: [] for engine in pairs}
    for number in range(4):
        for engine, count in pairs.items():
            c = robot.controller_box.sample(rng, count // len(s))
            start = time.perf_counter()
            evaluate(robot, s, c, engine=engine, times=[TIMED_STEPS * 5e-4])
            if number:  # the first round compiles
                rates[engine].append(count * TIMED_STEPS / (time.perf_counter() - start))
    return {engine: max(values) for engine, values in rates.items()} | {"cores": cores}


def pictures() -> dict[str, Any]:
    """OpenGL backend that renders robots, None where there is none, and the one that the user asked for."""
    from btr_mjx.plotting import working_backend

    return {"backend": working_backend(), "asked": os.environ.get("MUJOCO_GL", "")}


SECTIONS: Mapping[str, Callable[..., dict[str, Any]]] = {
    "devices": devices,
    "cache": cache,
    "agreement": agreement,
    "speed": speed,
    "pictures": pictures,
}
"""What can be measured, by the name used in the child's arguments; arguments follow behind colons."""


def main(sections: Sequence[str]) -> None:
    """Measure sections and print one line of JSON for each: {"section": ..., "result": ...} or {..., "error": ...}."""
    for section in sections:
        name, *arguments = section.split(":")
        line: dict[str, Any] = {"section": section}
        try:
            line["result"] = SECTIONS[name](*arguments)
        except Exception as error:
            line["error"] = f"{type(error).__name__}: {one_line(error)}"
        print(MARK + json.dumps(line), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
