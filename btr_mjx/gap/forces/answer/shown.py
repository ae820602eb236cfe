"""Held-out stretches that are drawn."""

import mujoco
import numpy as np

from btr_mjx.gap.forces.answer.found import SearchOutcome
from btr_mjx.gap.forces.answer.regimes import dof_labels
from btr_mjx.gap.forces.predictions import HORIZON
from btr_mjx.gap.results import (
    Overlay,
)
from btr_mjx.gap.simulate import Segments, simulate
from btr_mjx.models import difference

_OVERLAYS = 3
"""Stretches that are drawn."""


def forces_overlays(model: mujoco.MjModel, found: SearchOutcome) -> tuple[Overlay, ...]:
    """Held-out stretches in which believed and mended model differ most, over a few horizons.

    Args:
      model: the believed model.
      found: by the search.
    """
    stretches = found.test.stretches
    plain = np.flatnonzero(model.jnt_type[model.dof_jntid] >= 2)
    if not len(plain):
        return ()
    interval = float(np.median(np.diff(stretches.time, axis=1)))
    count = int(np.clip(round(4 * HORIZON / interval), 1, stretches.intervals))
    names_of, out = dof_labels(model), []
    tries = []
    for s in range(len(stretches)):
        recording = stretches.data.recordings[stretches.recording[s]]
        segments = Segments(
            stretches.time[s, :1],
            stretches.qpos[s, :1],
            stretches.qvel[s, :1],
            (stretches.time[s, : count + 1] - stretches.time[s, 0])[None],
            stretches.data.commands,
            stretches.recording[s : s + 1],
            stretches.act[s, :1] if model.na else None,
        )
        jobs = [(make(recording.model), segments) for make in (found.base, found.mended)]
        before, after = (states[0] for states in simulate(jobs, threads=1, counter=found.test.counter))
        away = np.nan_to_num(difference(model, before[:, : model.nq], after[:, : model.nq]) ** 2, nan=0.0)
        far = away.mean(0)[plain] / np.maximum(found.side.stretches.sigma[plain], 1e-12) ** 2
        if not np.isfinite(before).all() or not np.isfinite(after).all():
            continue
        tries.append((float(far.max()), s, int(plain[np.argmax(far)]), before, after))
    for _, s, dof, before, after in sorted(tries, key=lambda row: -row[0])[:_OVERLAYS]:
        address = int(model.jnt_qposadr[model.dof_jntid[dof]])
        recording = stretches.data.recordings[stretches.recording[s]]
        out.append(
            Overlay(
                recording.name,
                names_of[dof],
                stretches.time[s, : count + 1],
                stretches.measured_q[s, : count + 1, address],
                before[:, address],
                after[:, address],
            )
        )
    return tuple(out)
