"""The search for the missing effect: candidates are scanned, leaders refined, and judged on data not used for it.

A `Bench` holds the windows of the recordings to fit and of those held out, linearised around the believed model, with
the signatures of every candidate. `Bench.find` returns the judged leaders of one round, best first; a second round
searches for one more effect beside those that were found.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, noise_of, reduced_noise, with_imu
from btr_mjx.gap.effects import Candidate, Effect, Hypothesis, candidates
from btr_mjx.gap.inference.scoring.calibration import tolerance_draws, with_nonlinear_tolerances
from btr_mjx.gap.inference.scoring.gains import fall
from btr_mjx.gap.inference.scoring.hypotheses import refitted, unknowns
from btr_mjx.gap.inference.scoring.refine import Nuisance, Refined, refine
from btr_mjx.gap.inference.scoring.scanner import Lead, Scanner
from btr_mjx.gap.inference.scoring.screening import (
    FIRST_TOLERANCE,
    Entry,
    Screen,
    changed_fields,
    entries_of,
    is_contact_sensitive,
    screen,
    simulated,
    tolerances_of,
    with_tolerances,
)
from btr_mjx.gap.inference.search.contact_scan import contact_scan, with_contacts, with_line_search
from btr_mjx.gap.inference.search.line_search import EVERY, LineSearch
from btr_mjx.gap.inference.search.search_records import Judged, Side, Started
from btr_mjx.gap.inference.search.shortlist import pick, starts
from btr_mjx.gap.simulate import Counter, run_in_threads
from btr_mjx.gap.windows import (
    Fit,
    Options,
    Survey,
    Track,
    Windows,
    best_span,
    choose_windows,
    linearise,
    prepare,
    reliable_windows,
    scales_of,
    survey,
    track_of,
    typical_chi2,
)

_CUT = 1.5
"""A window whose chi^2 exceeds its degrees of freedom by this factor begins to count less."""

_DRAWS = 8
"""Draws of all tolerances that show where these leave the linear picture."""

_QUIETER = 4
"""Times that noise is estimated again from what the believed model leaves."""

_FEW = 6
"""Up to so many believed numbers are refitted together with every leader."""

_STRONG = 3.0
"""Chi^2 that the believed model leaves, in units of what the best leaves, beyond which an effect is strong."""


class Bench:
    """Everything a search needs about one dataset.

    Attributes:
      dataset: the data.
      base: the believed model after its refit.
      before: the believed values as given.
      fit, test: the two sides of the split.
      scanner: linear scans on the side that is fitted.
      line_search: judges what is contact-sensitive with directions of its own.
      survey: what the recordings go through.
      tolerances: 1 sigma of what calibration leaves, by candidate.
      counter: simulated steps so far.
      cut: chi^2 above which a window counts less.
      dispersion: chi^2 per degree of freedom of the best hypothesis, at least 1.
    """

    fit: Side
    test: Side
    base: Hypothesis

    def __init__(
        self,
        dataset: Dataset,
        effects: Sequence[Effect],
        options: Options | None = None,
        note: Callable[[str], None] | None = None,
        counter: Counter | None = None,
    ) -> None:
        self.dataset, self.options = dataset, options or Options()
        note, self.counter = note or (lambda _: None), counter or Counter()
        for name, side in (("fit", dataset.fit), ("test", dataset.test)):
            if not side:
                raise InputError(f"{dataset.folder}: no recording is in split {name!r}")
        note("state estimates")
        recordings = with_imu(dataset.recordings, partial(self.counter.add, 0))
        dataset = self.dataset = replace(dataset, recordings=tuple(recordings))
        tracks = [track_of(r) for r in dataset.recordings]
        noise = noise_of(dataset)
        self.sigma = np.concatenate([noise.qpos, noise.qvel])
        entries = self._prepared(effects, tracks, note)
        for _ in range(_QUIETER if dataset.noise is None else 0):
            windows = self.fit.windows
            less = reduced_noise(self.sigma, windows.channels, windows.residual, windows.freedom, windows.changes_only)
            if less is None:
                break
            self.sigma, self.options = less, options or Options()
            entries = self._prepared(effects, tracks, note)
        note(f"signatures of {len(entries)} candidates")
        self._draws = tolerance_draws(self.base, self.candidates, self.tolerances, np.random.default_rng(0), _DRAWS)
        loose, known = with_tolerances(entries, self.tolerances)
        self._loose = {entry.candidate.name: FIRST_TOLERANCE + i for i, entry in enumerate(loose)}
        bare = Hypothesis((), ())  # what may be refitted is refitted on the other side only
        sides = ((self.fit.windows, entries, self.base), (self.test.windows, known, bare))

        def screened(windows: Windows, own: Sequence[Entry], refitted: Hypothesis) -> tuple[Screen, Nuisance]:
            return self._with_nonlinear_tolerances(windows, refitted, screen(windows, self.base, own, self.single))

        (found, nuisance), (_, other) = run_in_threads([partial(screened, *side) for side in sides])
        self.fit, self.test = Side(self.fit.windows, nuisance), Side(self.test.windows, other)
        self.scanner = Scanner(found, nuisance)
        self.dispersion, self.cut = 1.0, _CUT * self.fit.windows.freedom
        self.settle(None)
        self.line_search = self._line_search()

    def _line_search(self) -> LineSearch:
        every = 1 if self.tossed else EVERY
        return LineSearch(self.fit, self.base, self.free, self.fall, lambda: self.cut, every)

    def _prepared(self, effects: Sequence[Effect], tracks: Sequence[Track], note: Callable[[str], None]) -> list[Entry]:
        """Windows of both sides, linearised around the believed model, and what is to be tried there."""
        dataset, model = self.dataset, self.dataset.fit[0].model
        span = best_span(model, list(tracks), self.sigma)
        data = prepare(dataset.fit, self.sigma, span)
        held = prepare(dataset.test, self.sigma, span)
        self.survey: Survey = survey(data, self.counter)
        self.scales = scales_of(data)
        self.candidates = candidates(model, self.scales, effects)
        self.before = tuple(parameter.value(dataset.model) for parameter in dataset.parameters)
        self.base = Hypothesis(dataset.parameters, self.before)
        fields = changed_fields(self.candidates, model, self.base) if self.survey.contact else {}
        self.contact_sensitive = {name for name, changed in fields.items() if is_contact_sensitive(changed)}
        interval = float(np.median(np.diff(dataset.fit[0].commands[0])))
        self.tolerances = tolerances_of(self.candidates, dataset.tolerances, self.contact_sensitive, interval)
        entries = entries_of(self.candidates, self.contact_sensitive)
        note("windows")
        count = sum(len(entry.steps) for entry in entries if simulated(entry.candidate))
        chosen = choose_windows(data, held, self.base, self.survey, count, self.options, self.counter)
        self.fit, self.test = (Side(own, Nuisance.nothing(0, 0)) for own in chosen.windows)
        self.single, self.options, self.survey = chosen.single, chosen.options, chosen.survey
        self._start(note)
        return entries

    def _start(self, note: Callable[[str], None]) -> None:
        """Linearise around the believed model, refitting what may be refitted first."""
        windows, held = self.fit.windows, self.test.windows
        note("linearisation")
        if not self.base.parameters:
            windows, held = run_in_threads([partial(linearise, side, self.base) for side in (windows, held)])
        else:
            windows = linearise(windows, self.base)
            note("refit of the believed parameters")
            for _ in range(2):
                self.base = refitted(windows, self.base, _CUT)
                windows = linearise(windows, self.base)
            held = linearise(held, self.base)
        contact = self.survey.contact
        self.fit, self.test = (
            replace(side, windows=reliable_windows(own, self.base, contact))
            for side, own in zip((self.fit, self.test), (windows, held), strict=True)
        )

    def _with_nonlinear_tolerances(
        self, windows: Windows, base: Hypothesis, screened: Screen
    ) -> tuple[Screen, Nuisance]:
        """Nuisances of one side, after what tolerances do to contacts has been taken into account there."""
        draws, cut = self._draws if self.survey.contact else [], _CUT * windows.freedom
        return with_nonlinear_tolerances(windows, base, screened, draws, self.tolerances, self.single, cut)

    @property
    def joint(self) -> bool:
        """Whether the believed numbers are refitted together with every leader."""
        return 0 < len(self.base.parameters) <= _FEW

    @property
    def tossed(self) -> bool:
        """Whether contacts are all that drives the system.

        Where a body slides that was believed to tumble, the believed model's starting states and their directions tell
        little, and its few windows are all needed.
        """
        return self.survey.contact and not self.dataset.model.nu

    @property
    def strong(self) -> bool:
        """Whether what is missing is so strong that starting states of the believed model tell little beside it.

        Where a robot touches the world, directions of their own are for what is contact-sensitive.
        """
        if self.survey.contact:
            return self.tossed
        usual = typical_chi2(self.reference[0].chi2, self.fit.windows.freedom)
        return usual > _STRONG * self.dispersion * self.fit.windows.freedom

    def settle(self, best: np.ndarray | None) -> None:
        """Fit the dispersion to the best chi^2 (W,) so far, and the reference losses with it."""
        side, residual = self.fit, self.fit.windows.residual
        if best is None:
            cut = _CUT * typical_chi2((residual**2).sum(1), side.windows.freedom)
            dispersion = max(1.0, cut / (_CUT * side.windows.freedom))
            best = side.nuisance.against(dispersion).profile(residual, cut).chi2
        usual = typical_chi2(best, side.windows.freedom)
        self.dispersion, self.cut = usual / side.windows.freedom, _CUT * usual
        self.reference = self._reference(side), self._reference(self.test)

    def _reference(self, side: Side) -> Fit:
        return self.nuisance(side).profile(side.windows.residual, self.cut)

    def nuisance(self, side: Side, hypothesis: Hypothesis | None = None) -> Nuisance:
        """The tolerances of a side, as tight as they are beside what no hypothesis explains.

        Args:
          side: of the split.
          hypothesis: whose effects need no tolerance beside them; None for the believed model.
        """
        added = () if hypothesis is None else hypothesis.effects
        singles = [single.name for candidate, _ in added for single in candidate.singles]
        own = [self._loose[name] for name in singles if name in self._loose]
        return side.nuisance.against(self.dispersion).without(own)

    def find(self, given: Judged | None = None) -> list[Judged]:
        """One round: scan, refine, judge.

        Args:
          given: what was found before; None for the believed model.

        Returns:
          Judged leaders, best first, gains measured against the believed model.
        """
        start = self.base if given is None else given.hypothesis
        options = self.options if given is None else self.options.fewer()
        sides = (self.fit, self.test) if given is None else given.sides
        residual = self.fit.windows.residual if given is None else given.refined.residual
        extra = None if given is None else given.refined.columns
        # Numbers of each member leave nothing of the kind to be said of these members.
        taken = {c.name for c in self.candidates for own, _ in start.effects if own is c or own.covers(c)}
        leads = self.scanner(
            residual, self.cut, extra, dispersion=self.dispersion, thorough=400 if given is None else 40
        )
        leads = [lead for lead in leads if self._entry(lead).candidate.name not in taken]
        if given is None and leads:
            self.settle(self.scanner.best_left(leads[:5], residual, self.nuisance(self.fit), self.cut))
        price = np.log(self.fit.windows.residual.size) * self.dispersion
        if given is not None:
            # Most robots lack one thing: what is not worth its price in the linear picture is not simulated as well.
            leads = [lead for lead in leads if lead.gain > price * len(lead.values)]
        entries = self.scanner.screened.entries
        picked = pick(leads, entries, options, price)
        starting = {own[0].index: starts(own, self._entry) for own in picked.values()}
        tries = [(entries[index].candidate, values) for index, values in starting.items()]
        strongest = max((lead.gain for lead in leads), default=0.0)
        moving = [c for c in self.candidates if c.name in self.contact_sensitive and c.name not in taken]
        if moving:
            side = Side(sides[0].windows, self.free(sides[0]))
            scanned = contact_scan(side, start, moving, self.cut, residual, 1 if self.tossed else options.every)
            if not start.effects:
                scanned = with_line_search(scanned, start, self.line_search, strongest, self.tossed)
            tries = with_contacts(tries, scanned, options.contact_leaders)
        if not tries:
            return []
        hypotheses = [self.started(start, candidate, values) for candidate, values in tries]
        count = [1 if c.name in self.contact_sensitive else options.iterations for c, _ in tries]
        found = self.refined(sides[0], hypotheses, count, (self.reference if given is None else given.fits)[0])
        if given is None:
            self.settle(min(found, key=lambda r: r.loss).chi2)
        refined = [own.replaced(r.values, self.joint) for (own, _), r in zip(hypotheses, found, strict=True)]
        return self.judge(refined, found, sides, None if given is None else given.references, given)

    def started(self, start: Hypothesis, candidate: Candidate, values: Sequence[np.ndarray]) -> Started:
        """A hypothesis with one more effect, and all its free numbers for each of the effect's starting values."""
        own = start.with_effect(candidate, values[0])
        head = own.values(self.joint)[: -len(values[0])]
        return own, [np.concatenate([head, v]) for v in values]

    def refined(self, side: Side, hypotheses: Sequence[Started], count: Sequence[int], reference: Fit) -> list[Refined]:
        """Hypotheses refined on one side, each from the best of its starts."""
        return refine(
            side.windows,
            [self.free(side, own) for own, _ in hypotheses],
            self.cut,
            [(unknowns(own, self.joint, self.contact_sensitive), tries) for own, tries in hypotheses],
            count,
            reference,
        )

    def free(self, side: Side, hypothesis: Hypothesis | None = None) -> Nuisance:
        """What is fitted along on the side to fit: without the believed numbers where these move by themselves."""
        nuisance = self.nuisance(side, hypothesis)
        if not self.joint:
            return nuisance
        keep = slice(0, len(nuisance.precision) - len(self.base.parameters))
        return Nuisance(nuisance.columns[:, keep], nuisance.precision[keep], nuisance.gram[:, keep, keep])

    def judge(
        self,
        hypotheses: Sequence[Hypothesis],
        found: Sequence[Refined],
        sides: tuple[Side, Side],
        references: tuple[Fit, Fit] | None = None,
        given: Judged | None = None,
    ) -> list[Judged]:
        """Judge refined hypotheses on both sides of the split, best first.

        Args:
          hypotheses: with their refined values.
          found: what the refinement found on the recordings to fit.
          sides: of the split, to judge on.
          references: fits of the believed model on both sides; None for the usual ones.
          given: what each of them has one more effect than. They are compared with that window by window, and its
            gains added: in comparison with the believed model, what a weak effect says drowns in what a strong one
            does to the windows that count less.
        """
        held, out = sides[1].windows.residuals(list(hypotheses)), []
        size = np.log(self.fit.windows.residual.size + self.test.windows.residual.size)
        reference = self.reference if references is None else references
        before = reference if given is None else given.fits
        for hypothesis, refined, residual in zip(hypotheses, found, held, strict=True):
            along = self.free(sides[0], hypothesis), self.nuisance(sides[1], hypothesis)
            own = along[0].profile(refined.residual, self.cut), along[1].profile(residual, self.cut)
            even = hypothesis.effects[-1][0].name not in self.contact_sensitive
            gain, held_out = (self.fall(a, b, even=even) for a, b in zip(before, own, strict=True))
            if given is not None:
                gain, held_out = gain + given.gain, held_out + given.held_out
            score = gain + held_out - size * hypothesis.numbers
            out.append(Judged(hypothesis, refined, gain, held_out, score, residual, own, sides, reference))
        return sorted(out, key=lambda judged: -judged.score)

    def fall(self, before: Fit, after: Fit, share: float = 1.0, even: bool = False) -> float:
        """Robust fall of the loss, see `gains.fall`, in units of the dispersion."""
        return fall(before, after, self.cut, share, even) / self.dispersion

    def _entry(self, lead: Lead) -> Entry:
        return self.scanner.screened.entries[lead.index]
