"""A sentence with what it says: text, and the claims in it by key, of which no two sentences may disagree."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

Claim = str | bool | tuple[str, ...]
"""A number as it stands in the text, yes or no, or names."""


@dataclass(frozen=True)
class Statement:
    """A sentence or two of a verdict.

    Attributes:
      text: the sentence; "" for nothing to say.
      claims: what it says, by what it is about. Numbers stand in the text as they stand here.
    """

    text: str = ""
    claims: Mapping[str, Claim] = field(default_factory=dict)


UNSAID = Statement()
"""No sentence."""


def joined(statements: Iterable[Statement]) -> str:
    """The sentences of statements, one after another."""
    return " ".join(one.text for one in statements if one.text)
