"""Recordings made ready for windows: what was measured, commanded and, where actuators have states, going on inside."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from btr_mjx.gap.data import Recording
from btr_mjx.gap.effects import Scales
from btr_mjx.gap.simulate import Command
from btr_mjx.gap.windows.state_estimate import Span, Track, histories, smooth


@dataclass(frozen=True)
class Data:
    """Recordings made ready for windows.

    Attributes:
      recordings: the recordings.
      tracks: what was measured in each.
      commands: what was commanded in each.
      acts: activation states at the samples of each, (K, na).
      sigma: (2 nv,) noise of positions and velocities.
      measured: (2 nv,) bool: which coordinates were measured.
      span: samples that a state estimate uses.
      finer: simulations take the models' time step divided by this.
      rough: whether that is for feet, which steps of the models' own would move by more than sensors miss.
      blows: (K,) bool per recording, samples that no window may hold, see `impacts`; None where any may.
    """

    recordings: tuple[Recording, ...]
    tracks: tuple[Track, ...]
    commands: tuple[Command, ...]
    acts: tuple[np.ndarray, ...]
    sigma: np.ndarray
    measured: np.ndarray
    span: Span
    finer: int = 1
    rough: bool = False
    blows: tuple[np.ndarray, ...] | None = None


def prepare(recordings: Sequence[Recording], interpolation: str, sigma: np.ndarray, span: Span) -> Data:
    """Make recordings ready for windows.

    Args:
      recordings: at least one.
      interpolation: of the command.
      sigma: (2 nv,) noise.
      span: samples that a state estimate uses.
    """
    tracks = tuple(track_of(r) for r in recordings)
    commands = tuple(Command(r.time, r.ctrl, interpolation) for r in recordings)  # type: ignore[arg-type]
    acts = tuple(histories(r.model, t, c) for r, t, c in zip(recordings, tracks, commands, strict=True))
    seen = np.stack([r.qvel_measured for r in recordings]).all(0)
    measured = np.concatenate([np.ones(recordings[0].model.nv, bool), seen])
    return Data(tuple(recordings), tracks, commands, acts, sigma, measured, span)


def track_of(recording: Recording) -> Track:
    """What was measured in a recording."""
    return Track(recording.time, recording.qpos, recording.qvel, recording.qvel_measured)


def scales_of(data: Data) -> Scales:
    """Typical sizes in the data, from a few hundred samples."""
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
    )
