"""What a hypothesis leaves at single joints: sharper than one number for everything that could be missing.

Unknown forces everywhere have a hundred unknowns a window, and what a nearly right name leaves drowns in their noise.
It sits at few joints, though, and follows few variables. Two questions are therefore asked of every degree of freedom:
whether forces there alone explain more than noise, and whether a force there follows something that no effect of the
library follows, such as the angle's absolute value, a ripple, another joint's load, or time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.inference.scoring.forces import Circumstances, ForceFit
from btr_mjx.gap.inference.scoring.gains import luckiest, robust_gain, without_wildest
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.windows import bounded_loss, regularised, window_weight

_CAP = 6.0
"""A window's excess counts up to so many standard deviations."""

_RIPPLES = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
"""Half periods of a ripple over a joint's amplitude."""

_LOOK = 6
"""So many of the most telling features are tested window by window."""


@dataclass(frozen=True)
class Feature:
    """A variable that a force may follow.

    Attributes:
      dof: where the force acts.
      name: of the variable.
      other: degree of freedom that the variable belongs to; None for its own.
      values: (W, bins).
    """

    dof: int
    name: str
    other: int | None
    values: np.ndarray


@dataclass(frozen=True)
class FeatureGain:
    """What one feature explains.

    Attributes:
      index: of the feature.
      amplitude: of the force, per unit of the feature.
      gain: fall of the loss, robust.
    """

    index: int
    amplitude: float
    gain: float


@dataclass(frozen=True)
class Leftover:
    """What is left at single joints.

    Attributes:
      excess: (nv,) standard deviations by which forces at each degree of freedom alone explain more than noise.
      chi2: (nv,) the same, in units of chi^2.
      usual: (nv,) the excess of a window, in its own standard deviations, that half of them stay below.
      feature_gains: the most telling features, best first.
    """

    excess: np.ndarray
    chi2: np.ndarray
    usual: np.ndarray
    feature_gains: tuple[FeatureGain, ...]

    @property
    def worst(self) -> float:
        """The largest excess."""
        return float(self.excess.max(initial=0.0))


@dataclass(frozen=True)
class Middle:
    """Where variables are measured from, the same on both sides of the split.

    Attributes:
      position: (nv,) median.
      reach: (nv,) from there to where positions hardly ever are beyond.
      mean: (nv,) of the position.
      time: mean [s].
    """

    position: np.ndarray
    reach: np.ndarray
    mean: np.ndarray
    time: float

    @classmethod
    def of(cls, fit: ForceFit, around: Circumstances) -> "Middle":
        """The middle of some windows, see `features`."""
        position = fit.average(around.position)
        position = position.reshape(-1, position.shape[-1])
        middle, far = np.quantile(position, 0.5, axis=0), np.quantile(position, 0.98, axis=0)
        time = float(fit.average(around.time).mean())
        return cls(middle, np.maximum(far - middle, 1e-12), position.mean(0), time)


def features(
    model: mujoco.MjModel, fit: ForceFit, around: Circumstances, middle: Middle | None = None
) -> list[Feature]:
    """Variables that no effect of a usual library follows.

    Args:
      model: the believed model.
      fit: unknown forces of some windows.
      around: circumstances of the same windows.
      middle: where variables are measured from; None for the middle of these windows.
    """
    position, load, time = (fit.average(x) for x in (around.position, around.load, around.time))
    middle = middle or Middle.of(fit, around)
    away = (position - middle.position) / middle.reach
    plain = np.flatnonzero(model.jnt_type[model.dof_jntid] >= int(mujoco.mjtJoint.mjJNT_SLIDE))
    out = []
    for dof in range(model.nv):
        x = away[..., dof]
        if dof not in plain:
            # Errors of an estimated position act as forces that follow it.
            out += [] if around.estimated[dof] else [Feature(dof, "position", None, x)]
            continue
        out += [Feature(dof, "absolute position", None, np.abs(x)), Feature(dof, "position cubed", None, x**3)]
        for count in _RIPPLES:
            phase = count * np.pi * x
            out += [Feature(dof, "ripple", None, wave(phase)) for wave in (np.sin, np.cos)]
        out.append(Feature(dof, "load growing with time", None, load[..., dof] * (time - middle.time)))
        for other in plain[plain != dof]:
            out.append(Feature(dof, "load", int(other), load[..., other]))
            out.append(Feature(dof, "position", int(other), position[..., other] - middle.mean[other]))
    return out


