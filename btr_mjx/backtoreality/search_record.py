"""What is kept and reported of a search: generations, rows of tables, archives."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from btr_mjx.backtoreality.run_state import State
from btr_mjx.optimise import GAState

Report = Callable[[str, dict[str, Any]], None]
"""Callback for results, with their kind.

It is "generation" or "iteration", with a row of a table; "planned", with what the first trials can tell; "growth",
with an entry of `State.sought`; "seeking", with the phase of a search for a missing effect; or "archive" at the end of
a search, with iteration, phase, part (2 for step 3 in a simulator that grew in this iteration), and genomes (g,
population, bits) and scores (g, population) of all generations.
"""


def after_generation(state: State, search: GAState | None, genomes: np.ndarray, scores: np.ndarray) -> State:
    """The state after a generation, genomes (population, bits) with scores (population,), of the present search."""
    first = not len(state.scores)
    return replace(
        state,
        search=search,
        genomes=genomes[None] if first else np.concatenate([state.genomes, genomes[None]]),
        scores=scores[None] if first else np.concatenate([state.scores, scores[None]]),
    )


def generation_row(state: State, phase: str, scores: np.ndarray, maximise: bool) -> dict[str, Any]:
    """The row of the table of the latest generation, with scores (population,)."""
    finite = scores[np.isfinite(scores)]
    top, bottom = (np.max, np.min) if maximise else (np.min, np.max)
    best, mean, worst = (float(of(finite)) if len(finite) else np.nan for of in (top, np.mean, bottom))
    row = {"iteration": state.iteration, "phase": phase, "generation": len(state.scores)}
    return row | {"best": best, "mean": mean, "worst": worst, "diverged": int(len(scores) - len(finite))}


def archive_of(state: State, phase: str) -> dict[str, Any]:
    """The archive of a search that has ended."""
    part = 1 + (phase == "simulations" and state.sought_here)
    archive = {"iteration": state.iteration, "phase": phase, "part": part}
    return archive | {"genomes": state.genomes, "scores": state.scores}


def best_index(values: np.ndarray, maximise: bool) -> int:
    """Index of the best finite value."""
    return int(np.nanargmax(values) if maximise else np.nanargmin(values))
