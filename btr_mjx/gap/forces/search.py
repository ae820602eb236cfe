"""Forward selection of effects, and backward elimination."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import Candidate, Hypothesis
from btr_mjx.gap.forces.drive import drive_points
from btr_mjx.gap.forces.elimination import pruned
from btr_mjx.gap.forces.evidence import CalibrationPrior, least_squares
from btr_mjx.gap.forces.kalman_filter import SPAN, Variances, filtered
from btr_mjx.gap.forces.law_scan import scan_laws
from btr_mjx.gap.forces.motion import linearise_motion, pushes
from btr_mjx.gap.forces.points import Fitted, ForceSide, Point, again, evaluate_point, names
from btr_mjx.gap.forces.predictions import RELATIVE_ERROR, compared_predictions
from btr_mjx.gap.forces.scan import Scanned, price, scan_columns
from btr_mjx.gap.forces.settling import ROUNDS, settled, updated_variances
from btr_mjx.gap.forces.unknowns import LIMIT_SIZES, with_refitted

_JITTER = 0.02
"""Jitter of time stamps to start with, in intervals."""

_SMALLEST = 0.2
"""Part of its scanned size at which a lead is not made smaller."""

_TRIED = 8
"""Leads that go one step."""

_FINALISTS = 3
"""The best of these, whose numbers are refined."""

_PLACES = 2
"""Leads of one effect among them."""


@dataclass(frozen=True, eq=False)
class SearchRound:
    """One round of the search.

    Attributes:
      before: the hypothesis to which one more effect was sought.
      leads: of the scan, best first, then those of laws.
      finalists: refined leads with their scores, best first; only those that no other one beats in predictions, from
        the first on that held-out recordings bear out, where they do so of any.
    """

    before: Fitted
    leads: tuple[Scanned, ...]
    finalists: tuple[tuple[float, Fitted], ...]


def first_variances(side: ForceSide, hypothesis: Hypothesis) -> Variances:
    """A first guess: what a hypothesis leaves is a random force, the noise is that of the dataset."""
    linear = linearise_motion(side.stretches, hypothesis, side.counter)
    moving = 2 * linear.force.shape[-1]
    force = np.einsum("skij,skj->ski", np.linalg.pinv(linear.force[..., :moving, :]), linear.defect[..., :moving])
    interval = float(np.median(linear.interval))
    return Variances(
        side.stretches.sigma**2,
        (_JITTER * interval) ** 2,
        interval / SPAN * (np.median(np.abs(force), (0, 1)) / 0.6745) ** 2 + 1e-18,
    )


def start(side: ForceSide, base: Hypothesis) -> Fitted:
    """The believed model with calibration and variances at their best.

    Args:
      side: the recordings to fit.
      base: the believed model.

    Raises:
      InputError: a body of the believed model has hardly any inertia.
    """
    point = Point(base, (), np.zeros(len(side.library.calibrated)))
    fit = settled(side, point, first_variances(side, base))
    if np.isinf(fit.loss):
        raise InputError(
            "model: its motion from one sample to the next cannot be computed; a joint or body has hardly any inertia: "
            "give it its mass, or the joint an armature"
        )
    return fit


def library_columns(side: ForceSide, fit: Fitted) -> np.ndarray:
    """(S, K, nx, C) columns of the library, taken beside a fit and its calibration.

    What an effect does depends on the motion beside it: where a delay is not yet named, servos pull with other forces.
    """
    library = side.library
    at = {e.columns[0][0]: v for e, v in zip(library.calibrated, fit.point.calibration, strict=True)}
    numbers = [with_refitted(number, at.get(i, 0.0)) for i, number in enumerate(library.numbers)]
    return fit.linear.responses(pushes(fit.linear, fit.point.hypothesis(library), numbers, side.counter))


@dataclass(frozen=True, eq=False)
class _Scene:
    """What a scan beside a fitted point needs: all columns and those of its own numbers, and their inner products."""

    columns: np.ndarray
    gram: np.ndarray
    given: np.ndarray
    calibration: CalibrationPrior
    count: int


def _scene(side: ForceSide, fit: Fitted) -> _Scene:
    library, p = side.library, fit.point.numbers
    every = np.concatenate([library_columns(side, fit), fit.columns[..., :p]], -1)
    whitened = filtered(fit.linear, every, fit.variances)
    c = len(library.numbers)
    given = np.zeros((c + p, p))
    given[c + np.arange(p), np.arange(p)] = 1.0
    padding = np.zeros((p, len(library.calibrated)))
    calibration = replace(
        library.calibration,
        design=np.concatenate([library.calibration.design, padding]),
        at=fit.point.calibration,
    )
    return _Scene(every, whitened.gram.sum(0), given, calibration, fit.whitened.count * len(side.stretches))


def one_more(
    side: ForceSide, fit: Fitted, needed: float = 0.0, laws: Sequence[Candidate] = (), drives: bool = True
) -> SearchRound:
    """Look for one more effect beside a fitted point, for what every drive has, at once, or for a law.

    A law is refined where it explains more in the scan than every effect of the library does: terms of a dictionary can
    resemble whatever is missing.

    Args:
      side: the recordings to fit.
      fit: what was named before.
      needed: score that one more effect needs.
      laws: terms of a dictionary at joints.
      drives: whether all drives may lack what they have.
    """
    library, scene = side.library, _scene(side, fit)
    entries = [entry for entry in library.entries if entry.candidate.name not in names(fit.point.named)]
    _, leads = scan_columns(scene.gram, entries, scene.given, scene.calibration, scene.count)
    choices = len({entry.candidate.name for entry in library.entries})
    whole = [
        _judged(side, fit, settled(side, point, variances), choices)
        for point in (drive_points(side, fit) if drives else [])
        if _may_pay(side, fit, scene, point, variances := first_variances(side, point.hypothesis(library)), choices)
    ]
    finalists = [*whole, *_refined(side, fit, shortlist(leads, needed), choices)]
    if laws:
        found = scan_laws(side, fit, laws)
        known = max((row[0] for row in finalists), default=0.0)
        chosen = shortlist(found.leads, max(needed, *(lead.score for lead in leads[:1])))
        for score, law in _refined(side, fit, chosen, found.choices):
            # Where simulations err, a law takes the difference to the effect of the library that is there.
            finalists.append((score - RELATIVE_ERROR**2 * max(known, 0.0), law))
        leads = [*leads, *(lead for lead in found.leads if lead.score > 0)]
    finalists.sort(key=lambda row: -row[0])
    return SearchRound(fit, tuple(leads), tuple(_unbeaten(side, finalists, needed)))


def _may_pay(side: ForceSide, fit: Fitted, scene: _Scene, point: Point, variances: Variances, choices: int) -> bool:
    """Whether what a point has beside a fit pays in the scan, with the random force that this point leaves.

    That of the fit may hide it: rotors that a model lacks are explained by whatever pushes it.
    """
    own = {candidate.name for candidate, _ in point.named} - set(names(fit.point.named))
    entries = {entry.candidate.name: entry for entry in side.library.entries if entry.candidate.name in own}
    free = [entry.design(scene.columns.shape[-1]) for entry in entries.values()]
    try:
        gram = filtered(fit.linear, scene.columns, variances).gram.sum(0)
    except np.linalg.LinAlgError:
        return False  # the point is no model of a body: what it leaves is beyond all numbers
    before, after = (
        least_squares(gram, np.concatenate([scene.given, *more], 1), scene.calibration).loss for more in ([], free)
    )
    numbers = point.numbers - fit.point.numbers
    return before - after > price(numbers, scene.count, choices)


def _refined(side: ForceSide, fit: Fitted, leads: Sequence[Scanned], choices: int) -> list[tuple[float, Fitted]]:
    """The best leads with their numbers at their best, and their scores: a race that costs more for fewer leads.

    A scan is linear, and the random force of the hypothesis before may hide most of what a lead explains:
    each is simulated, the best go one step with variances and derivatives of their own, the best of these are settled.
    """

    def best(found: Sequence[Fitted], most: int) -> list[tuple[float, Fitted]]:
        """Of an effect at `_PLACES` at most."""
        out: list[tuple[float, Fitted]] = []
        for row in sorted((_judged(side, fit, own, choices) for own in found), key=lambda row: -row[0]):
            effect = row[1].point.named[-1][0].effect
            if len(out) < most and sum(own.point.named[-1][0].effect is effect for _, own in out) < _PLACES:
                out.append(row)
        return out

    def on(found: Fitted, rounds: int) -> Fitted:
        return settled(side, found.point, found.variances, found.stretches, rounds)

    tried = best([_tried(side, fit, lead) for lead in leads], _TRIED)
    stepped = best([on(own, 1) for _, own in tried], _FINALISTS)
    return best([on(own, ROUNDS) for _, own in stepped], _FINALISTS)


def _tried(side: ForceSide, fit: Fitted, lead: Scanned) -> Fitted:
    """A lead as large as pays, with variances of its own, beside a fit whose derivatives are kept.

    A scan believes in straight lines: where servos chatter at their limits it sees a quarter of a delay.
    """
    bare = replace(fit, parts=lambda: (fit.linear, fit.pushes[..., :0], fit.whitened))
    null, low, high = (
        np.array([getattr(p, end) for p in lead.candidate.parameters]) for end in ("null", "low", "high")
    )
    limits = lead.candidate.effect.saturates
    moved = fit.point if limits else fit.point.moved(lead.changes, lead.calibration)

    def at(values: Sequence[float]) -> Fitted:
        named = (*moved.named, (lead.candidate, tuple(values)))
        return evaluate_point(side, replace(moved, named=named), fit.variances, bare)

    def sized(size: float) -> Fitted:
        return at(np.clip(null + size * (np.array(lead.values) - null), low, high).tolist())

    if limits:
        found = min((at(values) for values in _tightened(lead)), key=lambda own: own.loss)
    else:
        found, size = sized(1.0), 1.0
        for factor in (2.0, 0.5):
            while size > _SMALLEST and (after := sized(factor * size)).loss < found.loss:
                found, size = after, factor * size
    return again(side, found, updated_variances(found))


def _judged(side: ForceSide, fit: Fitted, found: Fitted, choices: int) -> tuple[float, Fitted]:
    """A fit with its score beside what was named before."""
    numbers, count = found.point.numbers - fit.point.numbers, fit.whitened.count * len(side.stretches)
    return fit.loss - found.loss - price(numbers, count, choices), found


def _unbeaten(side: ForceSide, finalists: Sequence[tuple[float, Fitted]], needed: float) -> list[tuple[float, Fitted]]:
    """Finalists that no other one with the score that is needed beats in predictions of the fitted recordings.

    Likelihoods of single intervals believe in their noise: where a model errs in another way they may prefer what
    predicts no motion, such as inertia that holds a servo still.
    """
    able = [fit for score, fit in finalists if score > needed]
    if len(able) < 2:
        return list(finalists)
    makes = [fit.point.hypothesis(side.library) for fit in able]
    better = compared_predictions(side.stretches.data, makes, side.counter)
    beaten = [fit for fit, row in zip(able, better, strict=True) if (row > 0).any()]
    return [row for row in finalists if not any(row[1] is fit for fit in beaten)]


def _tightened(lead: Scanned) -> list[tuple[float, ...]]:
    """Values of a limit that are tried: what it does is not linear."""
    limits = [(p, p.low if p.step < 0 else p.high) for p in lead.candidate.parameters]
    out = [lead.values]
    for share in LIMIT_SIZES:
        out.append(tuple(p.null if p.shape else p.null + share * (tightest - p.null) for p, tightest in limits))
    return out


def shortlist(leads: Sequence[Scanned], least: float = 0.0) -> list[Scanned]:
    """Leads that are simulated: those above a score, the best `_PLACES` of an effect, and the best limit.

    What a limit does is not linear, so that the scan says little of it.
    """
    out: list[Scanned] = []
    for lead in leads:
        same = sum(other.candidate.effect is lead.candidate.effect for other in out)
        if lead.score > least and same < _PLACES:
            out.append(lead)
    limits = [lead for lead in leads if lead.candidate.effect.saturates and lead.score > least]
    return out + [lead for lead in limits[:1] if lead not in out]


def select_effects(
    side: ForceSide,
    first: Fitted,
    most: int,
    note: Callable[[str], None],
    is_confirmed: Callable[[Fitted, Fitted], bool],
    laws: Sequence[Candidate] = (),
    drives: bool = True,
) -> tuple[list[SearchRound], list[Fitted], bool]:
    """Search for one effect after another, until nothing more pays or none of the finalists is confirmed.

    Args:
      side: the recordings to fit.
      first: the believed model, see `start`.
      most: largest number of effects.
      note: called with a word on what is being done.
      is_confirmed: whether what was not fitted bears out the second of two fits, which has one more effect.
      laws: terms of a dictionary at joints.
      drives: whether all drives may lack what they have.

    Returns:
      The rounds; the fitted points, which are the believed model and then one more confirmed effect each; and whether
      held-out recordings bore out none of several.
    """
    chain: list[Fitted] = [first]
    rounds: list[SearchRound] = []
    while len(chain[-1].point.named) < most:
        note("one more effect" if rounds else "effects")
        needed = RELATIVE_ERROR**2 * (chain[0].loss - chain[-1].loss)
        rounds.append(one_more(side, chain[-1], needed, laws, drives))
        able = [own for score, own in rounds[-1].finalists if score > needed]
        if not able:
            break
        contradicted = False
        for i, finalist in enumerate(able):
            found = pruned(side, finalist, chain[0])
            # What the new effect makes worthless may be what it is best beside: they would come and go for ever.
            if any(sorted(names(found.point.named)) == sorted(names(fit.point.named)) for fit in chain):
                continue
            note("held-out recordings")
            contradicted = not is_confirmed(chain[-1], found)
            if not contradicted:
                chain.append(found)
                rounds[-1] = replace(rounds[-1], finalists=rounds[-1].finalists[i:])
                break
        else:
            return rounds, chain, contradicted
    return rounds, chain, False
