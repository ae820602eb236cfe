"""The search for the missing effect, and what may be said of it.

`identify` takes a dataset to a `Diagnosis`. `scoring` compares hypotheses with windows, `search` finds and refines
candidates, `verdict` decides what is named, what is left unexplained, and how sure that is.
"""

from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis
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
