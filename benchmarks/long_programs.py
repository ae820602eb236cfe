"""Long programs of `lanes` whole and in parts: `uv run python benchmarks/long_programs.py MODEL.xml ...`.

For each model, a program that steps one chunk of worlds from its start is compiled twice: as one function, and as calls
of parts (`btr_mjx/engines/rewriting/parts.py`). Printed are the equations of a step, and of each program the time that
compiling takes, wall clock and CPU, and the time of a step of one world on one core, the better of several rounds; both
programs run once a round. Nothing is read from a cache. Short programs stay whole both times.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from jax import lax

from btr_mjx.engines import LanesStepper, use_all_cores
from btr_mjx.engines.rewriting import parts


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    models: tyro.conf.Positional[tuple[Path, ...]]
    """MJCF files."""
    chunk: int = 64
    """Worlds of a chunk."""
    steps: int = 200
    """Steps of one run."""
    longest: int = parts.LONGEST
    """Equations of a program, or of a loop, that stays whole."""
    part: int = parts.PART
    """Equations of a part, at most."""
    rounds: int = 5
    """Number of runs of each program."""
    json: Path | None = None
    """Also write the numbers to this file."""


def program(model: mujoco.MjModel, config: Config, longest: int) -> tuple[Any, tuple, dict[str, float]]:
    """A compiled program, its arguments and what compiling took.

    Args:
      model: the model.
      config: the settings.
      longest: equations of a program that stays whole.
    """
    parts.LONGEST, parts.PART = longest, config.part
    stepper = LanesStepper(model, guards=True)

    def run(state: Any, control: jax.Array, count: jax.Array) -> Any:
        return lax.fori_loop(0, count, lambda _, s: stepper.step({}, s, control), state)

    control = 0.1 * np.random.default_rng(0).uniform(-1, 1, (model.nu, config.chunk))
    arguments = (stepper.initial({}, config.chunk), jnp.asarray(control, jnp.result_type(float)), config.steps)
    traced = jax.jit(run).trace(*arguments)
    lowered = traced.lower()
    wall, processor = time.perf_counter(), time.process_time()
    compiled = lowered.compile(compiler_options={"xla_cpu_prefer_vector_width": "512"})
    took = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - processor}
    return compiled, arguments, took | {"equations": sum(map(parts.number_of_equations, traced.jaxpr.eqns))}


def main(config: Config) -> None:
    """Measure every model."""
    use_all_cores()
    jax.config.update("jax_enable_compilation_cache", False)
    table = []
    for path in config.models:
        model = mujoco.MjModel.from_xml_path(str(path))
        found = {"whole": program(model, config, 10**9), "parts": program(model, config, config.longest)}
        best = dict.fromkeys(found, np.inf)
        for _ in range(config.rounds + 1):  # the first one touches the memory
            for name, (compiled, arguments, _) in found.items():
                begun = time.perf_counter()
                jax.block_until_ready(compiled(*arguments))
                best[name] = min(best[name], (time.perf_counter() - begun) / config.steps / config.chunk * 1e6)
        row = {"model": str(path), "equations": found["whole"][2]["equations"]}
        row |= {f"{name} {key} [s]": found[name][2][key] for name in found for key in ("wall", "cpu")}
        row |= {f"{name} step [us]": best[name] for name in found}
        table.append(row)
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{v}" for k, v in row.items()), flush=True)
    if config.json:
        config.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main(tyro.cli(Config))
