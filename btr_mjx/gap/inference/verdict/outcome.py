"""From a finished search to the records of a `Diagnosis`: names, ranking, the gap before and after, what else fits."""

from collections.abc import Collection, Sequence

import numpy as np

from btr_mjx.gap.effects import Hypothesis
from btr_mjx.gap.inference.search.naming import alike, held_out_chi2
from btr_mjx.gap.inference.search.search import Bench
from btr_mjx.gap.inference.search.search_records import MARGIN, Judged
from btr_mjx.gap.inference.verdict.disagreement import place_names
from btr_mjx.gap.inference.verdict.intervals import intervals
from btr_mjx.gap.inference.verdict.profile import profiled
from btr_mjx.gap.results import Chi2, NamedEffect, Overlay, RankedCandidate, Refit

_OVERLAYS = 3
"""Number of held-out stretches that are shown."""


def equivalent(judged: Sequence[Judged], contact_sensitive: Collection[str] = ()) -> tuple[str, ...]:
    """Names of those that are alike, see there."""
    return tuple(j.hypothesis.effects[-1][0].name for j in alike(judged, contact_sensitive))


def named_effects(
    bench: Bench,
    named: Sequence[Judged],
    rounds: Sequence[Sequence[Judged]],
    rng: np.random.Generator,
) -> tuple[NamedEffect, ...]:
    """What is called by name.

    Args:
      bench: of the search.
      named: what was found, each beside those before.
      rounds: judged candidates of every round, best first.
      rng: of the resampling behind intervals.
    """
    if not named:
        return ()
    final = named[-1]
    profile = profiled(bench, final, rng) if bench.tossed else None
    numbers = intervals(bench, final, rng) if profile is None else [profile]
    out, first, before = [], 0, None
    for i, (candidate, values) in enumerate(final.hypothesis.effects):
        parameters = {p.name: numbers[first + j] for j, p in enumerate(candidate.parameters)}
        first += len(values)
        step = named[i]
        score = step.score - (before.score if before else 0.0)
        held_out = step.held_out - (before.held_out if before else 0.0)
        others = tuple(name for name in equivalent(rounds[i], bench.contact_sensitive) if name != candidate.name)
        effect = candidate.effect
        out.append(
            NamedEffect(
                effect.name,
                candidate.place.label,
                parameters,
                score,
                held_out,
                others,
                effect.excited_by,
                effect.equation,
            )
        )
        before = step
    return tuple(out)


def ranking_of(rounds: Sequence[Sequence[Judged]]) -> tuple[RankedCandidate, ...]:
    """Rows of all rounds, best first in each."""
    rows = []
    for judged in rounds:
        for j in judged:
            candidate, values = j.hypothesis.effects[-1]
            rows.append(
                RankedCandidate(
                    candidate.effect.name,
                    candidate.place.label,
                    j.score,
                    judged[0].score - j.score,
                    j.gain,
                    j.held_out,
                    {p.name: float(v) for p, v in zip(candidate.parameters, values, strict=True)},
                    tuple(c.name for c, _ in j.hypothesis.effects[:-1]),
                )
            )
    return tuple(rows)


def chi2_of(bench: Bench, judged: Judged | None, nulls: float) -> Chi2:
    """chi^2 of held-out recordings.

    Args:
      bench: of the search.
      judged: what the mended model has, all of it; None for nothing.
      nulls: what simulated nulls leave.
    """
    return Chi2(*held_out_chi2(bench, judged), nulls)


def refits(bench: Bench, base: Hypothesis, final: Judged | None) -> tuple[Refit, ...]:
    """Where the believed numbers went, without and with what was named."""
    last = base if final is None else final.hypothesis
    rows = zip(bench.dataset.parameters, bench.before, base.believed, last.believed, strict=True)
    return tuple(Refit(p.name, a, b, c) for p, a, b, c in rows)


def overlays(bench: Bench, final: Judged | None) -> tuple[Overlay, ...]:
    """Held-out stretches in which two models differ most, each from starting states of its own.

    Which stretches these are depends on the models alone, not on how well either follows the data there. Recordings
    take turns. Where there is one model only, its worst stretches are taken, without the worst tenth.

    Args:
      bench: of the search.
      final: what the second model has that the believed one lacks; None for no second model.
    """
    side = bench.test
    windows, model = side.windows, bench.dataset.model
    before = windows.at(bench.base)
    after = before if final is None else side.with_fitted_states(final.hypothesis, exact=False).windows.base
    other = np.concatenate([windows.target_q, windows.target_v], -1) if final is None else after
    away = windows.minus(before, other)[..., : windows.nv] / bench.sigma[: windows.nv]
    plain = np.flatnonzero((model.jnt_type[model.dof_jntid] >= 2) & windows.data.measured[: windows.nv])
    if not len(plain):
        return ()
    far = np.nan_to_num((away[..., plain] ** 2).sum(1), posinf=0.0)  # (W, joints)
    order = np.argsort(-far.max(1), kind="stable")
    if final is None:
        order = order[len(order) // 10 :]
    turn = [int((windows.recording[order[:i]] == windows.recording[w]).sum()) for i, w in enumerate(order)]
    names, out = place_names(model), []
    for w in order[np.argsort(turn, kind="stable")][:_OVERLAYS]:
        dof = int(plain[np.argmax(far[w])])
        address = int(model.jnt_qposadr[model.dof_jntid[dof]])
        out.append(
            Overlay(
                bench.dataset.test[windows.recording[w]].name,
                names[dof],
                windows.time[w],
                windows.target_q[w, :, address],
                before[w, :, address],
                after[w, :, address],
            )
        )
    return tuple(out)


def survivors(bench: Bench, rounds: Sequence[Sequence[Judged]], named: Sequence[Judged]) -> tuple[Hypothesis, ...]:
    """Hypotheses that are still possible: those near the best, and nothing where no name was found."""
    last = rounds[min(len(named), len(rounds)) - 1] if named else rounds[0]
    if not last:
        return (bench.base,)
    close = [j.hypothesis for j in last if last[0].score - j.score <= 2 * MARGIN]
    return tuple(close if named else [bench.base, *close[:2]])
