"""How much of what windows say may be luck: robust falls of the loss from one fit to another.

Near a touchdown the linear picture of a starting state fails, and a window may gain or lose more by it than an effect
changes. What is true of a robot is seen in many windows.
"""

import numpy as np

from btr_mjx.gap.windows import Fit, bounded_loss

_LEAST_SAY = 15.0
_SAY = 3.0
"""A window's part in a gain is limited to the first number, plus so many times what most windows say."""

_MANY = 8
"""Beside so many others, a window's gain may be luck."""


def robust_gain(before: Fit, after: Fit, cut: float) -> float:
    """Fall of the loss from one fit to another, in which no window says much more than the others do.

    A foot that touches in one simulation and not in the other moves a window's chi^2 by hundreds, for or against; an
    effect moves many windows.

    Args:
      before: the reference.
      after: the other fit, of the same windows.
      cut: chi^2 above which a window counts less.
    """
    fall = bounded_loss(before.chi2, cut) - bounded_loss(after.chi2, cut)
    price = (before.loss - float(bounded_loss(before.chi2, cut).sum())) - (
        after.loss - float(bounded_loss(after.chi2, cut).sum())
    )
    most = _most(fall)
    return float(np.clip(fall, -most, most).sum()) + price


def _most(fall: np.ndarray) -> float:
    """What a window says at most."""
    return _LEAST_SAY + _SAY * float(np.quantile(np.abs(fall), 0.8))


def luckiest(fall: np.ndarray) -> float:
    """What the window that gains most may owe to luck, to be taken off a gain.

    Args:
      fall: (W,) by how much chi^2 falls in each window.

    Returns:
      Its fall, within a few times what is usual. Where windows are few, only a part of it: one of one, or of two, is
      all that there is.
    """
    return float(np.clip(fall.max(), 0.0, _most(fall))) * min(1.0, (len(fall) - 1) / _MANY)


def without_wildest(excess: np.ndarray) -> np.ndarray:
    """Sums over windows but for the one that says most: one missed touchdown must not make an unknown effect.

    Args:
      excess: (W, ...) of every window.

    Returns:
      (...) sums. Where windows are few only a part of the largest is left out, as in `luckiest`.
    """
    return excess.sum(0) - np.maximum(excess.max(0), 0.0) * min(1.0, (len(excess) - 1) / _MANY)


def fall(before: Fit, after: Fit, cut: float, share: float = 1.0, even: bool = False) -> float:
    """Robust fall of the loss, without the window that gains most: one touchdown must not make a name.

    Args:
      before: the reference.
      after: the other fit, of the same windows.
      cut: chi^2 above which a window counts less.
      share: of all windows that these are; the fall is that of all.
      even: without the window that loses most as well: one touchdown must not hide a name either. Not for what moves
        contacts, which loses there by being wrong.
    """
    change = bounded_loss(before.chi2, cut) - bounded_loss(after.chi2, cut)
    luck = luckiest(change) - (luckiest(-change) if even else 0.0)
    return robust_gain(before, after, cut) / share - luck
