"""Windows linearised around a hypothesis: starting states that suit it, and directions in which these may be off."""

from btr_mjx.gap.windows.likelihood import spanned
from btr_mjx.gap.windows.starting_states import STEPS, centred
from btr_mjx.gap.windows.time_steps import paced, step_error
from btr_mjx.gap.windows.transitions import directions, strangeness, stride, transitions
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_CHANGED = 1.0
"""Change of an interval's transition, see `strangeness`, beyond which it is differentiated again."""


def linearise(windows: Windows, make: MakeWorld, steps: int = 5, step: float | None = None) -> None:
    """Make a hypothesis the base world of windows: improve the starting states, then project them out.

    Args:
      windows: changed in place.
      make: the hypothesis.
      steps: Gauss-Newton steps of the starting states; a window keeps a step only if it helps.
      step: time step that is to be taken [s]; None to choose one.
    """
    base, correction = paced(windows, make, step)
    windows.stride = stride(windows, make, base)
    windows.transitions, windows.answers = transitions(windows, make, base)
    _set_directions(windows, make)
    windows.qpos, windows.qvel, windows.base = centred(windows, make, steps, base, correction)
    windows.maker = make
    differentiate(windows, make)
    windows.correction = step_error(windows, make, windows.base)
    windows.forget_residuals()


def differentiate(windows: Windows, make: MakeWorld) -> None:
    """Directions of the starting states for another base: differentiated again where transitions have changed.

    Args:
      windows: changed in place.
      make: the hypothesis that `windows.base` is of.
    """
    changed = strangeness(windows, make, windows.base) > _CHANGED
    known = windows.transitions, windows.answers
    windows.transitions, windows.answers = transitions(windows, make, windows.base, changed, known)
    _set_directions(windows, make)
    windows.soften(windows.soft)


def _set_directions(windows: Windows, make: MakeWorld) -> None:
    windows.jacobians, windows.tame = directions(windows, make)
    windows.basis, windows.inverse = spanned(windows.jacobians)


def redirected(windows: Windows, make: MakeWorld) -> Windows:
    """The same with what the starting states could explain found anew as well.

    Where a hypothesis lets a foot touch at another time, the directions of the believed model leave the noise of the
    starting state in the residual, and judge the truth worse than nothing.

    Args:
      windows: recentred around the hypothesis.
      make: the hypothesis.
    """
    other = windows.copied()
    differentiate(other, make)
    other.qpos, other.qvel, other.base = centred(other, make, STEPS, windows.base, windows.correction)
    other.maker = make
    # What the time step does changes little with the starting state; another fine pass would cost as much as the rest.
    return other
