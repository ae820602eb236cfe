"""The command line of a config: what a person types to continue a run."""

import dataclasses
from collections.abc import Sequence
from typing import Any


def flags_of(config: Any, default: Any, leave_out: Sequence[str] = ()) -> list[str]:
    """Flags that make a config of its defaults.

    Args:
      config: a flat dataclass of bools, numbers, texts, paths and tuples of these.
      default: another one, whose values need no flag.
      leave_out: names of fields that get no flag.

    Returns:
      Words such as ["--trials", "4", "--no-progress"].
    """
    words: list[str] = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name in leave_out or value == getattr(default, field.name) or value is None:
            continue
        flag = field.name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else [value])]
    return words
