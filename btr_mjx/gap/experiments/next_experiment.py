"""The next experiment: the command on which the surviving hypotheses disagree most.

Hypotheses that the recorded data cannot distinguish may differ under another command. Every candidate command is
simulated under the leading hypothesis; the other hypotheses are simulated in short windows from the same states. With r
the difference of two hypotheses' residuals in units of the noise, starting states projected out, and C the derivatives
with respect to the parameters of the hypothesis that is wrong, the expected difference of scores is

    min over a of  |r - C a|^2
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.experiments.safe_motion import stays_near_recordings
from btr_mjx.gap.experiments.trial_commands import random_commands
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.results import Diagnosis, NextExperiment, hypothesis_in_words
from btr_mjx.gap.simulate import Command, Counter, Segments, simulate
from btr_mjx.gap.windows import Span, Windows, linearise, prepare

_RANDOM_COMMANDS = 10
"""Number of random commands that are compared."""

_MAX_WINDOWS = 5
"""Largest number of windows along a command."""

_STARTS = 3
"""States in which a command begins where it is asked whether the robot survives it."""

DECISIVE_MARGIN = 25.0
"""Difference of scores from which on two hypotheses count as separated, in units of twice the log-likelihood."""

LEAST_MARGIN = 1.0
"""Expected difference of scores below which a command is not proposed: noise moves the difference by more."""


def propose(
    diagnosis: Diagnosis,
    dataset: Dataset,
    seed: int = 0,
    counter: Counter | None = None,
) -> NextExperiment | None:
    """The next experiment after a diagnosis.

    Args:
      diagnosis: diagnosis with its surviving hypotheses.
      dataset: the dataset; new recordings start like its first one.
      seed: seed of the random commands.
      counter: counts the simulated steps.

    Returns:
      The proposal; None where fewer than two hypotheses survived, where nothing takes a command, or where no command
      that the robot survives is expected to separate them by `LEAST_MARGIN`.
    """
    survivors = diagnosis.survivors[:3]
    if len(survivors) < 2 or not dataset.model.nu or diagnosis.windows is None or diagnosis.sigma is None:
        return None
    rng = np.random.default_rng(seed)
    commands = [
        command
        for command in random_commands(dataset, rng, _RANDOM_COMMANDS)
        if is_survived(command, survivors, dataset, counter)
    ]
    if not commands:
        return None
    span, sigma = diagnosis.windows[3], diagnosis.sigma
    found = [expected_margins(survivors, dataset, command, sigma, span, counter) for command in commands]
    # A command is rated by the pair that it separates least.
    values = np.array([min(pairs.values()) for pairs in found])
    best = int(np.argmax(values))
    if values[best] < LEAST_MARGIN:
        return None
    pair = min(found[best], key=lambda key: found[best][key])
    command = commands[best]
    names = survivors[pair[0]].name, survivors[pair[1]].name
    middle = float(np.median(values))
    reason = (
        f"one recording of it is expected to separate {hypothesis_in_words(names[0])} from "
        f"{hypothesis_in_words(names[1])} by a score of {values[best]:.0f} "
        f"(a typical command: {middle:.0f}; {DECISIVE_MARGIN:.0f} are needed)"
    )
    return NextExperiment(
        command.times, command.values, names, float(values[best]), tuple(map(float, values)), best, reason
    )


def is_survived(
    command: Command, survivors: Sequence[Hypothesis], dataset: Dataset, counter: Counter | None = None
) -> bool:
    """Whether the robot stays near where it has been under a command, whichever hypothesis is true.

    The command begins in states from all over a recording: what holds itself forgets them, what needs feedback does
    not.

    Args:
      command: the command.
      survivors: hypotheses.
      dataset: source of the initial state, of the sampling rate, and of where the robot has been.
      counter: counts the simulated steps.
    """
    starts = np.linspace(0, len(dataset.recordings[0].time) - 1, _STARTS).astype(int)
    motions = (simulate_recording(own, dataset, command, counter, start) for own in survivors for start in starts)
    return all(
        motion.time[-1] >= command.times[-1] - 2 * float(np.diff(motion.time).max())
        and stays_near_recordings(motion, dataset)
        for motion in motions
    )


def simulate_recording(
    reality: Hypothesis,
    dataset: Dataset,
    command: Command,
    counter: Counter | None = None,
    start: int = 0,
) -> Recording:
    """A command in a simulated reality, recorded without noise, with a state and the sampling rate of a dataset.

    Args:
      reality: hypothesis that is simulated as reality, at half the model's time step.
      dataset: source of the initial state and of the sampling rate.
      command: the command.
      counter: counts the simulated steps.
      start: sample of the first recording at whose state the motion begins.

    Returns:
      The recording, cut where the simulation diverges.
    """
    first = dataset.recordings[0]
    model = first.model
    interval = float(np.median(np.diff(first.time)))
    time = np.arange(0.0, float(command.times[-1]) + 1e-9, interval)
    qpos, qvel = first.qpos[start : start + 1], np.nan_to_num(first.qvel[start : start + 1])
    segments = Segments(np.zeros(1), qpos, qvel, time, (command,), np.zeros(1, int))
    step = float(model.opt.timestep) / 2
    states = simulate([(reality(model), segments)], timestep=step, counter=counter)[0][0]
    good = np.isfinite(states).all(1)
    last = len(time) if good.all() else max(int(np.argmin(good)), 2)
    qpos, qvel = states[:last, : model.nq], states[:last, model.nq :]
    known, kind = np.ones(model.nv, bool), command.interpolation
    ctrl = command.at(time[:last])
    return Recording("proposal", time[:last], ctrl, qpos, qvel, known, "fit", model, interpolation=kind)


def expected_margins(
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
      dataset: source of the initial state and of the sampling rate.
      command: the command.
      sigma: (2 nv,) noise of positions and velocities.
      span: length of a window [s].
      counter: counts the simulated steps.

    Returns:
      Differences by pair of indices (i, j), i < j.
    """
    recording = simulate_recording(survivors[0], dataset, command, counter)
    found = in_windows(survivors, recording, sigma, span, counter)
    if found is None:
        return {(i, j): 0.0 for i in range(len(survivors)) for j in range(i + 1, len(survivors))}
    residuals, columns = found
    out = {}
    for i in range(len(survivors)):
        for j in range(i + 1, len(survivors)):
            # The wrong one of the two is refitted to the true one. A hypothesis with more parameters may contain the
            # other one; then only the refit of the simpler hypothesis is informative.
            fewest = min(len(columns[i]), len(columns[j]))
            refitted = [own for own in (columns[i], columns[j]) if len(own) == fewest]
            out[i, j] = min(after_fit(residuals[j] - residuals[i], own) for own in refitted)
    return out


