"""Recordings of the two-link arm of `gap_arm` with any force at its joints, and one side of the split made of them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from gap_arm import SIGMA, XML, arm, command
from stepping import stepped

from btr_mjx.gap.data import Dataset, Noise, Recording
from btr_mjx.gap.effects import Effect, Hypothesis, candidates
from btr_mjx.gap.forces.points import ForceSide
from btr_mjx.gap.forces.stretches import Stretches, spread_stretches
from btr_mjx.gap.forces.unknowns import library_of
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import Span, prepare, scales_of
from btr_mjx.models import part_names

Force = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Generalised force (2,) of position, velocity and time."""


def moved_arm(
    name: str,
    seed: int,
    split: str = "fit",
    change: Callable[[mujoco.MjModel], None] | None = None,
    force: Force | None = None,
    noise: float = 1.0,
    seconds: float = 0.8,
    rate: float = 200.0,
    jitter: float = 0.0,
    quantum: float = 0.0,
    late: float = 0.0,
    step: float = 1e-4,
    believed: mujoco.MjModel | None = None,
    reports: float = 0.0,
) -> Recording:
    """A recording of an arm after `change(model)` that `force` pushes, simulated with small steps.

    Args:
      name: of the recording.
      seed: of motion and noise.
      split: of the recording.
      change: what is different in reality.
      force: at the joints.
      noise: of the sensors, in units of `gap_arm.SIGMA`.
      seconds: that it lasts.
      rate: of samples [1/s].
      jitter: standard deviation of the times at which samples are truly taken [s].
      quantum: of the encoders [rad]; velocities are not measured where it is given.
      late: time by which commands act before their stamps [s]; negative where they act after them.
      step: of the simulation [s].
      believed: model of the recording.
      reports: by what factor drives report the torques that they have; 0 for drives that report none.
    """
    rng = np.random.default_rng(seed)
    sent = command(rng, seconds, 200.0)
    model = arm()
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_IMPLICIT
    if change is not None:
        change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # A little longer than the recording, so that its last sample may be late.
    count = round((sent.times[-1] + 10 * jitter) / step)
    controls = sent.at(np.arange(count) * step)
    if force is None:
        states = np.concatenate(stepped(model, controls), axis=1)
    else:
        states, data = np.zeros((count + 1, 4)), mujoco.MjData(model)
        for i in range(count):
            data.ctrl[:] = controls[i]
            data.qfrc_applied[:] = force(data.qpos, data.qvel, i * step)
            mujoco.mj_step(model, data)
            states[i + 1, :2], states[i + 1, 2:] = data.qpos, data.qvel
    time = np.arange(0, sent.times[-1] + 1e-9, 1 / rate)
    taken = np.clip(time + jitter * rng.standard_normal(len(time)), 0, count * step)
    index = np.round(taken / step).astype(int)
    seen = states[index] + noise * SIGMA * rng.standard_normal((len(index), 4))
    if quantum:
        seen[:, :2] = quantum * np.round(seen[:, :2] / quantum)
        seen[:, 2:] = np.nan
    measured, torques = np.full(2, not quantum), {}
    if reports:
        data, rows = mujoco.MjData(model), []
        for i in index:
            data.qpos[:], data.qvel[:], data.ctrl[:] = states[i, :2], states[i, 2:], controls[min(i, count - 1)]
            mujoco.mj_forward(model, data)
            rows.append(reports * data.actuator_force + 0.01 * rng.standard_normal(2))
        torques = dict(zip(part_names(model, "actuator"), np.transpose(rows), strict=True))
    ctrl, own = sent.at(time - late), believed or arm()
    return Recording(name, time, ctrl, seen[:, :2], seen[:, 2:], measured, split, own, torques, interpolation="cubic")  # type: ignore[arg-type]


def arm_dataset(seed: int, fit: int = 3, test: int = 2, known: bool = True, **how) -> Dataset:
    """A dataset of the arm; `how` goes to `moved_arm`, and `known` tells whether the noise is given."""
    believed = arm()
    recordings = tuple(
        moved_arm(f"r{i}", 100 * seed + i, "fit" if i < fit else "test", believed=believed, **how)
        for i in range(fit + test)
    )
    noise = Noise(SIGMA[:2].copy(), SIGMA[2:].copy()) if known else None
    return Dataset(Path(), believed, Path("arm.xml"), XML, (), recordings, noise=noise)


def arm_stretches(recordings: Sequence[Recording], exact: bool = False, span: Span | None = None) -> Stretches:
    """Stretches of recordings; around what was measured where that is exact."""
    out = spread_stretches(prepare(recordings, SIGMA, span or Span(5, 6)))
    return out.about(out.measured_q, out.measured_v) if exact else out


def believed() -> Hypothesis:
    """The believed model, in which nothing is refitted."""
    return Hypothesis((), ())


def arm_side(stretches: Stretches, effects: Sequence[Effect]) -> ForceSide:
    """A side of the split with a library of effects."""
    model = stretches.data.recordings[0].model
    library = library_of(candidates(model, scales_of(stretches.data), effects), model, (), {}, 0.005)
    return ForceSide(stretches, library, Counter())


def shortened(stretches: Stretches, count: int, intervals: int) -> Stretches:
    """The first few intervals of the first few stretches."""
    own = {
        name: getattr(stretches, name)[:count, : intervals + 1]
        for name in ("time", "measured_q", "measured_v", "act", "reported", "qpos", "qvel")
    }
    return replace(stretches, recording=stretches.recording[:count], **own)


def exact_stretch(recording: Recording, first: int, count: int, drives: Sequence[int] = ()) -> Stretches:
    """One stretch of so many intervals, around what was measured, with forces that some drives reported."""
    data = prepare([recording], SIGMA, Span(5, 6))
    own = slice(first, first + count + 1)
    time, q, v = (x[None, own] for x in (recording.time, recording.qpos, recording.qvel))
    act, actuators = np.zeros((1, count + 1, 0)), np.array(drives, int)
    seen, sigma = np.ones(4 + len(drives), bool), np.append(SIGMA, np.full(len(drives), 0.01))
    reported = recording.reported(actuators)[None, own]
    return Stretches(data, np.zeros(1, int), time, q, v, act, actuators, reported, q, v, seen, sigma, 0.1 * sigma)