class Joints:
    """Asks residuals of one set of windows what they hold at single joints."""

    def __init__(self, fit: ForceFit, nuisance: Nuisance, known: Sequence[Feature]) -> None:
        """Prepare what does not depend on a residual.

        Args:
          fit: unknown forces of the windows.
          nuisance: what is fitted along.
          known: features to look for.
        """
        self.nuisance, self.known = nuisance, known
        self._columns = fit.columns.reshape(len(fit.columns), *fit.shape, -1)  # (W, nv, bins, R)
        self._gram = self._columns @ np.swapaxes(self._columns, 2, 3)  # (W, nv, bins, bins)
        self._roots = np.linalg.eigh(self._gram)
        self._across = self._with(nuisance.columns)
        self._at: list[tuple[int, list[int], np.ndarray, np.ndarray]] = []
        for dof in sorted({feature.dof for feature in known}):
            here = [i for i, feature in enumerate(known) if feature.dof == dof]
            values = np.stack([known[i].values for i in here], 1)  # (W, features, bins)
            size = ((values @ self._gram[:, dof]) * values).sum(2)
            self._at.append((dof, here, np.swapaxes(values, 0, 1).reshape(len(here), -1), size))

    def _with(self, columns: np.ndarray) -> np.ndarray:
        """Inner products (W, nv, bins, P) of the forces' signatures with columns (W, P, R)."""
        windows, nv, bins, rows = self._columns.shape
        flat = self._columns.reshape(windows, nv * bins, rows)
        return (flat @ np.swapaxes(columns, 1, 2)).reshape(windows, nv, bins, -1)

    def __call__(self, residual: np.ndarray, cut: float, free: np.ndarray | None = None) -> Leftover:
        """What is left of a residual at single joints.

        Args:
          residual: (W, R).
          cut: chi^2 above which a window counts less.
          free: (P, W, R) derivatives of the residual by the numbers of a hypothesis, which are fitted along.
        """
        before = self.nuisance.profile(residual, cut)
        absorbed = residual + np.einsum("wnr,n->wr", self.nuisance.columns, before.values)
        moment = (self._columns @ absorbed[:, None, :, None])[..., 0]  # (W, nv, bins)
        excess, chi2, usual = self._excess(moment)
        w = window_weight(before.chi2, cut)
        own = np.zeros((0, *residual.shape), np.float32) if free is None else free.astype(np.float32)
        data, size = self.nuisance.evidence(absorbed, own), len(own)
        prior = np.concatenate([np.zeros(size), self.nuisance.precision])
        normal = np.tensordot(w, data.gram, 1) + np.diag(prior)
        normal = regularised(normal)
        pull = w @ data.moment + prior * np.concatenate([np.zeros(size), before.values])
        inverse = np.linalg.inv(normal)
        across = np.concatenate([self._with(np.moveaxis(own, 0, 1)), self._across], -1) * w[:, None, None, None]
        found = []
        for dof, here, values, sizes in self._at:
            size_here = w @ sizes
            mixed = values @ across[:, dof].reshape(values.shape[1], -1)  # (features, P)
            rest = size_here - ((mixed @ inverse) * mixed).sum(1)
            push = values @ (w[:, None] * moment[:, dof]).ravel() - mixed @ (inverse @ pull)
            for i in np.flatnonzero((size_here > 0) & (rest > 1e-3 * size_here)):
                found.append((push[i] ** 2 / rest[i], -push[i] / rest[i], mixed[i], here[i]))
        gains = []
        reference = self.nuisance.profile(absorbed, cut)
        for _, amplitude, mixed, index in sorted(found, key=lambda row: -row[0])[:_LOOK]:
            moved = absorbed + self._moved(index, amplitude)
            shift = -inverse @ (pull + amplitude * mixed)
            moved = moved + np.einsum("pwr,p->wr", own, shift[:size])
            after = self.nuisance.profile(moved, cut)
            lucky = luckiest(bounded_loss(reference.chi2, cut) - bounded_loss(after.chi2, cut))
            gains.append(FeatureGain(index, float(amplitude), robust_gain(reference, after, cut) - lucky))
        gains.sort(key=lambda one: -one.gain)
        return Leftover(excess, chi2, usual, tuple(gains))

    def held_out(self, residual: np.ndarray, cut: float, found: FeatureGain) -> float:
        """Fall of the loss, robust, by a force that was found in other windows.

        Args:
          residual: (W, R).
          cut: chi^2 above which a window counts less.
          found: of a call with windows of the other side and the same features.
        """
        before = self.nuisance.profile(residual, cut)
        after = self.nuisance.profile(residual + self._moved(found.index, found.amplitude), cut)
        return robust_gain(before, after, cut)

    def _moved(self, index: int, amplitude: float) -> np.ndarray:
        """(W, R) by which a force that follows a feature moves residuals."""
        feature = self.known[index]
        columns = self._columns[:, feature.dof]
        return amplitude * np.einsum("wb,wbr->wr", feature.values, columns, optimize=True)

    def _excess(self, moment: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Excess of unknown forces at each degree of freedom alone, as `Leftover` has it: (nv,) each."""
        value, vector = self._roots
        keep = value > 1e-6 * value[..., -1:]
        inner = (np.swapaxes(vector, 2, 3) @ moment[..., None])[..., 0]
        explained = (np.where(keep, inner**2 / np.where(keep, value, 1.0), 0.0)).sum(-1)  # (W, nv)
        rank = keep.sum(-1)
        usual = np.median((explained - rank) / np.sqrt(2.0 * np.maximum(rank, 1)), axis=0)
        beyond = without_wildest(np.minimum(explained - rank, _CAP * np.sqrt(2.0 * rank)))
        return beyond / np.sqrt(np.maximum(2.0 * rank.sum(0), 1.0)), beyond, usual
