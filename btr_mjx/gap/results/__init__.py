"""Results of a diagnosis: records, sentences, files, and the mended model.

`Diagnosis` holds everything that the page or result.json needs. `save_diagnosis` writes its files, `verdict_sentence`
says it in two sentences, `detail_sentences` the rest. `mend` adds the effects that were found to the MJCF, `Callback`
adds those that MJCF cannot express to a simulation. `added_effects` makes parts of a robot of effects, and
`mended_robot` a space of simulations for Back-to-Reality.
"""

from btr_mjx.gap.results.callback import Callback
from btr_mjx.gap.results.drawn import DisagreementMap, JointForce, Overlay
from btr_mjx.gap.results.effect_simulator import EffectEdit, EffectSimulator, added_effects, write_world
from btr_mjx.gap.results.late_logs import without_late_log
from btr_mjx.gap.results.mended_model import (
    MendedModel,
    found_effects,
    mend,
    resolve_effect,
    with_residual,
)
from btr_mjx.gap.results.mended_space import ControllerTrial, mended_robot
from btr_mjx.gap.results.records import (
    Confound,
    Diagnosis,
    Estimate,
    FoundEffect,
    Gap,
    JointError,
    NamedEffect,
    Predictions,
    RankedCandidate,
    Refit,
    Verdict,
)
from btr_mjx.gap.results.result_folder import RESULT, as_result, before_entry, save_diagnosis
from btr_mjx.gap.results.simulation_file import simulation_mjcf
from btr_mjx.gap.results.tables import NextExperiment, Quantity, save_quantities
from btr_mjx.gap.results.words.details import detail_sentences
from btr_mjx.gap.results.words.effects import (
    confound_sentence,
    effect_at_place,
    effect_title,
    hypothesis_in_words,
    number_in_words,
    place_in_words,
)
from btr_mjx.gap.results.words.terms import (
    REASON_NOT_NAMED,
    error_in_words,
    estimate_cells,
    format_number,
    in_percent,
    in_reading_unit,
    parameter_in_words,
    parameters_in_words,
    refit_sentence,
    unit_in_words,
)
from btr_mjx.gap.results.words.verdict import verdict_sentence

__all__ = [
    "REASON_NOT_NAMED",
    "RESULT",
    "Callback",
    "Confound",
    "ControllerTrial",
    "Diagnosis",
    "DisagreementMap",
    "EffectEdit",
    "EffectSimulator",
    "Estimate",
    "FoundEffect",
    "Gap",
    "JointError",
    "JointForce",
    "MendedModel",
    "NamedEffect",
    "NextExperiment",
    "Overlay",
    "Predictions",
    "Quantity",
    "RankedCandidate",
    "Refit",
    "Verdict",
    "added_effects",
    "as_result",
    "before_entry",
    "confound_sentence",
    "detail_sentences",
    "effect_at_place",
    "effect_title",
    "error_in_words",
    "estimate_cells",
    "format_number",
    "found_effects",
    "hypothesis_in_words",
    "in_percent",
    "in_reading_unit",
    "mend",
    "mended_robot",
    "number_in_words",
    "parameter_in_words",
    "parameters_in_words",
    "place_in_words",
    "refit_sentence",
    "resolve_effect",
    "save_diagnosis",
    "save_quantities",
    "simulation_mjcf",
    "unit_in_words",
    "verdict_sentence",
    "with_residual",
    "without_late_log",
    "write_world",
]
