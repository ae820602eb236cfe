"""Which experiment to run next: the command on which the hypotheses that survived disagree most.

Hypotheses that the data cannot tell apart agree on these data, not on all. Every command that could be tried is
simulated under the leading hypothesis; the others follow in short windows from the same states. What is left of
their difference after the unknown starting states and after a refit of their own numbers is what a recording of that
command would hold against them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.commands import Command
from btr_mjx.gap.diagnosis import Diagnosis
from btr_mjx.gap.hypotheses import Hypothesis
from btr_mjx.gap.planning import CONTACT_SPAN
from btr_mjx.gap.prepared import prepare
from btr_mjx.gap.recording import Recording
from btr_mjx.gap.recordings import Dataset
from btr_mjx.gap.smoothing import Span
from btr_mjx.gap.tangent import integrate
from btr_mjx.gap.windows import Windows
from btr_mjx.gap.worlds import Counter, Stretch, simulate

_TRIES = 10
"""Random commands that are compared where none are given."""

_WINDOWS = 5
"""Windows along each of them."""

_DURATION = 2.0
"""Longest command that is tried [s]."""

MARGIN = 25.0
"""Difference of scores that tells two hypotheses apart."""


@dataclass(frozen=True)
class NextExperiment:
    """A proposal.

    Attributes:
      time: (K,) [s].
      values: (K, nu) command.
      between: the two names that it is expected to separate.
      disagreement: expected difference of their scores in one recording.
      others: the same for every command that was compared, in their order.
      chosen: which of these it is.
      reason: in words.
    """

    time: np.ndarray
    values: np.ndarray
    between: tuple[str, str]
    disagreement: float
    others: tuple[float, ...]
    chosen: int
    reason: str


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
    found = [compare(survivors, dataset, command, diagnosis.sigma, counter) for command in commands]
    # The pair that is hardest to separate decides.
    values = np.array([min(pairs.values()) for pairs in found])
    best = int(np.argmax(values))
    pair = min(found[best], key=lambda key: found[best][key])
    command = commands[best]
    names = survivors[pair[0]].name, survivors[pair[1]].name
    middle = float(np.median(values))
    reason = (
        f"one recording of it is expected to separate {names[0]} from {names[1]} by {values[best]:.0f} "
        f"(a typical command: {middle:.0f}; {MARGIN:.0f} are needed)"
    )
    return NextExperiment(
        command.times, command.values, names, float(values[best]), tuple(map(float, values)), best, reason
    )


def random_commands(dataset: Dataset, rng: np.random.Generator, count: int) -> list[Command]:
    """Variations of the recorded commands: other amplitudes, faster or slower, other channels in step.

    They stay inside the actuators' control ranges, and within twice the recorded range where there is none.
    """
    model = dataset.model
    out = []
    for _ in range(count):
        recording = dataset.recordings[int(rng.integers(len(dataset.recordings)))]
        time, ctrl = recording.time - recording.time[0], recording.ctrl
        duration = min(float(time[-1]), _DURATION)
        steps = max(2, int(duration / np.median(np.diff(time))))
        at = np.linspace(0.0, duration, steps)
        speed = float(np.exp(rng.uniform(np.log(0.5), np.log(1.8))))
        centre = 0.5 * (ctrl.min(0) + ctrl.max(0))
        values = np.empty((steps, model.nu))
        for channel in range(model.nu):
            warped = np.abs((at * speed + rng.uniform(0, 0.2) * time[-1]) % (2 * time[-1]))
            warped = np.where(warped > time[-1], 2 * time[-1] - warped, warped)  # there and back again
            size = rng.uniform(0.3, 1.6)
            values[:, channel] = centre[channel] + size * (np.interp(warped, time, ctrl[:, channel]) - centre[channel])
        reach = np.ptp(ctrl, axis=0)
        low, high = ctrl.min(0) - 0.5 * reach, ctrl.max(0) + 0.5 * reach
        limited = _limited(model)
        low = np.where(limited, np.maximum(low, _range(model)[0]), low)
        high = np.where(limited, np.minimum(high, _range(model)[1]), high)
        out.append(Command(at, np.clip(values, low, high), dataset.interpolation))
    return out


def _limited(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) bool: controls with a range of their own."""
    out = np.zeros(model.nu, bool)
    for actuator, first in enumerate(model.actuator_ctrladr):
        out[first] = bool(model.actuator_ctrllimited[actuator])
    return out


