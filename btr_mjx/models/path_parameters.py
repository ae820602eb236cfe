"""Parameters of a model that are given by paths: numbers of the compiled model that one value sets."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco

from btr_mjx.errors import InputError
from btr_mjx.models.model_checks import check_model
from btr_mjx.models.paths import parse_path
from btr_mjx.runs import check_keys, is_number

KEYS = ("name", "path", "bounds", "low", "high", "relative", "unit")
"""Keys of a [[parameter]] row that are read here."""


@dataclass(frozen=True)
class PathParameter:
    """A parameter that sets one or more numbers of a model.

    Attributes:
      name: for tables and reports.
      paths: the numbers, see `parse_path`.
      low, high: bounds in SI units; factors if `relative`.
      relative: the value is a factor on the numbers of a model instead of a replacement.
      unit: of the value, for tables and reports; "" where none was given.
    """

    name: str
    paths: tuple[str, ...]
    low: float
    high: float
    relative: bool = False
    unit: str = ""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Its name alone: as an edit of a robot's model (`robots.Edit`) it takes one value."""
        return (self.name,)

    @property
    def path(self) -> str:
        """The first path."""
        return self.paths[0]

    def value(self, model: mujoco.MjModel) -> float:
        """The value of a model: the number at the first path, 1 if relative."""
        return 1.0 if self.relative else parse_path(model, self.path).read(model)

    def resolved(self, model: mujoco.MjModel) -> Callable[[mujoco.MjModel, Sequence[float]], None]:
        """This edit for models with the same parts as `model`: the paths are looked up once."""
        paths = [parse_path(model, text) for text in self.paths]

        def edit(edited: mujoco.MjModel, values: Sequence[float]) -> None:
            for path in paths:
                path.write(edited, path.read(edited) * values[0] if self.relative else values[0])

        return edit

    def write(self, model: mujoco.MjModel, value: float) -> None:
        """Set the numbers in place in a model that holds its own ones.

        Call `mj_setConst` after the last parameter is set.
        """
        self.resolved(model)(model, [value])

    def __call__(self, model: mujoco.MjModel, values: Sequence[float]) -> None:
        """See `robots.Edit`."""
        self.write(model, values[0])


def read_path_parameter(
    row: Mapping[str, Any], model: mujoco.MjModel, where: str, notes: list[str], more: Sequence[str] = ()
) -> PathParameter:
    """The parameter of a [[parameter]] row with a path; it may have `more` keys, unknown ones are noted.

    Raises:
      InputError: an unknown path, invalid bounds, or a value of the model outside them.
    """
    check_keys(row, (*KEYS, *more), where, notes)
    paths = row.get("path")
    texts = [paths] if isinstance(paths, str) else paths
    if not isinstance(texts, list) or not texts or not all(isinstance(t, str) for t in texts):
        raise InputError(f'{where}: path {paths!r}: expected a text such as "joint:knee/damping", or a list of them')
    low, high = read_bounds(row, where)
    relative, unit = row.get("relative", False), row.get("unit", "")
    if not isinstance(relative, bool) or not isinstance(unit, str):
        raise InputError(f"{where}: relative = {relative!r}, unit = {unit!r}: expected true or false, and a text")
    try:
        parameter = PathParameter(str(row.get("name", texts[0])), tuple(texts), low, high, relative, unit)
        for one in texts:
            parse_path(model, one)
        value = parameter.value(model)
        _check_bounds(parameter, model)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    if not low <= value <= high:
        raise InputError(
            f"{where}: the model's own value of {parameter.path!r} is {value:.6g}, outside its bounds [{low}, {high}]"
        )
    return parameter


def _check_bounds(parameter: PathParameter, model: mujoco.MjModel) -> None:
    """Raise InputError where a bound is a value that the model cannot have, such as a negative mass."""
    for bound in (parameter.low, parameter.high):
        edited = copy.copy(model)
        parameter.write(edited, bound)
        check_model(edited, f"bound {bound:g} of {parameter.path!r}")


def read_bounds(row: Mapping[str, Any], where: str) -> tuple[float, float]:
    """`bounds = [LOW, HIGH]` of a row, or its `low` and `high`.

    Raises:
      InputError: no two finite numbers, or the wrong way round.
    """
    bounds = row.get("bounds", [row.get("low"), row.get("high")])
    if not isinstance(bounds, list) or len(bounds) != 2 or not all(is_number(b) for b in bounds):
        raise InputError(f"{where}: bounds {bounds!r}: expected [LOW, HIGH]")
    low, high = map(float, bounds)
    if not (low < high and math.isfinite(high - low)):
        raise InputError(f"{where}: bounds {bounds!r}: expected LOW below HIGH, by a finite difference")
    return low, high
