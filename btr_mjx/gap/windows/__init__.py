"""Multiple shooting: short windows of recordings with unknown starting states, and their linearisation.

`prepare` collects recordings, noise and activation states. `choose_windows` places windows and sets the time step.
`Windows` simulates hypotheses and computes residuals with the starting states projected out. `linearise` fits starting
states and differentiates; `signatures` are derivatives of residuals with respect to parameters.
"""

from btr_mjx.gap.windows.impacts import contact_samples
from btr_mjx.gap.windows.linearisation import linearise, relinearised
from btr_mjx.gap.windows.options import Options
from btr_mjx.gap.windows.placement import Survey, survey, tile_windows
from btr_mjx.gap.windows.planning import choose_windows, time_step_notes
from btr_mjx.gap.windows.prepared import PreparedData, prepare, scales_of, track_of
from btr_mjx.gap.windows.rows import select_rows
from btr_mjx.gap.windows.sensitivity import force_signatures, signatures, window_parts
from btr_mjx.gap.windows.starting_states import fit_starting_states, with_fitted_states
from btr_mjx.gap.windows.state_estimate import Span, Track, best_span, smooth
from btr_mjx.gap.windows.time_steps import fine_step, reliable_windows, step_uncertainty
from btr_mjx.gap.windows.window_fits import (
    Evidence,
    Fit,
    bounded_loss,
    fit,
    project,
    regularised,
    scan_candidates,
    typical_chi2,
    window_weight,
)
from btr_mjx.gap.windows.windows import MakeWorld, Windows

__all__ = [
    "Evidence",
    "Fit",
    "MakeWorld",
    "Options",
    "PreparedData",
    "Span",
    "Survey",
    "Track",
    "Windows",
    "best_span",
    "bounded_loss",
    "choose_windows",
    "contact_samples",
    "fine_step",
    "fit",
    "fit_starting_states",
    "force_signatures",
    "linearise",
    "prepare",
    "project",
    "regularised",
    "reliable_windows",
    "relinearised",
    "scales_of",
    "scan_candidates",
    "select_rows",
    "signatures",
    "smooth",
    "step_uncertainty",
    "survey",
    "tile_windows",
    "time_step_notes",
    "track_of",
    "typical_chi2",
    "window_parts",
    "window_weight",
    "with_fitted_states",
]
