"""A run-off between the leader, rivals that come close, and nothing at all, on moments that nobody has looked at yet.

Hundreds of candidates are screened on few windows. A handful of them can be followed on many more, and on those where
they disagree most: which these are is known before the data are asked. What moves the contacts of one limb takes no
part: in fresh windows whoever is looked at first finds the better starting states. What changes all contacts alike, as
the ground does, stands out from that.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from btr_mjx.gap.effects import WORLD
from btr_mjx.gap.inference.scoring.gains import robust_gain
from btr_mjx.gap.inference.scoring.hypotheses import Hypothesis, unknowns
from btr_mjx.gap.inference.scoring.refine import refine
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged, Side, among, nearest
from btr_mjx.gap.simulate import run_in_threads
from btr_mjx.gap.windows import Fit, Windows, tile_windows
from btr_mjx.models import integrate

CLOSE = 25.0
"""Rivals whose scores are lower by less than this take part: all that would be called equivalent."""

_WEAK = 60.0
"""A leader with a lower score is held against nothing at all as well, even where no rival comes close."""

_WEAK_CONTACTS = 100.0
"""The same of one that changes contacts."""

_HOPELESS = 3.0
"""A leader with a lower score is not worth it: most robots that lack nothing have -11 to 0."""

_RIVALS = 4
"""Rivals that take part, at most."""

_MOST, _FEWEST = 30, 8
"""Fresh windows, at most, and how many are worth the trouble. With 20 of them load-dependent and dry friction of one
joint stayed as close as they were, with 30 and 40 they did not."""

_SPENT = 1.65
"""Of what goes into a search, `Options.budget`, so many times may be spent when it is over."""

_PASSES = 200
"""Simulations of a fresh window, roughly: directions of its starting state, fine passes, tolerances, hypotheses."""

_CALM = 0.5
"""Part of the windows that is looked at: those in which a nudge of the starting state grows least."""

_TELLING = 6.0
"""Difference of two hypotheses in all fresh windows but the following, in units of the noise (sum of squares), that
could tell which."""

_CHANCE = 2
"""Windows with the largest differences that are left out of this: where a foot touches in one of them and not in the
other, a lag and a delay of the same motor differ by 20, and nowhere else."""

_ITERATIONS = 2


def runoff(bench: Bench, judged: Sequence[Judged]) -> list[Judged]:
    """Judge the best of a first round and those that come close on fresh windows as well.

    Args:
      bench: of the search.
      judged: candidates for a first effect, best first.

    Returns:
      The same, best first. Scores of those that took part are of all windows, see `Judged.wide`. Rivals that no fresh
      window could tell from the best one keep their distance from it.
    """
    if not judged or judged[0].score < _HOPELESS or _of_a_limb(bench, judged[0]):
        return list(judged)
    best = judged[0]
    close = [j for j in judged[1:] if best.score - j.score < CLOSE and not _of_a_limb(bench, j)]
    weak = int(best.score < (_WEAK_CONTACTS if best.name in bench.delicate else _WEAK))
    windows = _unseen(bench) if close or weak else None
    most = 0 if windows is None else _affordable(bench, windows)
    if windows is None or most < _FEWEST:
        return list(judged)
    others = [*([bench.base] if weak else []), *(j.hypothesis for j in close)]
    differ = _differences(windows, [best.hypothesis, *others])
    shares = differ / np.maximum(differ.sum(1, keepdims=True), 1e-300)
    chosen = np.sort(np.argsort(-shares.sum(0))[:most])
    told = telling(differ[:, chosen])
    rivals = [j for j, tells in zip(close, told[weak:], strict=True) if tells][:_RIVALS]
    if not rivals and not (weak and told[0]):
        return list(judged)
    fresh = Windows(windows.data, windows.recording[chosen], windows.first[chosen], windows.k, bench.counter)
    again = _again(bench, fresh, [best, *rivals])
    twins = [j for j, tells in zip(close, told[weak:], strict=True) if not tells]
    moved = again[0].score - best.score
    again += [replace(j, score=j.score + moved, fresh=again[0].fresh) for j in twins]
    return among(judged, [best, *rivals, *twins], again)


def telling(differ: np.ndarray) -> np.ndarray:
    """Whether windows can tell hypotheses from another one (N,), given how far they are from it in each (N, W)."""
    return np.sort(differ, 1)[:, : max(differ.shape[1] - _CHANCE, 0)].sum(1) > _TELLING


def _of_a_limb(bench: Bench, judged: Judged) -> bool:
    """Whether it moves contacts, those of one limb: what changes the ground changes all of them alike."""
    return judged.name in bench.delicate and judged.hypothesis.effects[-1][0].place != WORLD


def _unseen(bench: Bench) -> Windows | None:
    """Windows of the recordings to fit that nobody has looked at; None where there are few."""
    used, data = bench.fit.windows, bench.fit.windows.data
    recording, first, k = tile_windows(data, bench.survey.span)
    known = set(zip(used.recording.tolist(), used.first.tolist(), strict=True))
    left = np.array([(r, a) not in known for r, a in zip(recording.tolist(), first.tolist(), strict=True)])
    if k != used.k or left.sum() < 2 * _FEWEST:
        return None
    windows = Windows(data, recording[left], first[left], k, bench.counter)
    windows.step = used.step
    return windows


def _affordable(bench: Bench, windows: Windows) -> int:
    """How many fresh windows may be looked at."""
    left = _SPENT * bench.options.budget(windows.nv) - bench.counter.steps
    steps = _PASSES * float(windows.since[:, -1].mean()) / windows.step
    return int(np.clip(left / steps, 0, _MOST))


def _differences(windows: Windows, hypotheses: Sequence[Hypothesis]) -> np.ndarray:
    """How far hypotheses are from the first one in each window (N - 1, W); zero where starting states decide."""
    step, nv = 2 * windows.step, windows.nv
    nudge = np.random.default_rng(0).choice([-1.0, 1.0], (len(windows), 2 * nv)) * windows.data.sigma
    start = windows.qpos.copy(), windows.qvel + nudge[:, nv:]
    for model, own in windows.groups:
        start[0][own] = integrate(model, windows.qpos[own], nudge[own, :nv])
    states = windows.states(list(hypotheses), timestep=step)
    jolted = apart(windows, windows.states(hypotheses[:1], timestep=step, start=start)[0], states[0])
    calm = jolted <= np.quantile(jolted, _CALM)
    return np.stack([np.where(calm, apart(windows, other, states[0]), 0.0) for other in states[1:]])


def apart(windows: Windows, states: np.ndarray, others: np.ndarray) -> np.ndarray:
    """How far states are from others in every window, beyond what the starting state of a coordinate could explain.

    Args:
      windows: of the data.
      states: (W, k + 1, nq + nv).
      others: the same.

    Returns:
      (W,) sum of squares in units of the noise of what was measured, without each coordinate's shift and drift.
    """
    nv, sigma, seen = windows.nv, windows.data.sigma, windows.data.measured
    away = np.nan_to_num(windows.minus(states, others)) / sigma * seen
    shift, drift = np.ones_like(windows.since), windows.since
    total = np.zeros(len(windows))
    for i in range(nv):
        scale = seen[i] / sigma[i], seen[nv + i] / sigma[nv + i]
        rows = np.concatenate([away[..., i], away[..., nv + i]], 1)
        still = np.concatenate([shift * scale[0], 0 * shift], 1)
        moving = np.concatenate([drift * scale[0], shift * scale[1]], 1)
        basis = np.linalg.qr(np.stack([still, moving], 2))[0]
        rest = rows - np.einsum("wrd,wd->wr", basis, np.einsum("wrd,wr->wd", basis, rows))
        total += (rest**2).sum(1)
    return total


def _again(bench: Bench, fresh: Windows, part: Sequence[Judged]) -> list[Judged]:
    """Those that take part, refined and judged with fresh windows beside those that they were judged on.

    Fresh windows are linearised around the believed model, which favours none of them, and it has as many looks at its
    starting states as they have. What the time step does there is found for each of them: it is worth more than a weak
    effect.
    """
    around = bench.side(fresh)
    around = nearest([around, around.recentred(bench.base)])
    usual = nearest([bench.fit, part[0].sides[0].based(bench.base)])
    alone = bench.nuisance(around).profile(around.windows.residual, bench.cut)
    both = usual.joined(around)
    reference = bench.nuisance(both).profile(both.windows.residual, bench.cut)
    return run_in_threads([partial(_one, bench, around, j, part[0], reference, alone) for j in part])


def _one(bench: Bench, around: Side, judged: Judged, best: Judged, reference: Fit, alone: Fit) -> Judged:
    """One of them.

    Args:
      bench: of the search.
      around: fresh windows, around the believed model.
      judged: it.
      best: the leader.
      reference: fit of the believed model in all windows to fit.
      alone: its fit in the fresh ones.
    """
    h = judged.hypothesis
    more = nearest([around.exactly(h), around.recentred(h)])
    known = [judged.sides[0]] if judged is best else [judged.sides[0], best.sides[0]]
    side = nearest([own.based(h) for own in known]).joined(more)
    unseen = bench.free(more, h).profile(more.windows.residual, bench.cut)
    free = unknowns(h, bench.joint, bench.delicate)
    start = [h.values(bench.joint)]
    found = refine(side.windows, bench.free(side, h), bench.cut, [(free, start)], _ITERATIONS, reference)[0]
    h = h.replaced(found.values, bench.joint)
    far = judged.sides[1]
    residual = far.windows.residuals([h])[0]
    fits = (
        bench.free(side, h).profile(found.residual, bench.cut),
        bench.nuisance(far, h).profile(residual, bench.cut),
    )
    before = reference, judged.before[1]
    even = judged.name not in bench.delicate
    gain, held_out = (bench.fall(a, b, even=even) for a, b in zip(before, fits, strict=True))
    score = gain + held_out - np.log(side.windows.residual.size + far.windows.residual.size) * h.numbers
    wide = Judged(h, found, gain, held_out, score, residual, fits, (side, far), before, before)
    fall = robust_gain(alone, unseen, bench.cut) / bench.dispersion
    return replace(judged, score=score, fresh=fall, wide=wide)
