"""Which engine is fastest for a robot: measured once, on controllers drawn at random."""

import logging
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from btr_mjx.engines import UnsupportedModel
from btr_mjx.evaluation.engine_choice import Engine, EngineSettings, run_pairs, stepper_of
from btr_mjx.models import base_model
from btr_mjx.robots import Robot
from btr_mjx.runs import available_cores

_LOG = logging.getLogger(__name__)

_COMPILING = 20.0
"""Time that native MuJoCo may need for a whole run without another engine being tried [s].

To import, trace and compile `lanes` takes 1 to 20 s on one core (`uv run python benchmarks/engine_choice.py`).
"""

_PER_CORE = 16
"""Pairs that native MuJoCo is timed on, per core."""

_STEPS = 500
"""Steps of a trial that are timed."""


@dataclass(frozen=True)
class EngineChoice:
    """An engine, and in one line why.

    Attributes:
      engine: the fastest one.
      reason: such as "lanes: 11 x native on this model".
      ratio: speed of the other engine that was tried relative to native; None where none was.
    """

    engine: Engine
    reason: str
    ratio: float | None = None


def choose_engine(
    robot: Robot,
    *,
    pairs: int | None = None,
    batch: int | None = None,
    samples: np.ndarray | None = None,
    states: bool = False,
    chunk: int | None = None,
) -> EngineChoice:
    """Time native MuJoCo and lanes, or MJX on an accelerator where lanes does not support the robot.

    What is timed is the beginning of trials in the nominal simulation, guards and what they hand over included, without
    compiling.

    Args:
      robot: the robot.
      pairs: pairs of the whole run: where native MuJoCo would be done before another engine has compiled, it is not
        compiled. None where it is not known.
      batch: pairs that are evaluated at a time; None for as many as fill all devices.
      samples: (K,) steps at which a trial is recorded; None for its end.
      states: whether states are recorded. The program that is compiled serves as many samples, with or without states.
      chunk: see `EngineSettings`.

    Returns:
      The choice. A simulator of the robot's own counts as native.
    """
    if robot.simulator is not None:
        return EngineChoice("native", "native: the robot has a simulator of its own")
    if samples is None:
        samples = np.array([max(1, round(robot.duration / base_model(robot).opt.timestep))])
    states = states or bool(robot.point)
    how: dict[str, Any] = {"samples": samples, "states": states, "settings": EngineSettings(chunk=chunk)}
    native, _ = _seconds(robot, "native", _PER_CORE * available_cores(), **how)
    if pairs is not None and pairs * native < _COMPILING:
        left = f"about {pairs * native:.2g} s for the whole run"
        return EngineChoice("native", f"native: {left}, less than lanes takes to compile")
    other, unsupported = _supporting(robot)
    if other == "native":
        return EngineChoice("native", f"native: {unsupported}")
    import jax

    from btr_mjx.engines import default_chunk

    full = (chunk or default_chunk(jax.devices()[0])) * jax.device_count()
    seconds, tripped = _seconds(robot, other, min(full, batch or full), **how)
    ratio = float(native / seconds)
    if ratio > 1:
        return EngineChoice(other, f"{other}: {ratio:.2g} x native on this model", ratio)
    cause = f" (native computes contacts of {tripped:.0%} of the trials anyway)" if tripped else ""
    return EngineChoice("native", f"native: {other} would be {ratio:.2g} x native{cause}", ratio)


def fastest_engine(
    robot: Robot, *, samples: np.ndarray | None = None, states: bool = False, chunk: int | None = None
) -> Engine:
    """The fastest engine for a robot, see `choose_engine`: measured once a process, whatever is recorded then.

    That an engine other than lanes is taken, and why, is logged once.
    """
    key = replace(robot, name="", duration=1.0, speed_limit=1.0)
    return _fastest(_Question(key, robot, samples, states, chunk))


@dataclass(frozen=True)
class _Question:
    """A robot as a key of a cache, with what it is measured on where it is not there."""

    key: Robot
    robot: Robot = field(compare=False)
    samples: np.ndarray | None = field(compare=False)
    states: bool = field(compare=False)
    chunk: int | None = field(compare=False)


@lru_cache(maxsize=16)
def _fastest(asked: _Question) -> Engine:
    choice = choose_engine(asked.robot, samples=asked.samples, states=asked.states, chunk=asked.chunk)
    _LOG.log(logging.INFO if choice.engine == "lanes" else logging.WARNING, choice.reason)
    return choice.engine


def _supporting(robot: Robot) -> tuple[Engine, str]:
    """The engine to compare with native, or native, and why it is not lanes."""
    import jax  # takes seconds

    from btr_mjx.engines import use_all_cores

    use_all_cores()  # before JAX is asked for its backend, with which it fixes its devices
    try:
        stepper_of(robot, "lanes", guards=True)
        return "lanes", ""
    except UnsupportedModel as error:
        reason = str(error).partition(";")[0]
    if jax.default_backend() != "cpu":
        with suppress(UnsupportedModel):
            stepper_of(robot, "mjx", guards=True)
            return "mjx", reason
    return "native", reason


def _seconds(
    robot: Robot, engine: Engine, count: int, *, samples: np.ndarray, states: bool, settings: EngineSettings
) -> tuple[float, float]:
    """Time of a trial [s] and part of the trials that were handed to native MuJoCo, of `count` that run together."""
    how: dict[str, Any] = {"engine": engine, "states": states, "settings": settings, "pairwise": False}
    controllers = robot.controller_box.sample(np.random.default_rng(0), count)
    pairs = robot, robot.nominal_simulation[None], controllers
    run_pairs(*pairs, samples=np.arange(1, len(samples) + 1), **how)  # compiles
    timed = np.clip(samples, 1, _STEPS)
    start = time.perf_counter()
    record = run_pairs(*pairs, samples=timed, **how)
    return (time.perf_counter() - start) / count * samples[-1] / timed[-1], float(record.tripped.mean())
