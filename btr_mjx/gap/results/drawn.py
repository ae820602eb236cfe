"""What is drawn beside the verdict: where simulation and data disagree, overlays, missing forces; and their arrays."""

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
    """The generalised force that a model lacks, by place and regime.

    Attributes:
      places: joints, and bodies with a free joint, whose force and torque are apart.
      units: of the force at each.
      regimes: kinds of motion, such as "fast" or "contact".
      before: (places, regimes) root mean square of the force that the believed model lacks [N or N m]; NaN where the
        regime does not occur.
      after: of the mended one; None where there is none, or its force is not known.
      relative: (places, regimes) mean square of the believed model's in units of the variance that it is expected to
        have, by which places with different units are compared.
      count: (places, regimes) number of time intervals of each mean.
    """

    places: tuple[str, ...]
    units: tuple[str, ...]
    regimes: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray | None
    relative: np.ndarray
    count: np.ndarray

    def size_at(self, place: str) -> float:
        """Root mean square of the force that is left at a place, over all regimes."""
        left = self.before if self.after is None else self.after
        return float(left[self.places.index(place), self.regimes.index("all")])


def force_places(model: mujoco.MjModel) -> list[tuple[str, str]]:
    """Place and unit of the generalised force of every degree of freedom (nv,), such as ("joint:knee", "N m")."""
    joints, bodies, out = part_names(model, "joint"), part_names(model, "body"), list[tuple[str, str]]()
    for dof, joint in enumerate(model.dof_jntid):
        kind = model.jnt_type[joint]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            is_force = dof - model.jnt_dofadr[joint] < 3
            what, unit = ("force", "N") if is_force else ("torque", "N m")
            out.append((f"body:{bodies[model.jnt_bodyid[joint]]}, {what}", unit))
        else:
            out.append((f"joint:{joints[joint]}", "N" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "N m"))
    return out


def mean_map(
    model: mujoco.MjModel,
    masks: Mapping[str, np.ndarray],
    before: np.ndarray,
    after: np.ndarray | None,
    relative: np.ndarray,
    noise: np.ndarray | float = 0.0,
) -> DisagreementMap:
    """Means of missing forces over regimes.

    Args:
      model: the believed model.
      masks: by regime which intervals (N, K, nv) are of it.
      before: (N, K, nv) force that the believed model lacks [N or N m].
      after: of the mended one; None where there is none.
      relative: (N, K, nv) squared force in units of its expected variance.
      noise: variance of the forces by noise alone, which is no part of what is missing.
    """
    every = force_places(model)
    places = tuple(dict.fromkeys(every))
    owns = [np.array([one == place for one in every]) for place in places]
    shape = len(places), len(masks)
    square = [None if own is None else own**2 - noise for own in (before, after)]
    means = [None if own is None else np.full(shape, np.nan) for own in (*square, relative)]
    count = np.zeros(shape, int)
    for i, own in enumerate(owns):
        for j, mask in enumerate(masks.values()):
            chosen = mask[..., own]
            count[i, j] = int(chosen.sum())
            for values, mean in zip((*square, relative), means, strict=True):
                if count[i, j] and values is not None and mean is not None:
                    mean[i, j] = float(values[..., own][chosen].mean())
    first, second, third = means
    assert first is not None
    assert third is not None
    root = [None if one is None else np.sqrt(np.maximum(one, 0.0)) for one in (first, second)]
    assert root[0] is not None
    labels, units = (tuple(column) for column in zip(*places, strict=True)) if places else ((), ())
    return DisagreementMap(labels, units, tuple(masks), root[0], root[1], third, count)


_CONTRASTS = (
    ("fast", "slow", "when it moves fast", "when it moves slowly"),
    ("high load", "low load", "under high load", "under low load"),
    ("contact", "air", "in contact", "in the air"),
    ("late", "early", "late in the recordings", "early in the recordings"),
)


def place_of_disagreement(disagreement: DisagreementMap) -> str:
    """The place with the largest disagreement, and the regimes in which it occurs, in words.

    Text such as "joint knee, when it moves fast"; empty where the map has no numbers or is as expected everywhere.
    """
    value = np.asarray(disagreement.relative, float)
    column = {name: i for i, name in enumerate(disagreement.regimes)}
    overall = value[:, column["all"]] if "all" in column else np.nanmean(value, axis=1) if value.size else value
    if not np.isfinite(overall).any() or np.nanmax(overall) < 1.5:
        return ""
    row = int(np.nanargmax(overall))
    words = []
    for more, less, more_in_words, less_in_words in _CONTRASTS:
        if more not in column or less not in column:
            continue
        # Regimes are compared by their excess over what is expected, which is 1.
        a, b = (max(float(value[row, column[name]]) - 1.0, 0.0) for name in (more, less))
        if a > 2.0 * b + 0.2:
            words.append(more_in_words)
        elif b > 2.0 * a + 0.2:
            words.append(less_in_words)
    place = place_in_words(disagreement.places[row]).partition(", ")[0]
    return ", ".join([place, *words[:1]]) + "".join(f" {w}" for w in words[1:3])


def map_arrays(disagreement: DisagreementMap) -> dict[str, np.ndarray]:
    """Content of disagreement.npz."""
    arrays = {
        "rows": np.array([place_in_words(name) for name in disagreement.places], dtype=str),
        "units": np.array(disagreement.units, dtype=str),
        "columns": np.array(disagreement.regimes, dtype=str),
        "before": np.asarray(disagreement.before, float),
        "count": np.asarray(disagreement.count),
    }
    return arrays if disagreement.after is None else arrays | {"after": np.asarray(disagreement.after, float)}


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
