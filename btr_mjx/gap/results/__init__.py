"""What a diagnosis is: its records, its words, its files, and the mended model.

`Diagnosis` holds everything that a report or result.json needs; `saved` writes and reads its files; `wording` puts it
into sentences; `mend` adds what was found to the MJCF.
"""

from btr_mjx.gap.results.mend import Callback
from btr_mjx.gap.results.records import (
    Calibrated,
    Confound,
    Diagnosis,
    DisagreementMap,
    Estimate,
    Gap,
    Named,
    NextExperiment,
    Overlay,
    Refit,
    Row,
    Verdict,
)
from btr_mjx.gap.results.saved import RESULT, as_result, save_diagnosis
from btr_mjx.gap.results.wording import (
    NOT_NAMED,
    likeness,
    moved,
    named,
    number,
    place_in_words,
    title,
    verdict_sentence,
    with_ends,
)

__all__ = [
    "NOT_NAMED",
    "RESULT",
    "Calibrated",
    "Callback",
    "Confound",
    "Diagnosis",
    "DisagreementMap",
    "Estimate",
    "Gap",
    "Named",
    "NextExperiment",
    "Overlay",
    "Refit",
    "Row",
    "Verdict",
    "as_result",
    "likeness",
    "moved",
    "named",
    "number",
    "place_in_words",
    "save_diagnosis",
    "title",
    "verdict_sentence",
    "with_ends",
]
