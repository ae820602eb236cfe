"""Recordings that decide between two hypotheses, in simulation: their margins, and how many are needed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.data import Dataset, Recording
from btr_mjx.gap.experiments import DECISIVE_MARGIN, random_commands
from btr_mjx.gap.experiments.next_experiment import after_fit, expected_margins, in_windows, simulate_recording
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.simulate import Command
from btr_mjx.models import integrate

RANDOM_COMMANDS = 10
"""Number of random commands that are compared where none are given."""


def noisy_recording(
    reality: Hypothesis, dataset: Dataset, command: Command, noise: np.ndarray, rng: np.random.Generator
) -> Recording:
    """A recording of a command in a simulated reality.

    Args:
      reality: hypothesis that is simulated as reality.
      dataset: source of the initial state and of the sampling rate.
      command: the command.
      noise: (2 nv,) standard deviations of the sensors.
      rng: generator of the noise.

    Returns:
      The recording.
    """
    made = simulate_recording(reality, dataset, command)
    nv = made.model.nv
    shift = rng.standard_normal((len(made.time), 2 * nv)) * noise
    return replace(made, qpos=integrate(made.model, made.qpos, shift[:, :nv]), qvel=made.qvel + shift[:, nv:])


def recorded_margin(
    truth: Hypothesis,
    rival: Hypothesis,
    recordings: Sequence[Recording],
    sigma: np.ndarray,
    span: float,
) -> float:
    """Difference of scores of two hypotheses on recordings, each with its own starting states and refitted parameters.

    Args:
      truth: one hypothesis.
      rival: the other hypothesis.
      recordings: the recordings.
      sigma: (2 nv,) noise of positions and velocities.
      span: length of a window [s].

    Returns:
      The difference; positive where the recordings favour `truth`.
    """
    values = []
    for hypothesis in (truth, rival):
        # Starting states that are estimated with one hypothesis would favour it.
        found = [in_windows([hypothesis], recording, sigma, span) for recording in recordings]
        parts = [(residuals[0], columns[0]) for residuals, columns in (own for own in found if own is not None)]
        if not parts:
            return 0.0
        residual = np.concatenate([own.ravel() for own, _ in parts])
        columns = np.concatenate([own.reshape(len(own), own[0].size if len(own) else 0) for _, own in parts], axis=1)
        values.append(after_fit(residual, columns))
    return values[1] - values[0]


@dataclass(frozen=True)
class Measurement:
    """How recordings are compared with hypotheses.

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
    max_recordings: int = 6,
    commands: Sequence[Command] | None = None,
) -> int:
    """Number of simulated recordings until the scores of two hypotheses differ by `DECISIVE_MARGIN`.

    Args:
      truth: hypothesis that is simulated as reality.
      rival: the other hypothesis.
      dataset: source of the initial state and of the recorded commands.
      measurement: noise, and length of windows.
      rng: generator of commands and noise.
      choose: take the commands in the order of their expected disagreement, instead of the given order.
      max_recordings: largest number of recordings.
      commands: commands to choose from; None for random ones.

    Returns:
      Number of recordings; `max_recordings + 1` where they did not suffice.
    """
    sigma, span = measurement.sigma, measurement.span
    commands = commands or random_commands(dataset, rng, RANDOM_COMMANDS)
    order = np.arange(len(commands))
    if choose:
        order = np.argsort([-expected_margins([truth, rival], dataset, c, sigma, span)[0, 1] for c in commands])
    recordings: list[Recording] = []
    for i in order[:max_recordings]:
        recordings.append(noisy_recording(truth, dataset, commands[i], sigma, rng))
        if recorded_margin(truth, rival, recordings, sigma, span) > DECISIVE_MARGIN:
            return len(recordings)
    return max_recordings + 1
