"""Lists in messages: whole up to a bound, and never cut without saying how much more there is."""

from collections.abc import Iterable


def counted(count: int, what: str) -> str:
    """A number of things: "1 joint", "2 joints"."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def listed(items: Iterable[object], most: int = 30, quotes: bool = False) -> str:
    """The items in a row, "a, b, c"; beyond `most` of them "and 7 more"."""
    texts = [repr(item) if quotes else str(item) for item in items]
    more = f" and {len(texts) - most} more" if len(texts) > most else ""
    return ", ".join(texts[:most]) + more
