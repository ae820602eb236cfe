"""Stretches of recordings: equal numbers of intervals between samples, with smoothed states to start from."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from btr_mjx.gap.data import quantisation_noise
from btr_mjx.gap.simulate import Segments
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
      actuators: (m,) indices of those whose drives report their forces.
      reported: (S, K + 1, m) these forces, before the gear [N m or N].
      qpos, qvel: states around which the motion is linearised, at first smoothed measurements.
      seen: (2 nv + m,) bool: which coordinates were measured.
      sigma: (2 nv + m,) noise of a measurement, a first guess.
      least: (2 nv + m,) no measurement has less. Where a robot stands still the digits of its encoders do not move, as
        if there were no noise: without a bound such samples would outweigh all others.
    """

    data: PreparedData
    recording: np.ndarray
    time: np.ndarray
    measured_q: np.ndarray
    measured_v: np.ndarray
    act: np.ndarray
    actuators: np.ndarray
    reported: np.ndarray
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
        """(S, K + 1, 2 nv + m) measurements less the states around which the motion is linearised.

        Coordinates of reported forces are less what was reported.
        """
        model = self.data.recordings[0].model
        position = difference(model, self.qpos, self.measured_q)
        return np.concatenate([position, self.measured_v - self.qvel, np.zeros_like(self.reported)], -1)

    def segments(
        self, samples: slice, qpos: np.ndarray, qvel: np.ndarray, duration: np.ndarray
    ) -> Iterator[tuple[list[int], mujoco.MjModel, Segments]]:
        """Segments from some samples of all stretches on, for each model of the recordings.

        Args:
          samples: chosen, K of them.
          qpos: (S, K, nq) starting positions.
          qvel: (S, K, nv) starting velocities.
          duration: (S, K) of each [s].

        Yields:
          Stretches of a model, the model and its segments, those of a stretch behind each other.
        """
        groups: dict[int, list[int]] = {}
        for s, r in enumerate(self.recording):
            groups.setdefault(id(self.data.recordings[r].model), []).append(s)
        for own in groups.values():
            model = self.data.recordings[self.recording[own[0]]].model
            rows = np.repeat(np.array(own), qpos.shape[1])
            act = self.act[own][:, samples].reshape(len(rows), -1) if model.na else None
            start, q, v = self.time[own][:, samples], qpos[own], qvel[own]
            yield (
                own,
                model,
                Segments(
                    start.reshape(-1),
                    q.reshape(-1, q.shape[-1]),
                    v.reshape(-1, v.shape[-1]),
                    duration[own].reshape(-1, 1),
                    self.data.commands,
                    self.recording[rows],
                    act,
                ),
            )


def spread_stretches(data: PreparedData, share: float = 1.0, actuators: Sequence[int] = ()) -> Stretches:
    """Spread stretches evenly over recordings.

    Args:
      data: recordings of one side of the split.
      share: of the usual bounds of their number.
      actuators: whose reported forces are used.
    """
    nv = data.recordings[0].model.nv
    strides = [samples_of_interval(r.time) for r in data.recordings]
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
    return _stretches(data, np.array(recording), index, strides, np.array(actuators, int))


def samples_of_interval(time: np.ndarray) -> int:
    """Samples per interval."""
    return max(1, round(_SHORTEST_INTERVAL / float(np.median(np.diff(time)))))


def _stretches(
    data: PreparedData,
    recording: np.ndarray,
    index: Sequence[np.ndarray],
    strides: Sequence[int],
    actuators: np.ndarray,
) -> Stretches:
    parts: dict[str, list[np.ndarray]] = {name: [] for name in ("time", "mq", "mv", "act", "force", "q", "v")}
    forces = [r.reported(actuators) for r in data.recordings]
    reduction = np.ones(len(data.sigma))
    nv = data.recordings[0].model.nv
    for r, samples in zip(recording, index, strict=True):
        model, track, stride = data.recordings[r].model, data.tracks[r], strides[r]
        q, v, _ = smooth(model, track, samples, data.sigma, data.span)
        mq, mv, force = track.qpos[samples], np.nan_to_num(track.qvel[samples]), forces[r][samples]
        if stride > 1:
            alone = Track(track.time, track.qpos, track.qvel, np.zeros_like(track.measured))
            mq = smooth(model, alone, samples, data.sigma, Span(stride, 4))[0]
            mv = np.mean([np.nan_to_num(track.qvel[_near(samples, k, track)]) for k in _around(stride)], axis=0)
            force = np.mean([forces[r][_near(samples, k, track)] for k in _around(stride)], axis=0)
            reduction[:] = 1 / np.sqrt(stride)
        for name, value in zip(parts, (track.time[samples], mq, mv, data.acts[r][samples], force, q, v), strict=True):
            parts[name].append(value)
    stacked = {name: np.stack(values) for name, values in parts.items()}
    measured = np.append(data.measured, np.ones(len(actuators), bool))
    sigma = np.maximum(data.sigma * reduction, 1e-12 * np.ones(2 * nv))
    samples_of = [(r.time, r.qpos, r.qvel, r.qvel_measured) for r in data.recordings]
    of_forces = noise_of_forces(stacked["force"])
    digits = quantisation_noise(data.recordings[0].model, samples_of).ravel() * reduction
    return Stretches(
        data,
        recording,
        stacked["time"],
        stacked["mq"],
        stacked["mv"],
        stacked["act"],
        actuators,
        stacked["force"],
        stacked["q"],
        stacked["v"],
        measured,
        np.append(sigma, of_forces),
        np.append(np.maximum(_QUIETEST * sigma, digits), _QUIETEST * of_forces),
    )


def noise_of_forces(reported: np.ndarray) -> np.ndarray:
    """(m,) white noise of forces (S, K + 1, m), by what is no parabola over four samples; a first guess."""
    rest = np.diff(reported, n=3, axis=1) / np.sqrt(20)
    return 1.4826 * np.median(np.abs(rest), (0, 1)) + 1e-3 * reported.std((0, 1)) + 1e-12


def _around(stride: int) -> range:
    return range(-(stride // 2), stride // 2 + 1)


def _near(samples: np.ndarray, shift: int, track: Track) -> np.ndarray:
    return np.clip(samples + shift, 0, len(track.time) - 1)
