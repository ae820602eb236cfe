"""Choice of windows for fit and test recordings, and of their time step.

The time step of the model is divided if its discretisation error at contacts exceeds the noise, or if it is too long
for effects that may be missing, such as stiction.
"""

import math
from dataclasses import dataclass, replace

from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows.impacts import impact_samples
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.placement import MIN_SPAN, Survey, plan_windows, tile_windows
from btr_mjx.gap.windows.prepared import PreparedData
from btr_mjx.gap.windows.time_steps import refinement
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_MAX_STEP = 2.5e-3
"""Longest time step [s]; longer steps of a model are divided. Estimates of friction are biased with longer ones."""

_MIN_COVERAGE = 1 / 3
"""Smallest fraction of the recordings that windows between impacts must cover."""


@dataclass(frozen=True)
class WindowPlan:
    """Chosen windows and settings of their simulation.

    Attributes:
      windows: of the fit recordings and of the held-out ones, not linearised.
      single: whether signatures are evaluated with single steps, see `sensitivity.signatures`.
      options: budget, in steps of the chosen length.
      survey: contact in the recordings, and length of the windows.
    """

    windows: tuple[Windows, Windows]
    single: bool
    options: Options
    survey: Survey


def choose_windows(
    data: PreparedData,
    held: PreparedData,
    base: MakeWorld,
    survey: Survey,
    count: int,
    options: Options,
    counter: Counter,
) -> WindowPlan:
    """Choose windows and their time step.

    Args:
      data: recordings to fit.
      held: recordings held out.
      base: the believed model.
      survey: contact in the recordings, and length of the windows.
      count: total number of parameters of the candidates that are screened.
      options: budget.
      counter: adds up the simulated steps.

    Returns:
      Windows and settings.
    """

    def windows_of(data: PreparedData, held: PreparedData, options: Options) -> WindowPlan:
        fit, test, single = plan_windows(data, held, survey.span, count, options, counter)
        return WindowPlan((Windows(*fit, counter), Windows(*test, counter)), single, options, survey)

    if not survey.contact:
        data, held, survey = _avoid_impacts(data, held, survey, counter)
    chosen = windows_of(data, held, options)
    divisor = refinement(chosen.windows[0], base) if survey.contact else 1
    step_divisor = max(divisor, math.ceil(chosen.windows[0].dt / _MAX_STEP - 1e-6))
    if step_divisor == 1:
        return chosen
    # The number of windows is that with undivided steps.
    data, held = (replace(side, step_divisor=step_divisor, refined_for_contact=divisor > 1) for side in (data, held))
    return windows_of(data, held, replace(options, steps=step_divisor * options.steps))


def _avoid_impacts(
    data: PreparedData, held: PreparedData, survey: Survey, counter: Counter
) -> tuple[PreparedData, PreparedData, Survey]:
    """Restrict windows to parts between impacts, shortened if necessary; unchanged if these cover too little."""
    known = [impact_samples(side, counter) for side in (data, held)]
    if not any(one.any() for side in known for one in side):
        return data, held, survey
    data_free, held_free = (replace(side, impacts=own) for side, own in zip((data, held), known, strict=True))
    span = survey.span
    while span >= MIN_SPAN:
        if min(_coverage(side, span) for side in (data_free, held_free)) >= _MIN_COVERAGE:
            return data_free, held_free, replace(survey, span=span)
        span /= 2
    return data, held, survey


def _coverage(data: PreparedData, span: float) -> float:
    """Fraction of the recordings that windows cover."""
    _, start, k = tile_windows(data, span)
    return k * len(start) / sum(len(r.time) for r in data.recordings)


def time_step_notes(windows: Windows) -> tuple[str, ...]:
    """A sentence about the time step for the report, if it is shorter than that of the model."""
    own = float(windows.models[0].opt.timestep)
    if windows.data.step_divisor == 1:
        return ()
    why = (
        "move feet that touch the ground by more than the sensors would miss"
        if windows.data.refined_for_contact
        else "are long for what may be missing, such as a friction that sticks"
    )
    return (f"Simulated in steps of {1e3 * windows.dt:g} ms: steps of {1e3 * own:g} ms, as the model has them, {why}.",)
