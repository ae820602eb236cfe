"""Results of a diagnosis: records, sentences, files, and the mended model.

`Diagnosis` holds everything that the page or result.json needs. `save_diagnosis` writes its files, `verdict_sentence`
says it in two sentences, `detail_sentences` the rest. `mend` adds the effects that were found to the MJCF, `Callback`
adds those that MJCF cannot express to a simulation. `added_effects` makes parts of a robot of effects, and
`mended_robot` a space of simulations for Back-to-Reality.
"""

from btr_mjx.gap.results.callback import Callback
from btr_mjx.gap.results.diagnosis import (
    DELTA_FITNESS,
    NOISE_REACHED,
    Chi2,
    Diagnosis,
    JointError,
    MendedKind,
    Misfit,
    OpenLoop,
    Verdict,
    misfit_of,
    verdict_of,
)
from btr_mjx.gap.results.drawn import DisagreementMap, JointForce, Overlay, force_places, mean_map
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
    BEYOND_TOLERANCE,
    Confound,
    Estimate,
    FoundEffect,
    NamedEffect,
    RankedCandidate,
    Refit,
)
from btr_mjx.gap.results.result_folder import RESULT, as_result, before_entry, save_diagnosis
from btr_mjx.gap.results.simulation_file import simulation_mjcf
from btr_mjx.gap.results.tables import NextExperiment, Quantity, save_quantities
from btr_mjx.gap.results.words.details import detail_sentences, detail_statements
from btr_mjx.gap.results.words.effects import (
    confound_sentence,
    effect_at_place,
    effect_title,
    enumerated,
    hypotheses_of,
    hypothesis_in_words,
    number_in_words,
    place_in_words,
    quantity_at_place,
    together_in_words,
)
from btr_mjx.gap.results.words.levels import SCALE, Levels, joint_rows, misfit_in_words, off_by, times_noise
from btr_mjx.gap.results.words.mended import MENDED_FILE, mended_in_words
from btr_mjx.gap.results.words.terms import (
    REASON_NOT_NAMED,
    as_float,
    error_in_words,
    estimate_cells,
    format_number,
    in_percent,
    in_reading_unit,
    parameter_in_words,
    parameters_in_words,
    refit_sentence,
    score_in_words,
    size_in_words,
    unit_in_words,
)
from btr_mjx.gap.results.words.verdict import (
    off_calibration,
    verdict_sentence,
    verdict_statements,
)

__all__ = [
    "BEYOND_TOLERANCE",
    "DELTA_FITNESS",
    "MENDED_FILE",
    "NOISE_REACHED",
    "REASON_NOT_NAMED",
    "RESULT",
    "SCALE",
    "Callback",
    "Chi2",
    "Confound",
    "ControllerTrial",
    "Diagnosis",
    "DisagreementMap",
    "EffectEdit",
    "EffectSimulator",
    "Estimate",
    "FoundEffect",
    "JointError",
    "JointForce",
    "Levels",
    "MendedKind",
    "MendedModel",
    "Misfit",
    "NamedEffect",
    "NextExperiment",
    "OpenLoop",
    "Overlay",
    "Quantity",
    "RankedCandidate",
    "Refit",
    "Verdict",
    "added_effects",
    "as_float",
    "as_result",
    "before_entry",
    "confound_sentence",
    "detail_sentences",
    "detail_statements",
    "effect_at_place",
    "effect_title",
    "enumerated",
    "error_in_words",
    "estimate_cells",
    "force_places",
    "format_number",
    "found_effects",
    "hypotheses_of",
    "hypothesis_in_words",
    "in_percent",
    "in_reading_unit",
    "joint_rows",
    "mean_map",
    "mend",
    "mended_in_words",
    "mended_robot",
    "misfit_in_words",
    "misfit_of",
    "number_in_words",
    "off_by",
    "off_calibration",
    "parameter_in_words",
    "parameters_in_words",
    "place_in_words",
    "quantity_at_place",
    "refit_sentence",
    "resolve_effect",
    "save_diagnosis",
    "save_quantities",
    "score_in_words",
    "simulation_mjcf",
    "size_in_words",
    "times_noise",
    "together_in_words",
    "unit_in_words",
    "verdict_of",
    "verdict_sentence",
    "verdict_statements",
    "with_residual",
    "without_late_log",
    "write_world",
]
