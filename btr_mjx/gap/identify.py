"""NAME: find the effect that a believed model lacks, or say honestly that none, or none of the library, is missing.

    diagnosis = identify(load("my_dataset"))
    diagnosis.verdict, diagnosis.effects

Candidates are searched by `search.Bench`; here it is decided what may be called by name. A name needs a score beyond
its price on all data, a gain on held-out recordings, and a size beyond what calibration leaves. What a name leaves
unexplained is measured against unknown generalised forces, which stand for everything that could be missing.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from btr_mjx.gap.check import Check
from btr_mjx.gap.confounds import confounds
from btr_mjx.gap.diagnosis import Diagnosis
from btr_mjx.gap.effect import Effect
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.openloop import followed, following
from btr_mjx.gap.outcome import alike, equivalent, gap_of, named_effects, overlays, ranking_of, refits, survivors
from btr_mjx.gap.polish import Polisher
from btr_mjx.gap.recordings import Dataset
from btr_mjx.gap.screening import tolerance_of
from btr_mjx.gap.search import Bench, Judged, Options
from btr_mjx.gap.worlds import Counter

THRESHOLD = 15.0
"""Score, beyond the price of its numbers, that a name needs."""

CONTACT_THRESHOLD = 100.0
"""The same of what moves contacts, whose directions are found anew: near a touchdown these are a matter of chance. The
best such candidate of a simulated robot that lacked no such thing came to 70."""

SECOND_THRESHOLD = 25.0
"""What one more effect needs; what the first one's linearisation leaves must not count as a second one."""

SECOND_CONTACT_THRESHOLD = 150.0
"""The same of what moves contacts: so much do scores differ between two ways of finding directions."""

SECOND_SHARE = 0.05
"""Part of the first one's score that a second effect needs where either moves contacts: a size that is a little off
leaves as much."""

_POLISHED = 3
"""Candidates for one more effect that are judged again, at most."""

HELD_OUT = 3.0
"""Gain that a name needs on held-out recordings, and on those that were fitted."""

HELD_OUT_SHARE = 0.08
"""Part of the gain per window to fit that held-out windows must show as well, except of what moves contacts."""

TOLERANCES = 4.0
"""Size that a name needs, in tolerances of its parameter."""

SURPRISE = 6.0
"""Lack of fit over everything that cannot be noise where nothing was named, in standard deviations."""

LEFT_OVER = 4.0
"""The same where something was named."""

LEFT_SHARE = 0.06
"""Part of its own gain that a name may leave at single joints."""

REST = 2.5
"""Lack of fit that a name may leave, in standard deviations, unless it explains most of what there was. What moves
contacts may leave more: a size that is a little off lets feet slip or touch at other times."""

REST_SHARE = 0.5
"""Part of what unknown forces explain that is most of it."""

COARSE = 5.0
"""Dispersion beyond which no model of this kind reaches the noise: real machines have a hundred small effects."""

COARSE_SECOND = 0.1
"""Part of the first one's score that a second effect needs there."""

COARSE_SHARE = 0.55
"""Part of what unknown forces explain that a name must explain there."""


def identify(
    dataset: Dataset,
    effects: Sequence[Effect] = EFFECTS,
    max_effects: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    options: Options | None = None,
    counter: Counter | None = None,
) -> Diagnosis:
    """Find what is missing.

    Args:
      dataset: recordings on both sides of the split, and the believed model.
      effects: the library of effects.
      max_effects: largest number of effects that are named.
      seed: of the resampling behind intervals.
      progress: called with a word on what is being done.
      options: how much is spent.
      counter: adds up the simulated steps; a `journal.Journal` remembers them for a search that goes on.

    Returns:
      The diagnosis.

    Raises:
      InputError: no recordings on one side of the split, recordings too short for a window, no motion.
    """
    begun = time.monotonic()
    bench = Bench(dataset, effects, options, progress, counter)
    return name_missing(bench, max_effects, seed, progress, begun)


