"""The engine of a run: measured once, before its first trial, and kept in config.json, so that a resumed run has it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import get_args

from btr_mjx.backtoreality.settings import RunSettings
from btr_mjx.evaluation import Engine, choose_engine
from btr_mjx.robots import Robot
from btr_mjx.runs import CONFIG_NAME, note, read_config_json


def with_engine_of_folder[Config: RunSettings](config: Config) -> Config:
    """The config, with the engine of the run that it continues where it leaves the engine open."""
    out: Path | None = getattr(config, "out", None)
    resumed = out is not None and getattr(config, "resume", False) and (out / CONFIG_NAME).is_file()
    if config.engine != "auto" or out is None or not resumed:
        return config
    saved = read_config_json(out).get("engine")
    return next((replace(config, engine=known) for known in get_args(Engine) if known == saved), config)


def with_measured_engine[Config: RunSettings](
    config: Config, robot: Robot, pairs: int, batch: int, settle: Callable[[Config], None]
) -> Config:
    """The config, with the fastest engine where it leaves the engine open, which prints a line.

    Args:
      config: the settings.
      robot: the robot.
      pairs: trials of the whole run.
      batch: trials that are evaluated at a time.
      settle: called with the config if the engine was left open.
    """
    if config.engine != "auto":
        return config
    if config.progress:
        note("choosing the engine: lanes may have to compile, for up to half a minute")
    states = config.fitness_of(robot).needs_states
    choice = choose_engine(robot, pairs=pairs, batch=batch, states=states)
    if config.progress:
        note(choice.reason)
    config = replace(config, engine=choice.engine)
    settle(config)
    return config
