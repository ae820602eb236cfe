"""Lack of fit: what a hypothesis leaves, measured against unknown forces and against simulated nulls.

Simulated nulls are worlds in which nothing is missing but what calibration leaves, with the sensors' noise: what they
seem to leave is what may be left by chance, for these data and this model.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.scoring.calibration import tolerance_draws
from btr_mjx.gap.inference.scoring.forces import (
    Circumstances,
    ForceFit,
    Forces,
    circumstances,
    describe,
    lack_of_fit,
)
from btr_mjx.gap.inference.scoring.leftover import Feature, FeatureGain, Joints, Leftover, Middle, features
from btr_mjx.gap.inference.scoring.nulls import null_residual
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.disagreement import disagreement
from btr_mjx.gap.inference.verdict.leftover_words import sentence, telling_sentence
from btr_mjx.gap.results import DisagreementMap
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Windows, bounded_loss
from btr_mjx.models import dof_places

_NULLS = 5
"""Simulated nulls behind the lack of fit."""

_LEAST_EXCESS = 5.5
"""Excess at one joint that may be chance, at least, in standard deviations."""

_TOLD = 8.0, 25.0
"""Gain that something no effect follows needs on either side of the split, with the size found on one of them, and on
both together. The most that 78 simulated robots with nothing missing, or something in the library, had was 7 and 12."""

_TOLD_PART = 0.01
"""Part of what a name gains on both sides that is added to that: a number that is a little off leaves as much."""

COARSE = 5.0
"""Dispersion beyond which no model of this kind reaches the noise: real machines have a hundred small effects."""

_BEYOND = 2.0
"""What may be chance, as a factor on the largest of the simulated nulls."""

_USUAL = 1.0
"""Excess that half of the windows must have where touchdowns are rough, in a window's own standard deviations."""

_TRUST = 0.5
"""Part of what nulls leave on average by which real data may leave more: where state estimates fail, nulls show it
roughly."""


