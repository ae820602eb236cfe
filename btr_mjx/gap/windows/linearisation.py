"""Linearisation of windows around a hypothesis: fitted starting states, and derivatives with respect to them."""

from btr_mjx.gap.windows.likelihood import column_space
from btr_mjx.gap.windows.starting_states import STEPS, fit_starting_states
from btr_mjx.gap.windows.time_steps import choose_time_step, step_error
from btr_mjx.gap.windows.transitions import state_jacobians, stride, transition_change, transitions
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_MAX_CHANGE = 1.0
"""Value of `transition_change` above which the transition matrix of an interval is differentiated again."""


def linearise(windows: Windows, make: MakeWorld, steps: int = 5) -> None:
    """Linearise windows around a hypothesis, which becomes their base.

    Chooses the time step, differentiates, fits the starting states, and differentiates again at these.

    Args:
      windows: changed in place.
      make: the hypothesis.
      steps: Gauss-Newton steps of the starting states; a window accepts a step only if its chi^2 decreases.
    """
    base, correction = choose_time_step(windows, make)
    windows.stride = stride(windows, make, base)
    windows.transitions, windows.perturbed_ends = transitions(windows, make, base)
    _set_jacobians(windows, make)
    windows.qpos, windows.qvel, windows.base = fit_starting_states(windows, make, steps, base, correction)
    windows.make_base = make
    differentiate(windows, make)
    windows.correction = step_error(windows, make, windows.base)
    windows.clear_residuals()


def differentiate(windows: Windows, make: MakeWorld) -> None:
    """Update the derivatives with respect to the starting states for another base.

    Only transitions that changed by more than `_MAX_CHANGE` are computed again.

    Args:
      windows: changed in place.
      make: the hypothesis of `windows.base`.
    """
    changed = transition_change(windows, make, windows.base) > _MAX_CHANGE
    known = windows.transitions, windows.perturbed_ends
    windows.transitions, windows.perturbed_ends = transitions(windows, make, windows.base, changed, known)
    _set_jacobians(windows, make)
    windows.project_partially(windows.partial_basis)


def _set_jacobians(windows: Windows, make: MakeWorld) -> None:
    windows.jacobians, windows.is_linear = state_jacobians(windows, make)
    windows.basis, windows.inverse = column_space(windows.jacobians)


def relinearised(windows: Windows, make: MakeWorld) -> Windows:
    """A copy of windows with derivatives and starting states of another hypothesis.

    If contacts change, the derivatives of the believed model do not project the error of the starting state out of the
    residual of the hypothesis.

    Args:
      windows: with starting states of the hypothesis, see `with_fitted_states`.
      make: the hypothesis.

    Returns:
      The copy, with the correction of the time step of `windows`.
    """
    other = windows.copied()
    differentiate(other, make)
    other.qpos, other.qvel, other.base = fit_starting_states(other, make, STEPS, windows.base, windows.correction)
    other.make_base = make
    # The correction of the time step changes little with the starting state and is not computed again.
    return other
