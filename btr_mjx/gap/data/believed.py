"""Parameters of the believed model that are refitted together with every hypothesis."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.gap.data.toml_tables import check_keys, is_number
from btr_mjx.models import parse_path


@dataclass(frozen=True)
class Believed:
    """A parameter of the believed model that may be refitted.

    Attributes:
      name: for reports.
      paths: numbers of the model that it sets, see `btr_mjx.models.parse_path`.
      low, high: bounds in SI units; factors if `relative`.
      relative: the value is a factor on the numbers of each recording's model instead of a replacement.
    """

    name: str
    paths: tuple[str, ...]
    low: float
    high: float
    relative: bool = False

    @property
    def path(self) -> str:
        """The first path."""
        return self.paths[0]

    def value(self, model: mujoco.MjModel) -> float:
        """The believed value of a model: the number at the first path, 1 if relative."""
        return 1.0 if self.relative else parse_path(model, self.path).read(model)

    def write(self, model: mujoco.MjModel, value: float) -> None:
        """Set the parameter in place in a model that holds the believed numbers.

        Call `mj_setConst` after the last parameter is set.
        """
        for name in self.paths:
            path = parse_path(model, name)
            path.write(model, path.read(model) * value if self.relative else value)


def read_believed(row: Mapping[str, Any], model: mujoco.MjModel, where: str, notes: list[str]) -> Believed:
    """Read a [[parameter]] row.

    Args:
      row: the row.
      model: the believed model.
      where: the row's place, for messages.
      notes: warnings are appended here.

    Returns:
      The parameter.

    Raises:
      InputError: an unknown path, invalid bounds, or a believed value outside them.
    """
    check_keys(row, ("name", "path", "bounds", "low", "high", "relative", "unit"), where, notes)
    paths = row.get("path")
    texts = [paths] if isinstance(paths, str) else paths
    if not isinstance(texts, list) or not texts or not all(isinstance(t, str) for t in texts):
        raise InputError(f'{where}: path {paths!r}: expected a text such as "joint:knee/damping", or a list of them')
    bounds = row.get("bounds", [row.get("low"), row.get("high")])
    if not isinstance(bounds, list) or len(bounds) != 2 or not all(is_number(b) for b in bounds):
        raise InputError(f"{where}: bounds {bounds!r}: expected [LOW, HIGH]")
    low, high = map(float, bounds)
    if not low < high:
        raise InputError(f"{where}: bounds {bounds!r}: expected LOW below HIGH")
    try:
        believed = Believed(str(row.get("name", texts[0])), tuple(texts), low, high, bool(row.get("relative", False)))
        for one in texts:
            parse_path(model, one)
        value = believed.value(model)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if not low <= value <= high:
        raise InputError(
            f"{where}: the model's own value of {believed.path!r} is {value:.6g}, outside its bounds [{low}, {high}]"
        )
    return believed
