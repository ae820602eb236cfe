"""No two sentences of a co-evolution disagree: all that is told comes from one record."""

import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.backtoreality import export_coevolution, summary_table
from btr_mjx.backtoreality.summary import NOT_TOLD
from btr_mjx.backtoreality.told_words import MOST_NAMED, identified_words, told_record, told_sentence
from btr_mjx.backtoreality.trial_information import Told
from btr_mjx.gap.results import format_number
from btr_mjx.pages.coevolution_page import coevolution_content
from btr_mjx.plotting import RunData
from btr_mjx.robots import Box
from btr_mjx.runs import read_json, write_json


@st.composite
def results(draw: st.DrawFn) -> tuple[dict[str, Any], Box]:
    """Content of result.json with what random trials tell of one to six numbers, and their box."""
    count = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    names = [f"number {letter}" for letter in "uvwxyz"[:count]]
    low = rng.normal(size=count)
    box = Box(names, low, low + rng.uniform(0.1, 5, count), units=rng.choice(["", "m", "kg"], count).tolist())
    root = rng.normal(size=(count, count)) * 10 ** rng.uniform(-3, 0, count)
    at, estimate, others = rng.random(count), rng.random(count), rng.random((rng.integers(0, 3), count))
    told = told_record(Told(at, estimate, root @ root.T, 0.1, others), box)
    values = lambda shares: dict(zip(names, (box.low + box.span * shares).tolist(), strict=True))  # noqa: E731
    known = {name: value for name, value in values(rng.random(count)).items() if rng.random() < draw(st.floats(0, 1))}
    space = {
        name: {"low": low, "high": high, "unit": unit}
        for name, low, high, unit in zip(names, box.low.tolist(), box.high.tolist(), box.units, strict=True)
    }
    numbers = ("prediction_error_first", "prediction_error_last", "delta_fitness_last", "lp")
    fitness = ("f_r_best", "f_s_best", "f_r_best_first_iteration", "f_r_first_controller")
    result = dict.fromkeys((*numbers, *fitness), 1.0) | {
        "start": values(rng.random(count)),
        "simulation": values(at),
        "truth": known or None,
        "told": told,
        "space": space,
        "growth": [],
        "distance": "fitness",
        "fitness_unit": "m/s",
        "iterations": 2,
        "failed_trials": 0,
        "reality_evaluations": 5,
        "stop": "iterations",
    }
    return result, box


def page_of(result: dict[str, Any], box: Box) -> dict[str, Any]:
    array = lambda values: np.array([values[name] for name in box.names])  # noqa: E731
    run = RunData(
        fitness="distance",
        unit="m/s",
        maximise=True,
        box=box,
        start=array(result["start"]),
        identified=array(result["simulation"]),
        truth=None if result["truth"] is None else np.array([result["truth"].get(n, np.nan) for n in box.names]),
        iterations=pl.DataFrame({"iteration": [1, 2], "delta_before": [2.0, 1.0], "delta_after": [1.0, 0.5]}),
        trials={"f_s": np.arange(5.0), "f_r": np.ones(5), "iteration": np.array([0, 1, 1, 2, 2])},
        controllers=[],
        simulations=[],
        result=result,
    )
    return coevolution_content(Path("run"), run, [])


@settings(max_examples=60, deadline=None)
@given(results())
def test_all_sentences_say_the_same(case: tuple[dict[str, Any], Box]) -> None:
    result, box = case
    told, rest = result["told"]["told"], [name for name in box.names if name not in result["told"]["told"]]

    # The line after each iteration.
    line = told_sentence(result["told"], box)
    for name in box.names:
        assert bool(re.search(rf"\): .*?{name} -?\S+ to [^;]*(;|$)", line)) is (name in told), line
        assert bool(re.search(rf"; not told: [^;]*{name}", line)) is (name in rest), line

    # The table in the terminal, that of the page, and the file for other programs.
    rows = {line[:8]: line for line in summary_table(result, Path("run")).splitlines() if line.startswith("number ")}
    page = page_of(result, box)
    (table,) = page["sections"][0].tables
    note = table.columns.index("note") if "note" in table.columns else None
    with tempfile.TemporaryDirectory() as folder:
        write_json(Path(folder) / "result.json", result)
        export_coevolution(Path(folder))
        exported = {row["name"]: row for row in read_json(Path(folder) / "parameters.json")}
    for name, row in zip(box.names, table.rows, strict=True):
        assert (NOT_TOLD in rows[name]) is (name in rest)
        assert (note is not None and NOT_TOLD in row[note]) is (name in rest)
        assert (NOT_TOLD in exported[name]["origin"]) is (name in rest)
        interval = result["told"]["intervals"][name]
        assert [exported[name]["interval_low"], exported[name]["interval_high"]] == interval
        ends = row[table.columns.index("90 % interval")]
        assert ends.split("\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}") == [format_number(end, 4) for end in interval]
        assert interval[0] - 1e-9 <= result["simulation"][name] <= interval[1] + 1e-9

    # The headline: no value of a number that is not told, and every number counted once.
    words = identified_words(result)
    assert f"; {words}." in page["sentence"]
    for name in rest:
        assert not re.search(rf"{name} (goes|stays)", page["sentence"])
        assert (name in words) is (len(rest) <= MOST_NAMED)
    for name in told:
        assert bool(re.search(rf"{name} (goes|stays)", words)) is (len(told) <= MOST_NAMED)
    counts = [int(count) for count in re.findall(r"(\d+) parameters", words)]
    assert counts == [len(names) for names in (told, rest) if len(names) > MOST_NAMED]
