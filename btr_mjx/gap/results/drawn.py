"""What is drawn beside the verdict: where simulation and data disagree, overlays, missing forces; and their arrays."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.results.words.effects import place_in_words
from btr_mjx.models import part_names


@dataclass(frozen=True)
class Overlay:
    """A part of a held-out recording, for a figure.

    Attributes:
      recording: name of the recording.
      coordinate: name of the joint at which the two models differ most, or the data from the only one.
      time: (K,) [s].
      measured, before, after: (K,) position [rad or m].
    """

    recording: str
    coordinate: str
    time: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class JointForce:
    """The force that is missing at a joint, for a figure.

    Attributes:
      joint: in words.
      unit: of forces.
      position, velocity, load, time: (N,) states, force of the actuators, and time.
      before, after: (N,) force that is missing beside the believed and the mended model.
      law: (N,) force of the laws that were named there; zero without.
      spread: (N,) half the width of its 90 % interval.
      follows: what laws there depend on: "position", "velocity", "load", "time".
    """

    joint: str
    unit: str
    position: np.ndarray
    velocity: np.ndarray
    load: np.ndarray
    time: np.ndarray
    before: np.ndarray
    after: np.ndarray
    law: np.ndarray
    spread: np.ndarray
    follows: tuple[str, ...] = ()


@dataclass(frozen=True)
class DisagreementMap:
    """Where simulation and data disagree before any fit.

    Attributes:
      places: joints, and bodies with a free joint.
      regimes: kinds of motion, such as "fast" or "contact".
      value: (places, regimes) mean square of the unknown generalised force there in units of what noise would give; 1
        is the noise floor, NaN where the regime does not occur.
      count: (places, regimes) number of time intervals of each mean.
    """

    places: tuple[str, ...]
    regimes: tuple[str, ...]
    value: np.ndarray
    count: np.ndarray


_CONTRASTS = (
    ("fast", "slow", "when it moves fast", "when it moves slowly"),
    ("high load", "low load", "under high load", "under low load"),
    ("contact", "air", "in contact", "in the air"),
    ("late", "early", "late in the recordings", "early in the recordings"),
)


def place_of_disagreement(disagreement: DisagreementMap) -> str:
    """The place with the largest disagreement, and the regimes in which it occurs, in words.

    Text such as "joint knee, when it moves fast"; empty where the map has no numbers or all are below 1.5.
    """
    value = np.asarray(disagreement.value, float)
    column = {name: i for i, name in enumerate(disagreement.regimes)}
    overall = value[:, column["all"]] if "all" in column else np.nanmean(value, axis=1) if value.size else value
    if not np.isfinite(overall).any() or np.nanmax(overall) < 1.5:
        return ""
    row = int(np.nanargmax(overall))
    words = []
    for more, less, more_in_words, less_in_words in _CONTRASTS:
        if more not in column or less not in column:
            continue
        # Regimes are compared by their excess over the noise floor, which is 1.
        a, b = (max(float(value[row, column[name]]) - 1.0, 0.0) for name in (more, less))
        if a > 2.0 * b + 0.2:
            words.append(more_in_words)
        elif b > 2.0 * a + 0.2:
            words.append(less_in_words)
    return ", ".join([place_in_words(disagreement.places[row]), *words[:1]]) + "".join(f" {w}" for w in words[1:3])


def map_arrays(disagreement: DisagreementMap) -> dict[str, np.ndarray]:
    """Content of disagreement.npz."""
    rows = [re.sub(r"^(\w+):", r"\1 ", name) for name in disagreement.places]
    return {
        "rows": np.array(rows, dtype=str),
        "columns": np.array(disagreement.regimes, dtype=str),
        "before": np.asarray(disagreement.value, float),
        "count": np.asarray(disagreement.count),
    }


def force_arrays(forces: Sequence[JointForce]) -> dict[str, np.ndarray]:
    """Content of joint_forces.npz."""
    texts = {
        "joints": [one.joint for one in forces],
        "units": [one.unit for one in forces],
        "follows": [" ".join(one.follows) for one in forces],
    }
    return _arrays(texts, forces, ("position", "velocity", "load", "time", "before", "after", "law", "spread"))


def overlay_arrays(shown: Sequence[Overlay], model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Content of overlays.npz; units are those of joints of the model."""
    kinds = zip(part_names(model, "joint"), model.jnt_type, strict=True)
    slides = {f"joint:{name}" for name, kind in kinds if kind == mujoco.mjtJoint.mjJNT_SLIDE}
    texts = {
        "recordings": [one.recording for one in shown],
        "names": [place_in_words(one.coordinate) for one in shown],
        "units": ["m" if one.coordinate in slides else "rad" for one in shown],
    }
    return _arrays(texts, shown, ("time", "measured", "before", "after"))


def _arrays(texts: Mapping[str, list[str]], records: Sequence[Any], keys: Sequence[str]) -> dict[str, np.ndarray]:
    """Arrays of texts, and of each record n those of `keys` as "key_n"."""
    series = {f"{key}_{n}": np.asarray(getattr(one, key), float) for n, one in enumerate(records) for key in keys}
    return {name: np.array(own, dtype=str) for name, own in texts.items()} | series
