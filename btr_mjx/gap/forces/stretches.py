"""Stretches of recordings: equal numbers of intervals between samples, with smoothed states to start from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.gap.data import quantisation_noise
from btr_mjx.gap.windows import PreparedData, Span, Track, smooth
from btr_mjx.models import difference

_SHORTEST_INTERVAL = 4e-3
"""Shortest interval [s]. Samples that follow each other faster are averaged by local polynomials."""

_MOST_NUMBERS = 10_000
"""Intervals times degrees of freedom of one side of the split: bounds memory and time."""

_MOST_INTERVALS = 2_500
"""Most intervals of one side."""

_STRETCHES = 24
"""Fewest stretches of one side, where there is enough data: they are filtered side by side, and their scatter is the
error of what they say. Every recording has one."""

_QUIETEST = 0.1
"""Smallest noise of a sensor, in units of the first guess: no variance may vanish, since it could not grow again."""

_LONGEST = 400
"""Most intervals of a stretch. Few long stretches and many short ones cost the same; a starting state has to be learnt
in each."""


@dataclass(frozen=True, eq=False)
class Stretches:
    """S stretches of K intervals, K + 1 samples.

    Attributes:
      data: the recordings.
      recording: (S,) index of the recording of each stretch.
      time: (S, K + 1) of the samples [s].
      measured_q, measured_v: (S, K + 1, nq), (S, K + 1, nv) measurements.
      act: (S, K + 1, na) activations of actuators with a state.
      qpos, qvel: states around which the motion is linearised, at first smoothed measurements.
      seen: (2 nv,) bool: which coordinates were measured.
      sigma: (2 nv,) noise of a measurement, a first guess.
      least: (2 nv,) no measurement has less. Where a robot stands still the digits of its encoders do not move, as if
        there were no noise: without a bound such samples would outweigh all others.
    """

    data: PreparedData
    recording: np.ndarray
    time: np.ndarray
    measured_q: np.ndarray
    measured_v: np.ndarray
    act: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray
    least: np.ndarray

    def __len__(self) -> int:
        return len(self.recording)

    @property
    def intervals(self) -> int:
        """K."""
        return self.time.shape[1] - 1

    def about(self, qpos: np.ndarray, qvel: np.ndarray) -> "Stretches":
        """The same with other states around which the motion is linearised."""
        return replace(self, qpos=qpos, qvel=qvel)

    def residual(self) -> np.ndarray:
        """(S, K + 1, 2 nv) measurements less the states around which the motion is linearised."""
        model = self.data.recordings[0].model
        position = difference(model, self.qpos, self.measured_q)
        return np.concatenate([position, self.measured_v - self.qvel], -1)


def spread_stretches(data: PreparedData, share: float = 1.0) -> Stretches:
    """Spread stretches evenly over recordings.

    Args:
      data: recordings of one side of the split.
      share: of the usual bounds of their number.
    """
    nv = data.recordings[0].model.nv
    strides = [_stride(r.time) for r in data.recordings]
    picks = [np.arange(0, len(r.time), s) for r, s in zip(data.recordings, strides, strict=True)]
    room = int(share * np.clip(_MOST_NUMBERS // nv, 200, _MOST_INTERVALS))
    total = sum(len(p) - 1 for p in picks)
    shortest = min(len(p) - 1 for p in picks)
    length = int(np.clip(min(total, room) / max(_STRETCHES, len(picks)), 20, _LONGEST))
    length = min(length, shortest)
    index: list[np.ndarray] = []
    recording: list[int] = []
    for r, pick in enumerate(picks):
        own = (len(pick) - 1) // length
        wanted = max(1, min(own, round(room * (len(pick) - 1) / total / length)))
        firsts = np.linspace(0, len(pick) - 1 - length, wanted).astype(int)
        index += [pick[f : f + length + 1] for f in firsts]
        recording += [r] * wanted
    return _stretches(data, np.array(recording), index, strides)


def _stride(time: np.ndarray) -> int:
    """Samples per interval."""
    return max(1, round(_SHORTEST_INTERVAL / float(np.median(np.diff(time)))))


def _stretches(
    data: PreparedData, recording: np.ndarray, index: Sequence[np.ndarray], strides: Sequence[int]
) -> Stretches:
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ("time", "mq", "mv", "act", "q", "v")}
    reduction = np.ones(len(data.sigma))
    nv = data.recordings[0].model.nv
    for r, samples in zip(recording, index, strict=True):
        model, track, stride = data.recordings[r].model, data.tracks[r], strides[r]
        q, v, _ = smooth(model, track, samples, data.sigma, data.span)
        mq, mv = track.qpos[samples], np.nan_to_num(track.qvel[samples])
        if stride > 1:
            alone = Track(track.time, track.qpos, track.qvel, np.zeros_like(track.measured))
            mq = smooth(model, alone, samples, data.sigma, Span(stride, 4))[0]
            mv = np.mean([np.nan_to_num(track.qvel[_near(samples, k, track)]) for k in _around(stride)], axis=0)
            reduction[:] = 1 / np.sqrt(stride)
        for name, value in zip(parts, (track.time[samples], mq, mv, data.acts[r][samples], q, v), strict=True):
            parts[name].append(value)
    stacked = {name: np.stack(values) for name, values in parts.items()}
    measured = data.measured.copy()
    sigma = np.maximum(data.sigma * reduction, 1e-12 * np.ones(2 * nv))
    samples_of = [(r.time, r.qpos, r.qvel, r.qvel_measured) for r in data.recordings]
    digits = quantisation_noise(data.recordings[0].model, samples_of).ravel() * reduction
    return Stretches(
        data,
        recording,
        stacked["time"],
        stacked["mq"],
        stacked["mv"],
        stacked["act"],
        stacked["q"],
        stacked["v"],
        measured,
        sigma,
        np.maximum(_QUIETEST * sigma, digits),
    )


def _around(stride: int) -> range:
    return range(-(stride // 2), stride // 2 + 1)


def _near(samples: np.ndarray, shift: int, track: Track) -> np.ndarray:
    return np.clip(samples + shift, 0, len(track.time) - 1)
