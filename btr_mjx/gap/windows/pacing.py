"""Windows of both sides of the split, in time steps that suit the data.

A robot that touches the world is simulated in shorter steps than its model asks for where these move its states by more
than sensors would miss: what is left of that then looks like something missing. So is one whose steps are long: they
may do for what is believed and not for what is missing, a friction that sticks between two of them.
"""

import math
from dataclasses import dataclass, replace

from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows.impacts import blows
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.placement import SHORTEST, Survey, grid, plan_windows
from btr_mjx.gap.windows.prepared import Data
from btr_mjx.gap.windows.time_steps import refinement
from btr_mjx.gap.windows.windows import MakeWorld, Windows

_LONGEST = 2.5e-3
"""Steps of a model are divided down to this [s]. A dry friction in steps of 10 ms was a tenth too large."""

_ENOUGH = 1 / 3
"""Part of the recordings that windows between blows have to cover."""


@dataclass(frozen=True)
class Chosen:
    """Windows, and what follows from how they are simulated.

    Attributes:
      windows: to fit and held out, not linearised.
      single: whether candidates are looked at in single steps, see `sensitivity.signatures`.
      options: how much is spent, in steps of the length that is taken.
      survey: what the recordings go through, with the length that windows have.
    """

    windows: tuple[Windows, Windows]
    single: bool
    options: Options
    survey: Survey


def chosen_windows(
    data: Data, held: Data, base: MakeWorld, survey: Survey, count: int, options: Options, counter: Counter
) -> Chosen:
    """Choose windows, and the time step in which they are simulated.

    Args:
      data: recordings to fit.
      held: recordings held out.
      base: the believed model.
      survey: what the recordings go through.
      count: numbers of all candidates that are screened.
      options: how much is spent.
      counter: adds up the simulated steps.
    """

    def windows_of(data: Data, held: Data, options: Options) -> Chosen:
        fit, test, single = plan_windows(data, held, survey.span, count, options, counter)
        return Chosen((Windows(*fit, counter), Windows(*test, counter)), single, options, survey)

    if not survey.contact:
        data, held, survey = _between_blows(data, held, survey, counter)
    chosen = windows_of(data, held, options)
    feet = refinement(chosen.windows[0], base) if survey.contact else 1
    finer = max(feet, math.ceil(chosen.windows[0].dt / _LONGEST - 1e-6))
    if finer == 1:
        return chosen
    # As many windows are wanted as in steps of the model's own.
    data, held = (replace(side, finer=finer, rough=feet > 1) for side in (data, held))
    return windows_of(data, held, replace(options, steps=finer * options.steps))


def _between_blows(data: Data, held: Data, survey: Survey, counter: Counter) -> tuple[Data, Data, Survey]:
    """Recordings whose windows lie between blows, shorter ones where that is needed; as they were where it is not."""
    known = [blows(side, counter) for side in (data, held)]
    if not any(one.any() for side in known for one in side):
        return data, held, survey
    data_between, held_between = (replace(side, blows=own) for side, own in zip((data, held), known, strict=True))
    span = survey.span
    while span >= SHORTEST:
        if min(_covered(side, span) for side in (data_between, held_between)) >= _ENOUGH:
            return data_between, held_between, replace(survey, span=span)
        span /= 2
    return data, held, survey


def _covered(data: Data, span: float) -> float:
    """How much of the recordings windows cover."""
    _, start, k = grid(data, span)
    return k * len(start) / sum(len(r.time) for r in data.recordings)


def pace_notes(windows: Windows) -> tuple[str, ...]:
    """What a reader should know of the time step, in words; nothing where it is the model's own or longer."""
    own = float(windows.models[0].opt.timestep)
    if windows.data.finer == 1:
        return ()
    why = (
        "move feet that touch the ground by more than the sensors would miss"
        if windows.data.rough
        else "are long for what may be missing, such as a friction that sticks"
    )
    return (f"Simulated in steps of {1e3 * windows.dt:g} ms: steps of {1e3 * own:g} ms, as the model has them, {why}.",)
