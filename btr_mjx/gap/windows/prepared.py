"""Recordings prepared for windows: measurements, commands, activation states, noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.data import Recording
from btr_mjx.gap.effects import Scales
from btr_mjx.gap.simulate import Command
from btr_mjx.gap.windows.state_estimate import Span, Track, activation_histories, smooth


@dataclass(frozen=True)
class PreparedData:
    """Recordings prepared for windows.

    Attributes:
      recordings: the recordings.
      tracks: measured states of each.
      commands: command of each.
      acts: (K, na) activation states at the samples of each.
      sigma: (2 nv,) noise of positions and velocities.
      measured: (2 nv,) bool: which coordinates were measured.
      span: samples and order of the state estimate.
      step_divisor: divisor of the time step of the models.
      refined_for_contact: whether the step is divided because of its error at contacts.
      impacts: per recording (K,) bool, samples excluded from windows, see `impacts`; None to exclude none.
    """

    recordings: tuple[Recording, ...]
    tracks: tuple[Track, ...]
    commands: tuple[Command, ...]
    acts: tuple[np.ndarray, ...]
    sigma: np.ndarray
    measured: np.ndarray
    span: Span
    step_divisor: int = 1
    refined_for_contact: bool = False
    impacts: tuple[np.ndarray, ...] | None = None


def prepare(recordings: Sequence[Recording], sigma: np.ndarray, span: Span) -> PreparedData:
    """Prepare recordings for windows.

    Args:
      recordings: at least one.
      sigma: (2 nv,) noise of positions and velocities.
      span: samples and order of the state estimate.

    Returns:
      The recordings with commands and activation states.
    """
    tracks = tuple(track_of(r) for r in recordings)
    commands = tuple(Command(*r.commands, r.interpolation) for r in recordings)
    acts = tuple(activation_histories(r.model, t, c) for r, t, c in zip(recordings, tracks, commands, strict=True))
    seen = np.stack([r.qvel_measured for r in recordings]).all(0)
    measured = np.concatenate([np.stack([r.seen for r in recordings]).all(0), seen])
    return PreparedData(tuple(recordings), tracks, commands, acts, sigma, measured, span)


def track_of(recording: Recording) -> Track:
    """The measured states of a recording."""
    return Track(recording.time, recording.qpos, recording.qvel, recording.qvel_measured)


def scales_of(data: PreparedData) -> Scales:
    """Typical sizes of forces and motions in the data, from a few hundred samples."""
    model = data.recordings[0].model
    picks = [
        np.unique(np.linspace(0, len(r.time) - 1, max(20, 400 // len(data.recordings))).astype(int))
        for r in data.recordings
    ]
    rows = list(zip(data.recordings, data.tracks, data.acts, picks, strict=True))
    return Scales.measured(
        model,
        np.concatenate([track.qpos[i] for _, track, _, i in rows]),
        np.concatenate([smooth(model, track, i, data.sigma, data.span)[1] for _, track, _, i in rows]),
        np.concatenate([recording.ctrl[i] for recording, _, _, i in rows]),
        np.concatenate([act[i] for _, _, act, i in rows]) if model.na else None,
        np.max([_peak_rate(recording) for recording in data.recordings], axis=0),
    )


def _peak_rate(recording: Recording) -> np.ndarray:
    """(nu,) largest rate of the commands between two samples."""
    return np.abs(np.diff(recording.ctrl, axis=0) / np.diff(recording.time)[:, None]).max(axis=0)