class Check:
    """Unknown forces on both sides of the split.

    Attributes:
      excess: largest excess at one joint that may be chance.
      rough: whether touchdowns are, so that the model's time step was divided.
      usual: the excess that half of the windows must have, in a window's own standard deviations. Where steps had to be
        divided because touchdowns are rough, a number that is a little off leaves much in a few windows.
    """

    def __init__(self, bench: Bench, rng: np.random.Generator) -> None:
        self.bench = bench
        self.sides = (bench.fit, bench.test)

        def forces(windows: Windows) -> tuple[Circumstances, ForceFit]:
            around = circumstances(windows, bench.base)
            return around, ForceFit(windows, around)

        found = run_in_threads([partial(forces, side.windows) for side in self.sides])
        self.around, self.fits = [around for around, _ in found], [fit for _, fit in found]
        self._anew: dict[int, tuple[Windows, ForceFit]] = {}
        model, middle = bench.dataset.model, Middle.of(self.fits[0], self.around[0])
        self._known = [features(model, *own, middle) for own in zip(self.fits, self.around, strict=True)]
        self._joints = Joints(self.fits[0], bench.nuisance(bench.fit), self._known[0])
        self.null, left, self._held_out, self._spared = self._null(rng)
        self.rough = bench.fit.windows.data.refined_for_contact
        self.usual = _USUAL if self.rough else -np.inf
        self.excess = max(_LEAST_EXCESS, _BEYOND * max(one.worst for one in left))

    def _residual(self, i: int, judged: Judged | None) -> np.ndarray:
        if judged is None:
            residual = self.sides[i].windows.residual
        else:
            residual = (judged.refined.residual, judged.residual)[i]
        side = (self.sides if judged is None else judged.sides)[i]
        hypothesis = None if judged is None else judged.hypothesis
        return self.bench.nuisance(side, hypothesis).absorbed(residual, self.bench.cut)

    def _forces(self, i: int, judged: Judged | None) -> Forces:
        return self._fit(i, judged)(self._residual(i, judged))

    def _fit(self, i: int, judged: Judged | None) -> ForceFit:
        """Unknown forces in the windows that a hypothesis was judged with."""
        if judged is None or judged.sides[i].windows.basis is self.sides[i].windows.basis:
            return self.fits[i]
        windows = judged.sides[i].windows
        if id(windows) not in self._anew:
            self._anew[id(windows)] = windows, ForceFit(windows, self.around[i])
        return self._anew[id(windows)][1]

    def floor(self, judged: Judged | None) -> float:
        """The noise floor: what simulated nulls leave, scaled to the noise that these data turn out to have.

        The noise is known to a percent or two, which is as much as a weak effect leaves. What unknown forces cannot
        explain of what is left tells how far off it is.

        Args:
          judged: what was named; None for nothing.

        Returns:
          chi^2 per degree of freedom of held-out windows with nothing missing, bounded as `outcome.gap_of` does.
        """
        freedom = self.bench.test.windows.freedom
        floor = float(np.minimum(self._held_out, 6.0 * freedom).mean() / freedom)
        if self.bench.dispersion > COARSE:
            return floor
        chi2 = (self._residual(1, judged) ** 2).sum(1)
        return floor * _spared(chi2, self._forces(1, judged), freedom) / self._spared

    def _null(self, rng: np.random.Generator) -> tuple[tuple[float, float], list[Leftover], np.ndarray, float]:
        """Where nothing is missing.

        Tolerances are drawn and truly simulated, because what they leave beyond the linear picture looks like a lack
        of fit; the sensors' noise is added.

        Returns:
          Mean and spread of the lack of fit, what is left at single joints, chi^2 (nulls, W)
          of held-out windows and what unknown forces leave there per degree of freedom.
        """
        bench = self.bench
        draws = tolerance_draws(bench.base, bench.candidates, bench.tolerances, rng, _NULLS)
        rngs = rng.spawn(len(self.sides))
        nulls = run_in_threads([partial(self._of_nulls, i, draws, own) for i, own in enumerate(rngs)])
        left = [found for _, found, _ in nulls[0] if found is not None]
        held_out = np.stack([(residual**2).sum(1) for _, _, residual in nulls[1]])
        pairs = zip(held_out, nulls[1], strict=True)
        spared = [_spared(chi2, own, bench.test.windows.freedom) for chi2, (own, _, _) in pairs]
        fits = [lack_of_fit([fit[0], test[0]]) for fit, test in zip(*nulls, strict=True)]
        return (float(np.mean(fits)), float(np.std(fits))), left, held_out, float(np.mean(spared))

    def _of_nulls(
        self, i: int, draws: Sequence[Hypothesis], rng: np.random.Generator
    ) -> list[tuple[Forces, Leftover | None, np.ndarray]]:
        """Unknown forces, what is left at single joints where windows are fitted, and residuals of nulls on a side."""
        windows, nuisance = self.sides[i].windows, self.bench.nuisance(self.sides[i])
        out = []
        for draw in draws:
            there = null_residual(windows, self.bench.base, draw, rng)
            absorbed = nuisance.absorbed(there, self.bench.cut)
            left = self._joints(there, self.bench.cut) if i == 0 else None
            out.append((self.fits[i](absorbed), left, absorbed))
        return out

    def surprise(self, judged: Judged | None) -> float:
        """Lack of fit over both sides, in standard deviations beyond that of a null."""
        value = lack_of_fit([self._forces(i, judged) for i in (0, 1)])
        usual, spread = self.null
        return (value - usual) / float(np.linalg.norm([1.0, 1.5 * spread, _TRUST * max(usual, 0.0)]))

    def excess_at_joint(self, judged: Judged | None) -> float:
        """The most chi^2 at a joint where more is left than may be chance, and in most windows; else nothing."""
        left = self.left(judged)
        there = (left.excess > self.excess) & (left.usual > self.usual)
        return float(left.chi2[there].max(initial=0.0))

    def left(self, judged: Judged | None) -> Leftover:
        """What a hypothesis leaves at single joints, on the recordings to fit."""
        bench, joints = self.bench, self._joints
        if judged is None:
            return joints(bench.fit.windows.residual, bench.cut)
        joints = Joints(self._fit(0, judged), bench.free(judged.sides[0], judged.hypothesis), self._known[0])
        return joints(judged.refined.residual, bench.cut, judged.refined.columns)

    def confirmed_feature(self, judged: Judged | None) -> Feature | None:
        """Something that no effect follows and that held-out recordings know of as well.

        Args:
          judged: a hypothesis; None for the believed model.

        Returns:
          None where there is no such thing.
        """
        bench = self.bench
        each, both = (least * bench.dispersion for least in _TOLD)
        both += 0.0 if judged is None else _TOLD_PART * bench.dispersion * (judged.gain + judged.held_out)
        best, most = None, both
        for one, held_out in self._asked(judged, each):
            if held_out >= each and one.gain + held_out > most:
                best, most = self._known[0][one.index], one.gain + held_out
        return best

    def _asked(self, judged: Judged | None, least: float) -> list[tuple[FeatureGain, float]]:
        """What gains at least so much on the recordings to fit, best first, and what it gains on those held out."""
        bench, gains = self.bench, [one for one in self.left(judged).feature_gains if one.gain > least]
        if not gains:
            return []
        side = bench.test if judged is None else judged.sides[1]
        residual = side.windows.residual if judged is None else judged.residual
        nuisance = bench.nuisance(side, None if judged is None else judged.hypothesis)
        joints = Joints(self._fit(1, judged), nuisance, self._known[1])
        return [(one, joints.held_out(residual, bench.cut, one)) for one in gains]

    def share(self, judged: Judged | None) -> float:
        """Part of what unknown forces explain that a hypothesis explains, over both sides of the split."""
        if judged is None:
            return 0.0
        start = end = 0.0
        for i in (0, 1):
            before, after = self._forces(i, None), self._forces(i, judged)
            cut = np.maximum(3.0 * np.median(before.explained), 2.0 * before.rank)
            start += float((bounded_loss(before.explained, cut) - before.rank).sum())
            end += float((bounded_loss(after.explained, cut) - after.rank).sum())
        return 1.0 - end / start if start > 0 else 0.0

    def map(self) -> DisagreementMap:
        """The map before any fit."""
        forces = self.fits[0](self.sides[0].windows.residual)
        return disagreement(self.bench.dataset.model, self.fits[0], forces, self.around[0])

    def words(self, judged: Judged | None) -> tuple[str, ...]:
        """The best description of what is left."""
        places = dof_places(self.bench.dataset.model)
        fit = self._fit(0, judged)
        found = describe(fit, self._forces(0, judged), self.around[0])
        feature = self.confirmed_feature(judged)
        telling = [] if feature is None else [telling_sentence(feature, places)]
        return (*telling, *(sentence(d, places) for d in found))


def _spared(chi2: np.ndarray, forces: Forces, freedom: int) -> float:
    """What unknown forces leave of windows' chi^2 (W,), per degree of freedom that they leave, but for wild windows."""
    tame = chi2 <= 3.0 * max(freedom, float(np.median(chi2)))
    return float((chi2 - forces.explained)[tame].sum() / np.maximum(freedom - forces.rank, 1)[tame].sum())
