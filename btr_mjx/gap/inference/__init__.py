"""Search for the missing effect, and decision.

`identify` turns a dataset into a `Diagnosis`. `scoring` evaluates hypotheses on windows, `search` finds and refines
candidates, `verdict` decides which effects are named and computes lack of fit, intervals and confounds.
"""

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import nearest
from btr_mjx.gap.inference.verdict.identify import identify, name_missing

__all__ = [
    "Bench",
    "Hypothesis",
    "identify",
    "name_missing",
    "nearest",
]
