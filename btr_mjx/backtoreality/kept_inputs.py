"""Copies of what the settings of a run name: a robot, a reality, a fitness function of one's own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from btr_mjx.backtoreality.reality import Reality, SimulatedReality
from btr_mjx.backtoreality.settings import RunSettings
from btr_mjx.models import files_of_model, files_of_robot, keep_files, kept_files
from btr_mjx.robots import Robot

_SETTINGS = ("robot", "template", "reality_model", "fitness")
"""Settings that name a file."""


def keep_inputs(folder: Path, config: RunSettings, robot: Robot, reality: Reality | None = None) -> None:
    """Copy the files of a run's settings that are there into its folder, where a copy is missing or was altered."""
    named = {}
    if config.robot is not None and config.robot.exists():
        named["robot"] = files_of_robot(config.robot, robot)
    if config.template is not None:
        named["template"] = files_of_model(robot)
    if getattr(config, "reality_model", None) is not None and isinstance(reality, SimulatedReality):
        named["reality_model"] = files_of_model(reality.robot)
    if (file := _file(config.fitness)) is not None and file.exists():
        named["fitness"] = [file.resolve()]
    keep_files(folder, named)


def with_kept_files[Config: RunSettings](config: Config, gone_only: bool = True) -> Config:
    """The config with the copies in its run folder in place of the files that it names.

    Args:
      config: the settings.
      gone_only: replace only files that are not there any more.
    """
    out: Path | None = getattr(config, "out", None)
    kept = {} if out is None else kept_files(out)
    changes: dict[str, Any] = {}
    for name in _SETTINGS:
        given = getattr(config, name, None)
        original = _file(given)
        if original is None or name not in kept or (gone_only and original.exists()):
            continue
        changes[name] = f"{kept[name]}:{str(given).rpartition(':')[2]}" if name == "fitness" else kept[name]
    return replace(config, **changes)


def _file(given: Path | str | None) -> Path | None:
    """The file that a setting names, if it does."""
    if isinstance(given, str):
        return Path(given.rpartition(":")[0]) if ".py:" in given else None
    return given
