"""Linearisation of windows around a hypothesis: fitted starting states, and derivatives with respect to them."""

import numpy as np

from btr_mjx.gap.windows.propagation import jacobian, linearisation_holds
from btr_mjx.gap.windows.starting_states import STEPS, fit_starting_states
from btr_mjx.gap.windows.time_steps import choose_time_step, step_error
from btr_mjx.gap.windows.transitions import state_jacobians, stride, transition_change, transitions
from btr_mjx.gap.windows.window_fits import column_space
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_MAX_CHANGE = 1.0
"""Value of `transition_change` above which the transition matrix of an interval is differentiated again."""


def linearise(windows: Windows, make: MakeWorld, steps: int = 5) -> Windows:
    """Windows linearised around a hypothesis, which becomes their base, without those in which that does not hold.

    Chooses the time step, differentiates, fits the starting states, and differentiates again at these.

    Args:
      windows: not changed.
      make: the hypothesis.
      steps: Gauss-Newton steps of the starting states; a window accepts a step only if its chi^2 decreases.

    Returns:
      Those windows in which the linearisation holds at the smoothed starting states and at the fitted ones.
    """
    out = windows.copied()
    out.base, out.correction = choose_time_step(out, make)
    out.make_base, out.stride = make, stride(out, make, out.base)
    out.transitions, out.perturbed_ends = transitions(out, make, out.base)
    _set_jacobians(out, jacobian(out))
    out = _linear_only(out)
    out.qpos, out.qvel, out.base = fit_starting_states(out, make, steps, out.base, out.correction)
    _differentiate_changed(out, make)
    _set_jacobians(out, jacobian(out))
    out = _linear_only(out)
    out.project_partially(out.partial_basis)
    out.correction = step_error(out, make, out.base)
    out.clear_residuals()
    return out


def _differentiate_changed(windows: Windows, make: MakeWorld) -> None:
    """Differentiate the intervals whose transitions changed by more than `_MAX_CHANGE`; `windows` are changed."""
    changed = transition_change(windows, make, windows.base) > _MAX_CHANGE
    known = windows.transitions, windows.perturbed_ends
    windows.transitions, windows.perturbed_ends = transitions(windows, make, windows.base, changed, known)


def _set_jacobians(windows: Windows, jacobians: np.ndarray) -> None:
    windows.jacobians = jacobians
    windows.basis, windows.inverse = column_space(jacobians)


def _linear_only(windows: Windows) -> Windows:
    holds = linearisation_holds(windows.jacobians)
    return windows if holds.all() else windows.some(np.flatnonzero(holds))


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
    _differentiate_changed(other, make)
    _set_jacobians(other, state_jacobians(other, make))
    other.project_partially(other.partial_basis)
    other.qpos, other.qvel, other.base = fit_starting_states(other, make, STEPS, windows.base, windows.correction)
    other.make_base = make
    # The correction of the time step changes little with the starting state and is not computed again.
    return other
