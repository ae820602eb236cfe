"""Sentences of a diagnosis: functions of the entries of result.json that return text and compute nothing else.

`terms` has words for effects, places and numbers, `verdict` the verdict and its details, `changes` what has changed
from one set of recordings to the next.
"""

from btr_mjx.gap.results.words.terms import (
    REASON_NOT_NAMED,
    confound_sentence,
    effect_at_place,
    effect_title,
    error_in_words,
    estimate_cells,
    format_number,
    hypothesis_in_words,
    in_percent,
    in_reading_unit,
    number_in_words,
    parameter_in_words,
    parameters_in_words,
    place_in_words,
    refit_sentence,
    unit_in_words,
)
from btr_mjx.gap.results.words.verdict import detail_sentences, verdict_sentence

__all__ = [
    "REASON_NOT_NAMED",
    "confound_sentence",
    "detail_sentences",
    "effect_at_place",
    "effect_title",
    "error_in_words",
    "estimate_cells",
    "format_number",
    "hypothesis_in_words",
    "in_percent",
    "in_reading_unit",
    "number_in_words",
    "parameter_in_words",
    "parameters_in_words",
    "place_in_words",
    "refit_sentence",
    "unit_in_words",
    "verdict_sentence",
]