def name_missing(
    bench: Bench,
    max_effects: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    begun: float | None = None,
) -> Diagnosis:
    """The part of `identify` that follows when a bench is ready.

    Args:
      bench: as it was made.
      max_effects: largest number of effects that are named.
      seed: of the resampling behind intervals.
      progress: called with a word on what is being done.
      begun: time at which the work began, of `time.monotonic`; None for now.

    Returns:
      The diagnosis.
    """
    begun = time.monotonic() if begun is None else begun
    note = progress or (lambda _: None)
    note("leaders")
    polish = Polisher(bench)
    rounds = [acceptable(bench, polish(bench.find()), None)]
    named: list[Judged] = []
    while rounds[-1] and accepted(bench, rounds[-1][0], named[-1] if named else None):
        named.append(rounds[-1][0])
        if len(named) >= max_effects:
            break
        note("one more effect")
        rounds.append(acceptable(bench, bench.find(named[-1]), named[-1], share=0.0))
        again: set[str] = set()
        # Who was not judged as strictly must not overtake who was.
        while rounds[-1] and rounds[-1][0].name not in again and len(again) < _POLISHED:
            if not accepted(bench, rounds[-1][0], named[-1], share=0.0):
                break
            again.add(rounds[-1][0].name)
            rounds[-1] = acceptable(bench, polish(rounds[-1], 1, named[-1]), named[-1])
    base = bench.base
    if bench.dispersion > COARSE and not bench.survey.contact:
        note("whole recordings")
        base, named[-1:] = followed(bench, base), [following(bench, judged) for judged in named[-1:]]
    note("lack of fit")
    rng = np.random.default_rng([seed, 1])
    check = Check(bench, rng)
    final = named[-1] if named else None
    share = check.share(final)
    before, after = check.surprise(None), check.surprise(final)
    best = rounds[0][0] if rounds[0] else None
    verdict = "effect" if named else "none"
    surprised = missing(check, named, share, after) if named else strange(check, best)
    if surprised:
        verdict = "unexplained"
    said = named if verdict == "effect" else []
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        effects=named_effects(bench, said, rounds, rng),
        ranking=ranking_of(rounds),
        equivalent=equivalent(rounds[0], bench.delicate) if rounds[0] and verdict == "effect" else (),
        gap=gap_of(bench, base, said[-1] if said else None, check.floor(said[-1] if said else None)),
        disagreement=check.map(),
        unexplained=check.words(final) if verdict == "unexplained" or surprised else (),
        believed=refits(bench, base, final),
        confounds=confounds(bench, base, named if verdict == "effect" else []),
        overlays=overlays(bench, final),
        share=share,
        lack_of_fit=(before, after),
        threshold=THRESHOLD,
        dispersion=bench.dispersion,
        sigma=bench.sigma,
        windows=(len(bench.fit.windows), len(bench.test.windows), bench.fit.windows.k, bench.survey.span),
        steps=bench.counter.steps,
        seconds=time.monotonic() - begun,
        survivors=survivors(bench, rounds, named),
    )


def acceptable(
    bench: Bench, judged: Sequence[Judged], given: Judged | None, share: float = SECOND_SHARE
) -> list[Judged]:
    """One round, with what may be called by name in front of what may not, where the data cannot tell the two apart.

    Beside what was found before, what moves contacts and may not be called by name stands in nobody's way either: its
    score is a matter of chance up to its threshold.

    Args:
      bench: of the search.
      judged: best first.
      given: what was found before.
      share: of the first one's score that a second one needs where contacts move.
    """
    close = alike(judged, bench.delicate) if judged else []
    if given:
        moving = (j.hypothesis.effects[-1][0].name in bench.delicate for j in judged)
        close += list(judged)[: next((i for i, moves in enumerate(moving) if not moves), len(judged)) + 1]
    first = next((j for j in close if accepted(bench, j, given, share)), None)
    return list(judged) if first is None else [first, *(j for j in judged if j is not first)]


def accepted(bench: Bench, judged: Judged, given: Judged | None, share: float = SECOND_SHARE) -> bool:
    """Whether a candidate may be called by name.

    Args:
      bench: of the search.
      judged: the candidate, beside what was found before.
      given: what was found before.
      share: of the first one's score that a second one needs where contacts move.
    """
    score = judged.score - (given.score if given else 0.0)
    gain = judged.gain - (given.gain if given else 0.0)
    held_out = judged.held_out - (given.held_out if given else 0.0)
    expected = gain * len(bench.test.windows) / len(bench.fit.windows)
    needed = SECOND_THRESHOLD if given else THRESHOLD
    if given and any(candidate.name in bench.delicate for candidate, _ in judged.hypothesis.effects):
        needed = max(needed, share * given.score)
    if given and bench.dispersion > COARSE:
        needed = max(needed, COARSE_SECOND * given.score)
    if judged.hypothesis.effects[-1][0].name in bench.delicate:
        # What moves contacts shows where a foot touches or leaves, and few windows held out need have that.
        needed, expected = max(needed, SECOND_CONTACT_THRESHOLD if given else CONTACT_THRESHOLD), 0.0
    if score < needed:
        return False
    if held_out < max(HELD_OUT, HELD_OUT_SHARE * expected) or gain < HELD_OUT:
        return False
    candidate, values = judged.hypothesis.effects[-1]
    tolerance = tolerance_of(candidate, bench.dataset.tolerances)
    return abs(values[0] - candidate.null[0]) > TOLERANCES * tolerance


def missing(check: Check, named: Sequence[Judged], share: float, surprise: float) -> bool:
    """Whether what was named leaves so much that something else must be at work.

    Args:
      check: of the lack of fit.
      named: what was named, each beside those before.
      share: part of what unknown forces explain that the last one explains.
      surprise: lack of fit that it leaves, in standard deviations.
    """
    if check.bench.dispersion > COARSE:
        return surprise > LEFT_OVER and share < COARSE_SHARE
    if len(named) > 1:
        # What a force of another shape explains better than the second name was never two effects.
        first = check.left(named[0])
        if first.gain > max(check.gain, named[1].gain - named[0].gain):
            return True
    plain = not any(c.name in check.bench.delicate for c, _ in named[-1].hypothesis.effects)
    if plain and surprise > REST and share < REST_SHARE:
        return True
    left, most = check.left(named[-1]), LEFT_SHARE * named[-1].gain
    return left.gain > max(check.gain, most) or (left.worst > check.excess and float(left.chi2.max()) > most)


def strange(check: Check, best: Judged | None) -> bool:
    """Whether something is missing though nothing may be named; what the best candidate explains is weak, not strange.

    Args:
      check: of the lack of fit.
      best: candidate of the first round.
    """
    judged = best if best is not None and best.score > 0 else None
    left = check.left(judged)
    return check.surprise(judged) > SURPRISE or left.gain > check.gain or left.worst > check.excess