def _range(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Ranges of the controls (nu,), unlimited where they have none."""
    low, high = np.full(model.nu, -np.inf), np.full(model.nu, np.inf)
    for actuator, first in enumerate(model.actuator_ctrladr):
        if model.actuator_ctrllimited[actuator]:
            low[first], high[first] = model.actuator_ctrlrange[actuator]
    return low, high


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
    counter: Counter | None = None,
) -> dict[tuple[int, int], float]:
    """Expected differences of scores, for every pair of hypotheses, in one recording of a command.

    Args:
      survivors: at least two hypotheses.
      dataset: where the robot starts and how often it is sampled.
      command: the command.
      sigma: (2 nv,) noise.
      counter: of simulated steps.
    """
    recording = record(survivors[0], dataset, command, None, counter=counter)
    found = _judged(survivors, recording, dataset.interpolation, sigma, counter)
    if found is None:
        return {(i, j): 0.0 for i in range(len(survivors)) for j in range(i + 1, len(survivors))}
    residuals, columns = found
    out = {}
    for i in range(len(survivors)):
        for j in range(i + 1, len(survivors)):
            out[i, j] = _left(residuals[j] - residuals[i], np.concatenate([columns[i], columns[j]]))
    return out


def margin(
    truth: Hypothesis, rival: Hypothesis, recordings: Sequence[Recording], interpolation: str, sigma: np.ndarray
) -> float:
    """By how much recordings prefer one hypothesis to another, both refitted in the linear picture."""
    total = []
    for recording in recordings:
        found = _judged([truth, rival], recording, interpolation, sigma)
        if found is not None:
            total.append(found)
    if not total:
        return 0.0
    values = []
    for i in (0, 1):
        residual = np.concatenate([residuals[i].ravel() for residuals, _ in total])
        columns = np.concatenate([columns[i].reshape(len(columns[i]), -1) for _, columns in total], axis=1)
        values.append(_left(residual, columns))
    return values[1] - values[0]


def _left(residual: np.ndarray, columns: np.ndarray) -> float:
    """Sum of squares of a residual after a free fit of columns (P, ...)."""
    flat, basis = residual.ravel(), columns.reshape(len(columns), -1).T
    if not basis.shape[1]:
        return float(flat @ flat)
    scale = np.linalg.norm(basis, axis=0)
    basis = basis[:, scale > 0] / scale[scale > 0]
    left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=1e-6)[0] if basis.shape[1] else flat
    return float(left @ left)


def _judged(
    hypotheses: Sequence[Hypothesis],
    recording: Recording,
    interpolation: str,
    sigma: np.ndarray,
    counter: Counter | None = None,
) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
    """Residuals (W, R) of hypotheses in windows of a recording, and their answers to their own numbers (P, W, R)."""
    interval = float(np.median(np.diff(recording.time)))
    data = prepare([recording], interpolation, sigma, Span(3, 6))
    k = max(6, round(CONTACT_SPAN / interval))
    last = len(recording.time) - 1 - k
    if last < 4:
        return None
    first = np.unique(np.linspace(min(3, last), last, _WINDOWS).astype(int))
    windows = Windows(data, np.zeros(len(first), int), first, k, counter)
    windows.linearise(hypotheses[0], steps=2)
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


def recordings_needed(
    truth: Hypothesis,
    rival: Hypothesis,
    dataset: Dataset,
    sigma: np.ndarray,
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
      sigma: (2 nv,) noise.
      rng: for commands and noise.
      choose: take the commands with the largest expected disagreement first, instead of any.
      most: give up after so many.
      commands: to choose from; None for random ones.

    Returns:
      Number of recordings; `most + 1` where they did not suffice.
    """
    commands = commands or random_commands(dataset, rng, _TRIES)
    order = np.arange(len(commands))
    if choose:
        order = np.argsort([-compare([truth, rival], dataset, c, sigma)[0, 1] for c in commands])
    recordings: list[Recording] = []
    for i in order[:most]:
        recordings.append(record(truth, dataset, commands[i], sigma, rng))
        if margin(truth, rival, recordings, dataset.interpolation, sigma) > MARGIN:
            return len(recordings)
    return most + 1
