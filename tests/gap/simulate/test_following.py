"""The share of a search that is done: it never falls, begins to grow at once and ends at its total."""

import io
import itertools
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from gap_arm import LIBRARY, QUICK, damped, dataset

from btr_mjx.gap.inference import identify
from btr_mjx.gap.simulate import Counter, followed_search
from btr_mjx.gap.simulate.following import SearchShare
from btr_mjx.runs import progress

FORCES = ["effects of the library", "effects", "held-out recordings", "one more effect", "numbers", "next experiment"]
CONTACT = ["state estimates", "windows", "linearisation", "signatures of 522 candidates", "leaders", "lack of fit"]


@pytest.mark.parametrize("phases", [FORCES, CONTACT, [*FORCES[:2], *3 * FORCES[2:4], *FORCES[4:]]])
@pytest.mark.parametrize("seed", range(5))
def test_share_never_falls(phases: list[str], seed: int) -> None:
    """Whatever the steps of its phases are, in one or several sets of recordings."""
    rng = np.random.default_rng(seed)
    share, steps, found = SearchShare(), 0, [0.0]
    for i, phase in itertools.product(range(1, 4), phases):
        share.enter(f"{i} of 3: {phase}", steps)
        for _ in range(rng.integers(4)):
            found.append(share.at(steps))
            steps += int(10 ** rng.uniform(2, 7))
        found.append(share.at(steps))
        assert (i - 1) / 3 <= found[-1] <= i / 3
    assert np.all(np.diff(found) >= 0)
    assert 0.9 < found[-1] <= 1.0


def test_share_of_expected_steps() -> None:
    share = SearchShare()
    share.enter("effects of the library", 0)
    share.expect(1000)
    assert share.at(500) == pytest.approx(0.5 * 0.14)
    assert 0.8 * 0.14 < share.at(1000) < 0.14  # what was expected may be too little
    known = SearchShare(total=1000)
    known.enter("leaders", 100)
    assert known.at(500) == pytest.approx(0.5)


def test_bar_of_a_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the first phase on a share and the time left, and at the end all of it; here of a real search, in lines."""
    monkeypatch.setattr("btr_mjx.gap.simulate.following.progress", partial(progress, interval=0.0))
    stream, made, shown = io.StringIO(), dataset(damped, seed=1, fit=2, test=1), []
    monkeypatch.setattr(sys, "stderr", stream)
    with followed_search(tmp_path / "search", lambda: None, show=True) as (journal, say):

        def noted(word: str) -> None:
            say(word)
            shown.append(stream.getvalue().splitlines()[-1])

        found = identify(made, LIBRARY[:2], max_effects=1, options=QUICK, progress=noted, counter=journal)
    lines = stream.getvalue().splitlines()
    shares = [int(match[1]) for line in lines if (match := re.search(r"(\d+)%", line))]
    assert shares == sorted(shares)
    assert shares[-1] == 100
    first = [line for line in lines if line.startswith("effects:")][-1]
    assert re.search(r"effects: +\d+%\|.*\| 00:\d\d<\d\d:\d\d, [\d.]+[kM]? steps, [\d.]+[kM]? steps/s$", first)
    assert len(set(shares)) > 5
    assert found.steps == journal.steps > Counter().steps
