"""What a check of the installation returns."""

from dataclasses import dataclass
from typing import Literal

HealthState = Literal["ok", "warning", "off"]
"""ok: as expected. warning: the package works, but slower or with less. off: something does not work."""


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check.

    Attributes:
      state: see `HealthState`.
      finding: what was found, in one line.
      remedy: what to do about it; empty where nothing needs to be done.
    """

    state: HealthState
    finding: str
    remedy: str = ""


def worst(*results: CheckResult) -> CheckResult:
    """The first of the most serious results; all findings of that seriousness, joined.

    Remedies of lesser results are dropped: the user repairs the worst first and runs the command again.
    """
    order: tuple[HealthState, ...] = ("off", "warning", "ok")
    state = min((result.state for result in results), key=order.index)
    chosen = [result for result in results if result.state == state]
    remedies = dict.fromkeys(result.remedy for result in chosen if result.remedy)
    return CheckResult(state, "; ".join(result.finding for result in chosen), "; ".join(remedies))
