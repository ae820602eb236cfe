"""The table [control] of dataset.toml: what columns of commands mean, of all recordings or of each by its name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from btr_mjx.errors import InputError
from btr_mjx.gap.data.lists import listed
from btr_mjx.runs import check_keys, is_number, toml_section

Interpolation = Literal["hold", "linear", "cubic"]
"""The command between two samples: that of the earlier one, a straight line, a cubic spline."""
INTERPOLATIONS: tuple[Interpolation, ...] = get_args(Interpolation)
"""All kinds of it."""


@dataclass(frozen=True)
class Control:
    """What dataset.toml says about commands.

    Attributes:
      interpolation: of the command between samples, by name of the recording; that of "" is of all others.
      shift: seconds that are added to the times of the commands, likewise.
      measured: whether "command" or "force" columns drive the model; "" where nothing is said.
    """

    interpolation: Mapping[str, Interpolation] = field(default_factory=dict)
    shift: Mapping[str, float] = field(default_factory=dict)
    measured: str = ""

    def interpolation_of(self, name: str) -> Interpolation | None:
        """What is said of a recording; None for nothing."""
        return self.interpolation.get(name, self.interpolation.get(""))

    def shift_of(self, name: str) -> float:
        """Seconds that are added to the times of a recording's commands."""
        return self.shift.get(name, self.shift.get("", 0.0))

    def check_names(self, names: list[str], where: str) -> None:
        """Refuse names that no recording has.

        Raises:
          InputError: one of them.
        """
        for key in ("interpolation", "shift"):
            for name in getattr(self, key):
                if name and name not in names:
                    raise InputError(
                        f"{where}: [control] {key}: there is no recording {name!r}; expected one of {listed(names)}"
                    )


def read_control(table: Mapping[str, Any], path: Path, notes: list[str]) -> Control:
    """Read [control].

    Args:
      table: the tables of dataset.toml.
      path: of it.
      notes: unknown keys are appended.

    Raises:
      InputError: a value that is none of those expected.
    """
    own = toml_section(table, "control", path) if "control" in table else {}
    check_keys(own, ("interpolation", "shift", "measured"), f"{path}: [control]", notes)
    if (measured := own.get("measured", "")) not in ("", "command", "force"):
        raise InputError(f"{path}: [control] measured = {measured!r}: expected 'command' or 'force'")
    given: dict[str, dict[str, Any]] = {}
    for key in ("interpolation", "shift"):
        value = own.get(key, {})
        given[key] = dict(value) if isinstance(value, Mapping) else {"": value}
    for value in given["interpolation"].values():
        if value not in INTERPOLATIONS:
            raise InputError(
                f"{path}: [control] interpolation = {value!r}: expected 'hold', 'linear' or 'cubic', or a table of "
                'these by recording, such as { run1 = "hold" }'
            )
    for value in given["shift"].values():
        if not is_number(value):
            raise InputError(
                f"{path}: [control] shift = {value!r}: expected seconds that are added to the times of the commands, "
                "or a table of these by recording, such as { run1 = -0.12 }"
            )
    return Control(given["interpolation"], {k: float(v) for k, v in given["shift"].items()}, measured)
