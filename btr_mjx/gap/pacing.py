"""Windows of both sides of the split, in time steps that suit the data.

A robot that touches the world is simulated in shorter steps than its model asks for where these move its states by more
than sensors would miss: what is left of that then looks like something missing.
"""

from dataclasses import dataclass, replace

from btr_mjx.gap.hypotheses import Hypothesis
from btr_mjx.gap.planning import Survey, plan
from btr_mjx.gap.prepared import Data
from btr_mjx.gap.search_records import Options
from btr_mjx.gap.time_steps import refinement
from btr_mjx.gap.windows import Windows
from btr_mjx.gap.worlds import Counter


@dataclass(frozen=True)
class Chosen:
    """Windows, and what follows from how they are simulated.

    Attributes:
      windows: to fit and held out, not linearised.
      single: whether candidates are looked at in single steps, see `sensitivity.signatures`.
      options: how much is spent, in steps of the length that is taken.
    """

    windows: tuple[Windows, Windows]
    single: bool
    options: Options


def chosen_windows(
    data: Data, held: Data, base: Hypothesis, survey: Survey, count: int, options: Options, counter: Counter
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
        fit, test, single = plan(data, held, survey.span, count, options, counter)
        return Chosen((Windows(*fit, counter), Windows(*test, counter)), single, options)

    chosen = windows_of(data, held, options)
    finer = refinement(chosen.windows[0], base) if survey.contact else 1
    if finer == 1:
        return chosen
    # As many windows are wanted as in steps of the model's own.
    data, held = replace(data, finer=finer), replace(held, finer=finer)
    return windows_of(data, held, replace(options, steps=finer * options.steps))


def pace_notes(windows: Windows) -> tuple[str, ...]:
    """What a reader should know of the time step, in words; nothing where it is the model's own or longer."""
    own = float(windows.models[0].opt.timestep)
    if windows.data.finer == 1:
        return ()
    return (
        f"Simulated in steps of {1e3 * windows.dt:g} ms: steps of {1e3 * own:g} ms, as the model has them, move feet "
        "that touch the ground by more than the sensors would miss.",
    )
