"""Co-evolution in a run folder: saved after every piece of work, resumable from the last checkpoint."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from btr_mjx.backtoreality.algorithm import advance, begin
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import growth_sentence
from btr_mjx.backtoreality.reality import SimulatedReality, Waiting
from btr_mjx.backtoreality.run_state import Phase, Problem, State, state_from_arrays, state_to_arrays
from btr_mjx.backtoreality.search_record import Report
from btr_mjx.backtoreality.trial_information import slope_simulations
from btr_mjx.gap.simulate import Journal, followed_search
from btr_mjx.models import robot_digest
from btr_mjx.runs import RunFolder, StopRequest, content_digest, note, progress, say_progress, write_arrays


def run_in_folder(problem: Problem, run: RunFolder, stop: StopRequest, show: bool, wait: bool = False) -> State:
    """The last state of a co-evolution that is run from the last checkpoint of its folder to the end.

    The folder gets checkpoints, generations.csv, iterations.csv and the archives of both searches. With `wait`,
    measurements that are missing are waited for.

    Raises:
      Waiting: measurements are missing, and not waited for; a resumed run asks for the same ones.
      Interrupted: a signal asked to stop; everything up to the last generation is saved.
    """
    checkpoint = run.load_latest()
    tables = {name: run.history(f"{name}s.csv", checkpoint) for name in ("generation", "iteration")}
    if checkpoint is None:
        state, step = begin(problem), 0
    else:
        state, step = state_from_arrays(checkpoint.arrays, checkpoint.meta), checkpoint.step + 1

    first = step
    remark: Callable[[str], None] = note if show else lambda line: None

    def report(say: Callable[[str], None] | None, kind: str, row: dict[str, Any]) -> None:
        if kind == "archive":
            run.add_file(_write_archive(run.path, grown(problem, state.grown), row))
        elif kind == "growth":
            remark(growth_sentence(row))
        elif kind == "planned":
            remark(f"before the first trials: {row['told']}")
        elif kind == "seeking":
            assert say is not None
            say(row["phase"])
        else:
            tables[kind].append(row)
            if kind == "iteration":
                remark(f"iteration {row['iteration']}: {row['told']}")

    show = show and state.phase != "done"
    with progress(total=int(_pairs_left(problem, state)), description="pairs", unit="pairs", show=show) as bar:
        problem = replace(problem, progress=bar.update)
        while state.phase != "done":
            phase, text = state.phase, f"iteration {state.iteration}: {_PHASE_TEXTS[state.phase]}"
            # Programs are compiled in the first controller's trial and the first generation: their rate says nothing.
            compiling = phase == "baseline" or (phase == "controllers" and step <= first + 1)
            say_progress(bar, f"{text} (compiling)" if compiling else text, numbers=not compiling)
            with _journal_of(run.path / _JOURNAL, phase, stop, show) as (journal, say):
                state = _advanced(problem, state, partial(report, say), stop, bar if wait else None, journal)
            if phase in ("simulations", "growth") and phase != state.phase:  # more or less may be left than was thought
                bar.total = bar.n + int(_pairs_left(problem, state))
            run.save_checkpoint(step, *state_to_arrays(state))
            if journal is not None:
                journal.close()
            step += 1
            stop.checkpoint()
    return state


@contextmanager
def _journal_of(
    folder: Path, phase: Phase, stop: StopRequest, show: bool
) -> Iterator[tuple[Journal | None, Callable[[str], None] | None]]:
    """The journal of a search for a missing effect, which stops anywhere, and its progress; nothing in other phases."""
    if phase != "growth":
        yield None, None
        return
    with stop.anywhere(), followed_search(folder, stop.checkpoint, show=show) as found:
        yield found


def _advanced(
    problem: Problem, state: State, report: Report, stop: StopRequest, bar: Any, journal: Journal | None
) -> State:
    """The next state; measurements that are missing are waited for where there is a bar that can say so."""
    told: tuple[Any, ...] = ()
    while True:
        try:
            return advance(problem, state, report, journal)
        except Waiting as waiting:
            if bar is None:
                raise
            names = ", ".join(map(str, waiting.missing[:6])) + (", ..." if len(waiting.missing) > 6 else "")
            plural = "s" if len(waiting.missing) > 1 else ""
            say_progress(bar, f"iteration {state.iteration}: waiting for trial{plural} {names}", numbers=False)
            if told != (waiting.missing, waiting.complaints):
                told = (waiting.missing, waiting.complaints)
                for line in (*waiting.complaints, str(waiting)):
                    note(line)
        stop.checkpoint()
        time.sleep(_POLL)


_JOURNAL = "search"
"""Folder of what a search for a missing effect has simulated, from which a resumed run goes on."""

_POLL = 0.5
"""Time between two looks at the exchange folder [s]."""

_PHASE_TEXTS = {
    "baseline": "first controller",
    "controllers": "evolving controllers",
    "transfer": "trying controllers in reality",
    "simulations": "evolving simulations",
    "growth": "looking for a missing effect",
}


def whole_trials(problem: Problem) -> int:
    """Trials of the whole length that take as long as all pairs of a run, if no stop criterion is met early."""
    marks = problem.settings.marks if problem.settings.compared == "multiscale" else (problem.robot.duration,)
    return int(_pairs_left(problem, begin(problem), marks[-1] / problem.robot.duration))


def _pairs_left(problem: Problem, state: State, step_3: float = 1) -> float:
    """Pairs that remain to be simulated if no stop criterion is met early (an estimate after a resume).

    Those of step 3 count `step_3` each.
    """
    settings = problem.settings
    if state.phase == "done":
        return 0
    left: float = state.phase == "baseline"
    slopes = slope_simulations(problem)
    if state.iteration == 1 and state.phase in ("baseline", "controllers"):
        left += slopes * settings.trials
    for iteration in range(state.iteration + (state.phase == "growth"), settings.iterations + 1):
        behaviours = settings.trials * (iteration if settings.behaviours == "all" else 1)
        done = len(state.scores) if iteration == state.iteration and state.phase != "transfer" else 0
        if iteration > state.iteration or state.phase in ("baseline", "controllers"):
            left += settings.ensemble * settings.controllers * (settings.controller_generations - done) + behaviours
            done = 0
        left += step_3 * settings.simulations * behaviours * (settings.simulation_generations - done)
        left += slopes * behaviours
    return left


def _write_archive(folder: Path, problem: Problem, row: dict[str, Any]) -> str:
    """Write all members of one search, the same bytes if it is written again after a resume; the file's name."""
    box = problem.controller_box if row["phase"] == "controllers" else problem.simulation_box
    name = "fitness" if row["phase"] == "controllers" else "delta_fitness"
    arrays = {"parameters": box.decode(row["genomes"]), name: row["scores"], "names": np.array(box.names)}
    part = "" if row["part"] == 1 else f"-{row['part']}"
    file = f"{row['phase']}-{row['iteration']:03d}{part}.npz"
    write_arrays(folder / file, arrays, compress=True)
    return file


def inputs_of(problem: Problem) -> dict[str, str]:
    """What a resumed run must find unchanged, in words -> its digest."""
    inputs = {"the robot": robot_digest(problem.robot), "the fitness function": content_digest(problem.fitness)}
    if isinstance(problem.reality, SimulatedReality):
        inputs["the hidden reality"] = robot_digest(problem.reality.robot)
    return inputs
