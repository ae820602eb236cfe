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
from threadpoolctl import threadpool_limits

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, base_unmeasured
from btr_mjx.gap.effects import EFFECTS, Effect
from btr_mjx.gap.forces import (
    horizon_errors,
    identify_forces,
    joint_errors,
    noise_errors,
    predicts_better,
    predicts_worse,
    prepare_forces,
    step_errors,
)
from btr_mjx.gap.inference.search.naming import CONTACT_THRESHOLD, THRESHOLD, within_calibration
from btr_mjx.gap.inference.search.rounds import search
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import Judged
from btr_mjx.gap.inference.verdict.check import COARSE, Check
from btr_mjx.gap.inference.verdict.confounds import confounds
from btr_mjx.gap.inference.verdict.openloop import open_loop
from btr_mjx.gap.inference.verdict.outcome import (
    chi2_of,
    equivalent,
    named_effects,
    overlays,
    ranking_of,
    refits,
    survivors,
)
from btr_mjx.gap.results import Diagnosis, misfit_of, verdict_of
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import Options, time_step_notes

SURPRISE = 6.0
"""Lack of fit over everything that cannot be noise where nothing was named, in standard deviations."""

COARSE_SHARE = 0.55
"""Part of what unknown forces explain that a name must explain where nothing reaches the noise, or leave little."""

LEFT_OVER = 4.0
"""Lack of fit that is little there, in standard deviations."""

LEFT_SHARE = 0.06
"""Part of its own gain that a name may leave at single joints."""


def identify(
    dataset: Dataset,
    effects: Sequence[Effect] = EFFECTS,
    max_effects: int = 5,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    options: Options | None = None,
    counter: Counter | None = None,
    residual: bool = False,
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
      residual: whether a smooth table of what nothing explains is fitted, where the robot touches nothing.

    Returns:
      The diagnosis.

    Raises:
      InputError: no recordings on one side of the split, recordings too short for a window, no motion; the motion of a
        base is not known; a residual is asked for where the robot touches the world.
    """
    begun = time.monotonic()
    for one in filter(base_unmeasured, dataset.recordings):
        raise InputError(f"{one.name}: the pose of its base was not measured, and could not be estimated from its IMU")
    # The search has threads of its own, and matrices that are too small to be shared by more.
    with threadpool_limits(1, "blas"):
        if (prepared := prepare_forces(dataset)) is not None:
            note = progress or (lambda _: None)
            return identify_forces(prepared, effects, max_effects, note, counter or Counter(), residual)
        if residual:
            raise InputError(f"{dataset.folder}: residual is for robots that touch nothing, with all joints measured")
        bench = Bench(dataset, effects, options, progress, counter)
        return name_missing(bench, max_effects, seed, progress, begun)


def name_missing(
    bench: Bench,
    max_effects: int = 5,
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
    rounds, named = search(bench, max_effects, note)
    base = bench.base
    while named and _predicts_worse(bench, named[-1]):
        named = named[:-1]
    note("lack of fit")
    rng = np.random.default_rng([seed, 1])
    check = Check(bench, rng)
    final = named[-1] if named else None
    share = check.share(final)
    before, after = check.surprise(None), check.surprise(final)
    best = rounds[0][0] if rounds[0] else None
    is_left = left_beside_name(check, named[-1], share, after) if named else left_without_name(check, best)
    data, model = bench.test.windows.data, bench.dataset.model
    mended = base if final is None else final.hypothesis
    (first, last), steady = horizon_errors(data, [base, mended], bench.counter)
    floor = noise_errors(data, mended, bench.counter), step_errors(data, mended, bench.counter)
    errors = joint_errors(model, first, None if final is None else last, floor, steady)
    chi2 = chi2_of(bench, final, check.floor(final))
    verdict = verdict_of(bool(named), is_left, misfit_of(errors), chi2)
    said = named
    if named and verdict == "unexplained" and not predicts_better(first, last, steady):
        # What was found follows held-out recordings no better, and is no model of the robot.
        said, errors = [], joint_errors(model, first, None, floor, steady)
        chi2 = chi2_of(bench, None, check.floor(None))
    told = said[-1] if said else None
    return Diagnosis(
        found=named_effects(bench, said, rounds, rng),
        ranking=ranking_of(rounds),
        unexplained=check.words(final) if is_left else (),
        joint_errors=errors,
        open_loop=open_loop(bench, [base] if told is None else [base, told.hypothesis]),
        chi2=chi2,
        equivalent=undecided(bench, rounds[0], verdict),
        disagreement=check.map(),
        believed=refits(bench, base, final),
        confounds=confounds(bench, base, named if verdict == "effect" else []),
        overlays=overlays(bench, told),
        share=share,
        lack_of_fit=(before, after),
        threshold=THRESHOLD,
        dispersion=bench.dispersion,
        sigma=bench.sigma,
        windows=(len(bench.fit.windows), len(bench.test.windows), bench.fit.windows.k, bench.survey.span),
        survivors=survivors(bench, rounds, named),
        notes=time_step_notes(bench.fit.windows),
        steps=bench.counter.steps,
        seconds=time.monotonic() - begun + bench.counter.earlier,
    )


def _predicts_worse(bench: Bench, judged: Judged) -> bool:
    """Whether the model with what was named predicts recordings of either side worse than the believed one.

    Joints without encoders have no states from which to predict.
    """
    if not all(one.seen.all() for one in bench.dataset.recordings):
        return False
    sides = (side.windows.data for side in (bench.fit, bench.test))
    return any(predicts_worse(data, bench.base, judged.hypothesis, bench.counter) for data in sides)


def undecided(bench: Bench, first: Sequence[Judged], verdict: str) -> tuple[str, ...]:
    """Names of candidates of a first round that these data cannot tell apart.

    Args:
      bench: of the search.
      first: the round, best first.
      verdict: what was decided.

    Returns:
      Of "effect" the one that is named and those like it. Of "none" what explains more than chance and may not be named
      for another reason, such as held-out recordings that do not bear it out.
    """
    if first and verdict == "effect":
        return equivalent(first, bench.contact_sensitive)
    if verdict == "none":
        more = (j for j in first if j.score > THRESHOLD and not within_calibration(bench, j))
        return tuple(j.hypothesis.effects[-1][0].name for j in more)
    return ()


def left_beside_name(check: Check, final: Judged, share: float, surprise: float) -> bool:
    """Whether what was named leaves so much that something else must be at work.

    Args:
      check: of the lack of fit.
      final: what was named, all of it.
      share: part of what unknown forces explain that it explains.
      surprise: lack of fit that it leaves, in standard deviations.
    """
    if check.bench.dispersion > COARSE:
        return surprise > LEFT_OVER and share < COARSE_SHARE
    return check.confirmed_feature(final) is not None or check.excess_at_joint(final) > LEFT_SHARE * final.gain


def left_without_name(check: Check, best: Judged | None) -> bool:
    """Whether something is missing though nothing may be named: what the best candidate explains is strange if much.

    Args:
      check: of the lack of fit.
      best: candidate of the first round.
    """
    judged = best if best is not None and best.score > 0 else None
    if judged is not None and judged.score >= CONTACT_THRESHOLD and not within_calibration(check.bench, judged):
        return True
    strange = check.confirmed_feature(judged) is not None or check.excess_at_joint(judged) > 0
    return strange or check.surprise(judged) > SURPRISE
