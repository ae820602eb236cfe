"""Commands that act before the time that is logged: no robot does that, and so it is the log that is late."""

from dataclasses import replace

from btr_mjx.gap.effects import TIMING
from btr_mjx.gap.results.diagnosis import Diagnosis
from btr_mjx.gap.results.records import NamedEffect


def without_late_log(diagnosis: Diagnosis) -> Diagnosis:
    """A diagnosis in which late time stamps of commands are told as the log's fault, and never as an effect.

    Args:
      diagnosis: in which a negative delay may be named.

    Returns:
      The same one where none is; of verdict "none" where nothing else was named.
    """
    late = [effect for effect in diagnosis.found if _is_of_the_log(effect)]
    if not late:
        return diagnosis
    found = tuple(effect for effect in diagnosis.found if effect not in late)
    times = [-1e3 * delay.value for effect in late for delay in effect.parameters.values()]
    said = tuple(f"Commands act {time:.3g} ms before the time that is logged: their stamps are late." for time in times)
    told = replace(diagnosis, found=found, notes=(*diagnosis.notes, *said))
    return told if told.verdict == "effect" else replace(told, equivalent=(), confounds=())


def _is_of_the_log(effect: NamedEffect) -> bool:
    return effect.effect == TIMING and all(own.value < 0 for own in effect.parameters.values())
