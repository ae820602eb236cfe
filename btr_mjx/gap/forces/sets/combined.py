"""Effects that apply one after another as one effect for each place, with numbers that add up."""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.effects import TIMING, Candidate
from btr_mjx.gap.forces.points import Named
from btr_mjx.gap.forces.unknowns import Library


def combined(before: Named, more: Sequence[tuple[Candidate, tuple[float, ...]]]) -> Named:
    """Effects with further ones, whose numbers are added where effect and place are the same, within their range.

    Two payloads at two places stay two. What is set, such as a limit, has the later value.

    Args:
      before: effects with their values.
      more: further ones, which apply after them.
    """
    out: dict[str, tuple[Candidate, tuple[float, ...]]] = {}
    for candidate, values in (*before, *more):
        numbers, own = np.array(values, float), candidate
        shape = [v for v, p in zip(values, own.parameters, strict=True) if p.shape]
        name = " ".join([own.name, *map(str, shape)])
        if name in out and not any(p.null for p in own.parameters if not p.shape):
            own, earlier = out[name]  # whose range begins at the believed model
            numbers = _sums(own, np.array(earlier), numbers)
        low, high = (np.array([getattr(p, end) for p in own.parameters]) for end in ("low", "high"))
        out[name] = own, tuple(float(v) for v in np.clip(numbers, low, high))
    return tuple(out.values())


def _sums(candidate: Candidate, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Numbers of an effect that applies twice; relative changes multiply."""
    factors = [p.name.startswith("change") and p.unit == "1" for p in candidate.parameters]
    shapes = [p.shape for p in candidate.parameters]
    return np.where(shapes, first, np.where(factors, (1 + first) * (1 + second) - 1, first + second))


def at_single_places(library: Library, candidate: Candidate, values: tuple[float, ...]) -> Named:
    """An effect of a group as effects of its members, so that numbers of the same place can be added.

    Args:
      library: that has the members.
      candidate: the effect.
      values: of it.
    """
    if candidate.place.parts:
        return tuple((single, (value,)) for single, value in zip(candidate.singles, values, strict=True))
    if not candidate.place.members or candidate.effect.name == TIMING:
        return ((candidate, values),)
    single = {e.candidate.name: e.candidate for e in library.entries}
    return tuple((single[f"{candidate.effect.name}@{member}"], values) for member in candidate.place.members)
