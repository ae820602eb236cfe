"""How far predictions are off, as result.json has it, and words for it that all sentences and tables share.

There is one scale: errors of predictions of held-out recordings in units of what noise and time step make of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from btr_mjx.gap.results.words.statements import Claim
from btr_mjx.gap.results.words.terms import as_float, error_in_words, format_number

SCALE = "1: what noise and the time step make"
"""What the numbers of a misfit are in units of."""

_NUMBERS = ("before", "after", "constant_velocity", "explained")
"""Numbers of the entry `misfit`."""

MISFIT, MISFIT_AFTER = "misfit", "misfit after"
"""Keys of claims about the believed and the mended model."""


@dataclass(frozen=True)
class Levels:
    """Entry `misfit` of result.json.

    Attributes:
      unit: "noise", or an SI unit where noise is not known; "" where there is no number.
      before, after, constant_velocity: of the believed model, the mended one, and the simplest predictor.
      noise_before: whether the believed model is at the noise's level.
      noise_reached: whether the best model that there is is; None where that is not known.
      explained: share of what is beyond the noise that the mended model explains; None where it does not fall.
    """

    unit: str
    before: float | None
    after: float | None
    constant_velocity: float | None
    noise_before: bool | None
    noise_reached: bool | None
    explained: float | None

    @classmethod
    def of(cls, result: Mapping[str, Any]) -> "Levels":
        """Those of result.json."""
        entry = result.get("misfit") or {}
        before, after, steady, explained = (as_float(entry.get(key)) for key in _NUMBERS)
        unit, is_noise, is_reached = (entry.get(key) for key in ("unit", "noise_before", "noise_reached"))
        return cls(str(unit or ""), before, after, steady, is_noise, is_reached, explained)

    @property
    def falls(self) -> bool | None:
        """Whether the mended model is nearer to the data; None where there is none."""
        return None if self.before is None or self.after is None else self.after < self.before

    @property
    def is_of_use(self) -> bool:
        """Whether no simple predictor is as near to the data as the mended model."""
        return self.falls is not False and (
            self.after is None or self.constant_velocity is None or self.after < self.constant_velocity
        )


def misfit_in_words(value: float | None) -> str:
    """A misfit as all sentences, tables and figures have it."""
    return format_number(value)


def joint_rows(result: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Errors of predictions by joint."""
    return result.get("joint_errors") or []


def off_by(row: Mapping[str, Any], key: str) -> str:
    """An error of a row of `joint_errors` in degrees, millimetres or its own unit; a dash where there is none."""
    value = as_float(row.get(key))
    return "–" if value is None else error_in_words(value, str(row["unit"]))


def joint_claims(row: Mapping[str, Any], *keys: str) -> dict[str, Claim]:
    """Claims about the errors of a joint."""
    return {f"error of {row['joint']}, {key}": off_by(row, key) for key in keys}


def times_noise(row: Mapping[str, Any], key: str) -> float:
    """An error in units of what noise and time step make; 0 where either is not known."""
    value, floor = as_float(row.get(key)), as_float(row.get("floor"))
    return value / floor if value is not None and floor else 0.0


def worst_joint(rows: Sequence[Mapping[str, Any]], key: str) -> Mapping[str, Any] | None:
    """The joint that is farthest from the noise."""
    known = [row for row in rows if as_float(row.get(key)) is not None and as_float(row.get("floor"))]
    return max(known, key=lambda row: times_noise(row, key), default=None)
