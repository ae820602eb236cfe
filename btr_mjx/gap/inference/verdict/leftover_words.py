"""What a hypothesis leaves, in words: where it acts, how large it is, and what it follows."""

from collections.abc import Sequence

from btr_mjx.gap.inference.scoring.forces import Description
from btr_mjx.gap.inference.scoring.leftover import Feature

_FEATURES = {
    "absolute position": "the absolute value of {} position",
    "position cubed": "the cube of {} position",
    "ripple": "a ripple over {} position",
    "load growing with time": "{} load, more and more with time (a drift)",
    "time": "time (a drift)",
}
"""Variables that are no plain quantity of a joint; "{}" is whose they are."""


def telling_sentence(feature: Feature, places: Sequence[tuple[str, str]]) -> str:
    """A feature in words.

    Args:
      feature: what a force follows.
      places: of `dof_places`.
    """
    follows = _variable(feature.name, feature.other, places)
    return f"{places[feature.dof][0]}: a force there follows {follows}, as no effect that was tried does"


def sentence(description: Description, places: Sequence[tuple[str, str]]) -> str:
    """A description in words.

    Args:
      description: of an unknown force.
      places: of `dof_places`.
    """
    where, unit = places[description.dof]
    text = f"{where}: {100 * description.share:.0f} % of the unexplained force"
    text += f", {description.size:.3g} {unit} (root mean square)"
    if description.follows:
        parts = [
            f"{_variable(name, None if dof == description.dof else dof, places)} (correlation {correlation:+.2f})"
            for name, dof, correlation in description.follows
        ]
        text += ", follows " + " and ".join(parts)
    return text


def _variable(name: str, other: int | None, places: Sequence[tuple[str, str]]) -> str:
    """A variable in words, of the same degree of freedom or of another one."""
    if name in _FEATURES:
        whose = "its" if other is None else f"{places[other][0].partition(',')[0]}'s"
        return _FEATURES[name].format(whose)
    return f"its {name}" if other is None else f"the {name} of {places[other][0].partition(',')[0]}"
