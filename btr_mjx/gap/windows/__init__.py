"""Short windows of the recordings: multiple shooting with unknown starting states.

`prepare` estimates states from noisy samples, `chosen_windows` says which windows are looked at and with which time
step, `Windows` simulates hypotheses over them, `signatures` tells how residuals answer to small changes of a world.
"""

from btr_mjx.gap.windows.likelihood import (
    Evidence,
    Fit,
    bounded,
    fit,
    project,
    scan_candidates,
    steadied,
    typical_chi2,
    weight,
)
from btr_mjx.gap.windows.linearisation import linearise, redirected
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.pacing import chosen_windows, pace_notes
from btr_mjx.gap.windows.placement import Survey, grid, survey
from btr_mjx.gap.windows.prepared import Data, prepare, scales_of, track_of
from btr_mjx.gap.windows.rows import picked
from btr_mjx.gap.windows.sensitivity import force_signatures, parts, signatures
from btr_mjx.gap.windows.starting_states import centred, exactly, recentred
from btr_mjx.gap.windows.state_estimate import Span, Track, best_span, smooth
from btr_mjx.gap.windows.time_steps import fine_step, kept, step_doubt
from btr_mjx.gap.windows.windows import MakeWorld, Windows

__all__ = [
    "Data",
    "Evidence",
    "Fit",
    "MakeWorld",
    "Options",
    "Span",
    "Survey",
    "Track",
    "Windows",
    "best_span",
    "bounded",
    "centred",
    "chosen_windows",
    "exactly",
    "fine_step",
    "fit",
    "force_signatures",
    "grid",
    "kept",
    "linearise",
    "pace_notes",
    "parts",
    "picked",
    "prepare",
    "project",
    "recentred",
    "redirected",
    "scales_of",
    "scan_candidates",
    "signatures",
    "smooth",
    "steadied",
    "step_doubt",
    "survey",
    "track_of",
    "typical_chi2",
    "weight",
]