def after_fit(residual: np.ndarray, columns: np.ndarray) -> float:
    """Sum of squares of a residual after a least-squares fit of columns (P, ...)."""
    flat = residual.ravel()
    if not len(columns):
        return float(flat @ flat)
    basis = columns.reshape(len(columns), -1).T
    scale = np.linalg.norm(basis, axis=0)
    basis = basis[:, scale > 0] / scale[scale > 0]
    left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=1e-6)[0] if basis.shape[1] else flat
    return float(left @ left)


def in_windows(
    hypotheses: Sequence[Hypothesis],
    recording: Recording,
    sigma: np.ndarray,
    span: float,
    counter: Counter | None = None,
) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """Residuals (W, R) of hypotheses in windows, and derivatives (P, W, R) by their parameters; None if too short."""
    interval = float(np.median(np.diff(recording.time)))
    data = prepare([recording], sigma, Span(3, 6))
    k = max(6, min(round(span / interval), len(recording.time) - 6))
    last = len(recording.time) - 1 - k
    if last < 4:
        return None
    room = max(1, (len(recording.time) - 4) // k)
    first = np.unique(np.linspace(min(3, last), last, min(_MAX_WINDOWS, room)).astype(int))
    windows = linearise(Windows(data, np.zeros(len(first), int), first, k, counter), hypotheses[0], steps=2)
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
