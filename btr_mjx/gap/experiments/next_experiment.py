"""Which experiment to run next: the command on which the hypotheses that survived disagree most.

Hypotheses that the data cannot tell apart agree on these data, not on all. Every command that could be tried is
simulated under the leading hypothesis; the others follow in short windows from the same states. What is left of
their difference after the unknown starting states and after a refit of their own numbers is what a recording of that
command would hold against them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.experiments.trial_commands import random_commands
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.results import Diagnosis, NextExperiment
from btr_mjx.gap.simulate import Command, Counter, Stretch, simulate
from btr_mjx.gap.windows import Span, Windows, linearise, prepare
from btr_mjx.models import integrate

_TRIES = 10
"""Random commands that are compared where none are given."""

_WINDOWS = 5
"""Windows along each of them, at most."""

DECISIVE_MARGIN = 25.0
"""Difference of scores that tells two hypotheses apart."""


def propose(
    diagnosis: Diagnosis,
    dataset: Dataset,
    seed: int = 0,
    commands: Sequence[Command] | None = None,
    counter: Counter | None = None,
) -> NextExperiment | None:
    """The next experiment after a diagnosis.

    Args:
      diagnosis: with its surviving hypotheses.
      dataset: where the robot starts, and what commands look like.
      seed: of random commands.
      commands: what could be commanded; None for random variations of the recorded commands.
      counter: of simulated steps.

    Returns:
      The proposal; None where fewer than two hypotheses survived.
    """
    survivors = diagnosis.survivors[:3]
    if len(survivors) < 2:
        return None
    rng = np.random.default_rng(seed)
    commands = commands or random_commands(dataset, rng, _TRIES)
    span = diagnosis.windows[3]
    found = [compare(survivors, dataset, command, diagnosis.sigma, span, counter) for command in commands]
    # The pair that is hardest to separate decides.
    values = np.array([min(pairs.values()) for pairs in found])
    best = int(np.argmax(values))
    pair = min(found[best], key=lambda key: found[best][key])
    command = commands[best]
    names = survivors[pair[0]].name, survivors[pair[1]].name
    middle = float(np.median(values))
    reason = (
        f"one recording of it is expected to separate {names[0]} from {names[1]} by {values[best]:.0f} "
        f"(a typical command: {middle:.0f}; {DECISIVE_MARGIN:.0f} are needed)"
    )
    return NextExperiment(
        command.times, command.values, names, float(values[best]), tuple(map(float, values)), best, reason
    )


def record(
    make: Hypothesis,
    dataset: Dataset,
    command: Command,
    noise: np.ndarray | None,
    rng: np.random.Generator | None = None,
    counter: Counter | None = None,
) -> Recording:
    """A recording of a command in a simulated reality, sampled as the dataset is.

    Args:
      make: the reality.
      dataset: where it starts and how often it samples.
      command: what is commanded.
      noise: (2 nv,) of the sensors; None for none.
      rng: for the noise.
      counter: of simulated steps.
    """
    first = dataset.recordings[0]
    model = first.model
    interval = float(np.median(np.diff(first.time)))
    time = np.arange(0.0, float(command.times[-1]) + 1e-9, interval)
    stretch = Stretch(np.zeros(1), first.qpos[:1], np.nan_to_num(first.qvel[:1]), time, (command,), np.zeros(1, int))
    step = float(model.opt.timestep) / 2
    states = simulate([(make(model), stretch)], timestep=step, counter=counter)[0][0]
    good = np.isfinite(states).all(1)
    last = len(time) if good.all() else max(int(np.argmin(good)), 2)
    qpos, qvel = states[:last, : model.nq], states[:last, model.nq :]
    if noise is not None and rng is not None:
        shift = rng.standard_normal((last, 2 * model.nv)) * noise
        qpos, qvel = integrate(model, qpos, shift[:, : model.nv]), qvel + shift[:, model.nv :]
    return Recording(
        "proposal", time[:last], command.at(time[:last]), qpos, qvel, np.ones(model.nv, bool), "fit", model
    )


def compare(
    survivors: Sequence[Hypothesis],
    dataset: Dataset,
    command: Command,
    sigma: np.ndarray,
    span: float,
    counter: Counter | None = None,
) -> dict[tuple[int, int], float]:
    """Expected differences of scores, for every pair of hypotheses, in one recording of a command.

    Args:
      survivors: at least two hypotheses.
      dataset: where the robot starts and how often it is sampled.
      command: the command.
      sigma: (2 nv,) noise.
      span: length of a window [s], as it suits the dataset.
      counter: of simulated steps.
    """
    recording = record(survivors[0], dataset, command, None, counter=counter)
    found = _judged(survivors, recording, dataset.interpolation, sigma, span, counter)
    if found is None:
        return {(i, j): 0.0 for i in range(len(survivors)) for j in range(i + 1, len(survivors))}
    residuals, columns = found
    out = {}
    for i in range(len(survivors)):
        for j in range(i + 1, len(survivors)):
            # Whichever of the two is true, the other one is refitted to what it does. One with more numbers may do
            # whatever the other does (nothing, for one): what counts there is whether the simpler one can be refuted.
            fewest = min(len(columns[i]), len(columns[j]))
            refitted = [own for own in (columns[i], columns[j]) if len(own) == fewest]
            out[i, j] = min(_left(residuals[j] - residuals[i], own) for own in refitted)
    return out


def margin(
    truth: Hypothesis,
    rival: Hypothesis,
    recordings: Sequence[Recording],
    interpolation: str,
    sigma: np.ndarray,
    span: float,
) -> float:
    """By how much recordings prefer one hypothesis to another, each from starting states and with numbers of its own.

    Args:
      truth: the one.
      rival: the other.
      recordings: to judge by.
      interpolation: of their commands.
      sigma: (2 nv,) noise.
      span: length of a window [s].
    """
    values = []
    for hypothesis in (truth, rival):
        # Starting states that suit one of them would speak for it.
        found = [_judged([hypothesis], recording, interpolation, sigma, span) for recording in recordings]
        parts = [(residuals[0], columns[0]) for residuals, columns in (own for own in found if own is not None)]
        if not parts:
            return 0.0
        residual = np.concatenate([own.ravel() for own, _ in parts])
        columns = np.concatenate([own.reshape(len(own), own[0].size if len(own) else 0) for _, own in parts], axis=1)
        values.append(_left(residual, columns))
    return values[1] - values[0]


def _left(residual: np.ndarray, columns: np.ndarray) -> float:
    """Sum of squares of a residual after a free fit of columns (P, ...)."""
    flat = residual.ravel()
    if not len(columns):
        return float(flat @ flat)
    basis = columns.reshape(len(columns), -1).T
    scale = np.linalg.norm(basis, axis=0)
    basis = basis[:, scale > 0] / scale[scale > 0]
    left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=1e-6)[0] if basis.shape[1] else flat
    return float(left @ left)


def _judged(
    hypotheses: Sequence[Hypothesis],
    recording: Recording,
    interpolation: str,
    sigma: np.ndarray,
    span: float,
    counter: Counter | None = None,
) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """Residuals (W, R) of hypotheses in windows of a recording, and their answers to their own numbers (P, W, R)."""
    interval = float(np.median(np.diff(recording.time)))
    data = prepare([recording], interpolation, sigma, Span(3, 6))
    k = max(6, min(round(span / interval), len(recording.time) - 6))
    last = len(recording.time) - 1 - k
    if last < 4:
        return None
    room = max(1, (len(recording.time) - 4) // k)
    first = np.unique(np.linspace(min(3, last), last, min(_WINDOWS, room)).astype(int))
    windows = Windows(data, np.zeros(len(first), int), first, k, counter)
    linearise(windows, hypotheses[0], steps=2)
    makes, spans = list(hypotheses), []
    for hypothesis in hypotheses:
        values = hypothesis.values(False)
        steps = [abs(p.step) for candidate, _ in hypothesis.effects for p in candidate.parameters]
        spans.append((len(makes), steps))
        for i, step in enumerate(steps):
            makes.append(hypothesis.replaced(values + np.where(np.arange(len(values)) == i, step, 0.0), False))
    found = windows.residuals(makes)
    columns = []
    for n, (start, steps) in enumerate(spans):
        own = [(found[start + i] - found[n]) / step for i, step in enumerate(steps)]
        columns.append(np.stack(own) if own else np.zeros((0, *found[n].shape)))
    return found[: len(hypotheses)], columns


@dataclass(frozen=True)
class Measurement:
    """How what is recorded is compared with hypotheses.

    Attributes:
      sigma: (2 nv,) noise of positions and velocities [rad or m, rad/s or m/s].
      span: length of a window [s].
    """

    sigma: np.ndarray
    span: float


def recordings_needed(
    truth: Hypothesis,
    rival: Hypothesis,
    dataset: Dataset,
    measurement: Measurement,
    rng: np.random.Generator,
    choose: bool,
    most: int = 6,
    commands: Sequence[Command] | None = None,
) -> int:
    """How many recordings a simulated reality must give until two hypotheses are told apart.

    Args:
      truth: the reality.
      rival: the other hypothesis.
      dataset: where the robot starts, and what commands look like.
      measurement: noise, and length of windows.
      rng: for commands and noise.
      choose: take the commands with the largest expected disagreement first, instead of any.
      most: give up after so many.
      commands: to choose from; None for random ones.

    Returns:
      Number of recordings; `most + 1` where they did not suffice.
    """
    sigma, span = measurement.sigma, measurement.span
    commands = commands or random_commands(dataset, rng, _TRIES)
    order = np.arange(len(commands))
    if choose:
        order = np.argsort([-compare([truth, rival], dataset, c, sigma, span)[0, 1] for c in commands])
    recordings: list[Recording] = []
    for i in order[:most]:
        recordings.append(record(truth, dataset, commands[i], sigma, rng))
        if margin(truth, rival, recordings, dataset.interpolation, sigma, span) > DECISIVE_MARGIN:
            return len(recordings)
    return most + 1
