"""What a hypothesis leaves, in words: where it acts and what it follows."""

from collections.abc import Sequence

from btr_mjx.gap.inference.scoring.forces import Description
from btr_mjx.gap.inference.scoring.leftover import Feature


def telling_sentence(feature: Feature, names: Sequence[str]) -> str:
    """A feature in words."""
    where = "" if feature.other is None else f" of {names[feature.other]}"
    return f"{names[feature.dof]}: a force there follows {feature.name}{where}, as no effect that was tried does"


def sentence(description: Description, names: Sequence[str]) -> str:
    """A description in words."""
    text = f"{names[description.dof]}: {100 * description.share:.0f} % of the unexplained force"
    text += f", root mean square {description.size:.3g} (SI)"
    if description.follows:
        parts = []
        for name, dof, correlation in description.follows:
            where = "" if dof is None or dof == description.dof else f" of {names[dof]}"
            parts.append(f"{name}{where} (correlation {correlation:+.2f})")
        text += ", follows " + " and ".join(parts)
    return text
