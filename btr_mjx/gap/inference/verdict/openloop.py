"""Whole recordings, simulated open loop from their first sample, where motion is not chaotic.

Windows say what is missing; their starting states are free and their velocities count.
"""

from collections.abc import Sequence

import numpy as np

from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.results import OpenLoop
from btr_mjx.gap.simulate import Counter, Segments, simulate
from btr_mjx.gap.windows import MakeWorld, PreparedData, smooth
from btr_mjx.models import difference


def open_loop(bench: Bench, makes: Sequence[MakeWorld]) -> OpenLoop | None:
    """Mean absolute position error over whole held-out recordings; None where the robot touches the world.

    Args:
      bench: of the search.
      makes: the believed model and, where there is one, the mended one.
    """
    if bench.survey.contact:
        return None
    return OpenLoop(*(float(np.mean(own)) for own in recording_errors(bench.test.windows.data, makes, bench.counter)))


def recording_errors(data: PreparedData, makes: Sequence[MakeWorld], counter: Counter | None = None) -> np.ndarray:
    """Mean absolute position error of hypotheses over whole recordings (hypotheses, recordings) [rad or m]."""
    errors = _errors(data, makes, counter)
    seen = data.measured[: data.recordings[0].model.nv]
    return np.array([[float(np.mean(np.abs(e[:, seen]))) for e in row] for row in errors])


def _errors(data: PreparedData, makes: Sequence[MakeWorld], counter: Counter | None) -> list[list[np.ndarray]]:
    """Position errors (K, nv) of hypotheses over whole recordings, from the smoothed first sample."""
    starts = []
    for i, (recording, track) in enumerate(zip(data.recordings, data.tracks, strict=True)):
        qpos, qvel, _ = smooth(recording.model, track, np.array([0]), data.sigma, data.span)
        act = data.acts[i][:1] if recording.model.na else None
        since = (track.time - track.time[0])[None]
        starts.append(Segments(track.time[:1], qpos, qvel, since, data.commands, np.array([i]), act))
    jobs = [(make(r.model), s) for make in makes for r, s in zip(data.recordings, starts, strict=True)]
    found = simulate(jobs, counter=counter)
    out: list[list[np.ndarray]] = []
    for n, states in enumerate(found):
        i = n % len(data.recordings)
        if i == 0:
            out.append([])
        recording = data.recordings[i]
        away = difference(recording.model, recording.qpos, states[0, :, : recording.model.nq])
        out[-1].append(np.nan_to_num(away, nan=1e3))
    return out
