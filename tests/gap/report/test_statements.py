"""No two sentences of a diagnosis disagree, whatever its numbers are; tables and figures have the same numbers."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.report.content import headline_numbers
from btr_mjx.gap.report.tables import joint_error_table
from btr_mjx.gap.results import (
    Chi2,
    Diagnosis,
    Estimate,
    JointError,
    NamedEffect,
    OpenLoop,
    RankedCandidate,
    as_result,
    detail_statements,
    format_number,
    verdict_statements,
)
from btr_mjx.gap.results.words.effects import EFFECT_WORDS
from btr_mjx.gap.results.words.mended import header_comment

MODEL = """<mujoco><worldbody><body name="torso"><joint name="knee"/><geom size=".1"/></body></worldbody>
<actuator><motor name="c" joint="knee"/></actuator></mujoco>"""
UNITS = ("N m", "N", "rad", "m", "kg", "s", "N m s/rad", "kg m^2")
PLACES = ("joint:knee", "joint:leg.knee", "body:torso", "world", "all", "subtree:leg", "actuator:c", "each:all")
EFFECTS = sorted(EFFECT_WORDS)
UNIT = r"(?:N m|N|rad|mm|m|kg|s|times|of the motor torque|%)(?=\W|$)"


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return Dataset(Path("robot"), mujoco.MjModel.from_xml_string(MODEL), None, MODEL, (), ())


def size(rng: np.random.Generator, decades: float = 6.0) -> float:
    return float(10 ** rng.uniform(-decades, decades))


def maybe(rng: np.random.Generator, value: Any, often: float = 0.7) -> Any:
    return value if rng.random() < often else None


def drawn_effect(rng: np.random.Generator, is_calibration: bool = False) -> NamedEffect:
    name, place = str(rng.choice(EFFECTS)), str(rng.choice(PLACES))
    unit, numbers = str(rng.choice(UNITS)), dict[str, Estimate]()
    for i in range(int(rng.integers(1, 25 if place == "each:all" else 3))):
        value, ends = float(rng.choice([-1, 1])) * size(rng), (None, None)
        if not is_calibration and rng.random() < 0.8:
            ends = value - size(rng), value + size(rng)  # type: ignore[assignment]
        numbers[f"number[{'abcdefghijklmnopqrstuvwxyz'[i]}]"] = Estimate(value, *ends, unit, 0.0, rng.random() < 0.1)
    score = None if is_calibration else size(rng)
    return NamedEffect(name, place, numbers, score, score, tolerances=maybe(rng, size(rng, 1)))


def drawn_errors(rng: np.random.Generator) -> tuple[JointError, ...]:
    if rng.random() < 0.1:
        before = size(rng)
        return (JointError("Delta_fitness", "m/s", 2.0, before, maybe(rng, before * size(rng, 1))),)
    is_mended, is_known, is_stepped, scale = *(rng.random(3) < 0.8), size(rng, 3)
    rows = []
    for i in range(int(rng.integers(0, 5))):
        noise = size(rng, 4)
        before, after, steady = (noise * scale ** float(rng.integers(0, 2)) * size(rng, 0.4) for _ in range(3))
        after = before if rng.random() < 0.1 else after
        step = noise * size(rng, 1) if is_stepped else None
        own = (before, after if is_mended else None, noise if is_known else None, step, steady)
        name = ("joint knee", "joint hip", "position of body torso", "joint ankle")[i]
        rows.append(JointError(name, "m" if i == 2 else "rad", 0.25, *own))
    return tuple(rows)


def drawn_candidates(rng: np.random.Generator, found: Sequence[NamedEffect]) -> tuple[RankedCandidate, ...]:
    rows = [
        RankedCandidate(one.effect, one.location, float(one.score or 0), 0.0, 1.0, None, {"n": -1.0}) for one in found
    ]
    for _ in range(int(rng.integers(0, 4))):
        names, place = rng.choice(EFFECTS, int(rng.integers(1, 4)), replace=False).tolist(), str(rng.choice(PLACES))
        together = tuple(f"{name}@{place}" for name in names) if len(names) > 1 else ()
        score, held = float(rng.normal()) * size(rng), maybe(rng, size(rng))
        rows += [RankedCandidate(name, place, score, 0.0, score, held, {"n": 1.0}, (), together) for name in names]
    return tuple(rows)


def drawn(rng: np.random.Generator) -> Diagnosis:
    """A record with any numbers, and any of them missing."""
    found = tuple(drawn_effect(rng) for _ in range(int(rng.integers(0, 5)) * int(rng.random() < 0.6)))
    ranking = drawn_candidates(rng, found)
    count = int(rng.integers(0, len(ranking) + 1))
    left = ("joint knee: 41 % of the unexplained force, 0.2 N m (root mean square)", "joint hip: a force")
    return Diagnosis(
        found,
        ranking,
        steps=1,
        seconds=1.0,
        unexplained=left[: int(rng.integers(0, 3))],
        joint_errors=drawn_errors(rng),
        open_loop=maybe(rng, OpenLoop(size(rng, 2), maybe(rng, size(rng, 2)))),
        chi2=maybe(rng, Chi2(size(rng), size(rng), 1.0)),
        calibration=tuple(drawn_effect(rng, is_calibration=True) for _ in range(int(rng.integers(0, 5)))),
        equivalent=tuple(f"{row.effect}@{row.location}" for row in ranking[:count]),
        share=maybe(rng, float(rng.uniform(-1, 1))),
    )


def drawn_result(rng: np.random.Generator, dataset: Dataset) -> tuple[Diagnosis, dict[str, Any]]:
    diagnosis = drawn(rng)
    result = as_result(diagnosis, dataset) | {"next_experiment": maybe(rng, {"text": "x"})}
    if rng.random() < 0.2:
        result["before"] = {"verdict": str(rng.choice(["effect", "none", "unexplained"])), "sentence": "Nothing more"}
    return diagnosis, result


def sentences(text: str) -> list[str]:
    return [part for part in re.split(r"[.!?](?:\s|$)", text.replace("mended.xml", "file")) if part.strip()]


def numbers_without_unit(text: str) -> list[str]:
    """Numbers of a sentence that no unit follows; those of an interval or a range share the unit behind it."""
    number = r"−?\d+(?:\.\d+)?(?:·10\^−?\d+)?"
    text = re.sub(rf"{number} \[{number}, {number}\]", "7", text)
    text = re.sub(rf"{number} ± {number}", "7", text)
    text = re.sub(rf"from {number} to {number}", "7", text)
    text = re.sub(r"\d+ more", "more", text).replace("m²", "m")  # candidates are counted
    return [m[0] for m in re.finditer(number, text) if not re.match(rf"°| {UNIT}", text[m.end() :])]


def floor(row: JointError) -> float:
    return ((row.noise or 0) ** 2 + (row.time_step or 0) ** 2) ** 0.5 if row.noise else 1.0


def at_noise(rows: Sequence[JointError], key: str) -> bool | None:
    """Whether no joint errs by more than twice the noise, by a loop; None where noise is not known."""
    ratios = [getattr(row, key) / floor(row) for row in rows if row.noise and getattr(row, key) is not None]
    return max(ratios) <= 2 if ratios else None


def size_of_misfit(rows: Sequence[JointError], key: str) -> str:
    total = 0.0
    for row in rows:
        total += (getattr(row, key) / floor(row)) ** 2
    return format_number((total / len(rows)) ** 0.5)


def check_no_two_sentences_disagree(diagnosis: Diagnosis, result: dict[str, Any]) -> None:
    first, rest = verdict_statements(result), detail_statements(result)
    text = " ".join(one.text for one in first if one.text)
    assert 1 <= len(sentences(text)) <= 2
    assert all(len(sentences(one.text)) <= 2 for one in rest)
    assert not numbers_without_unit(text)
    claims: dict[str, Any] = {}
    for one in (*first, *rest):
        for key, value in one.claims.items():
            assert claims.setdefault(key, value) == value, key
            assert not isinstance(value, str) or value in one.text
    everything = " ".join([text, *(one.text for one in rest)])

    rows = diagnosis.joint_errors
    is_mended = bool(rows) and rows[0].after is not None
    reached = at_noise(rows, "after" if is_mended else "before")
    assert claims.get("noise reached", reached) == reached
    assert reached or not re.search(r"rest is noise|within the noise|close to the noise", everything)
    assert reached is not True or "more than noise" not in everything
    if diagnosis.verdict == "unexplained":
        chi2 = diagnosis.chi2
        assert not reached or (chi2 is not None and chi2.after > chi2.nulls)
        assert ("too little to be seen" in text) == (reached is True)
        assert diagnosis.unexplained
    assert (diagnosis.verdict == "effect") == bool(diagnosis.effects)
    assert (*diagnosis.effects, *diagnosis.unnamed) == diagnosis.found
    assert claims.get("something is missing", diagnosis.verdict != "none") == (diagnosis.verdict != "none")

    if "misfit" in claims:
        assert claims["misfit"] == size_of_misfit(rows, "before")
    if "misfit after" in claims:
        assert claims["misfit after"] == size_of_misfit(rows, "after")
    if "falls" in claims:
        kept, made = (sum((getattr(row, key) / floor(row)) ** 2 for row in rows) for key in ("before", "after"))
        assert claims["falls"] == (made < kept)
        assert claims["falls"] or "share" not in claims
        assert claims["falls"] or "mended model is of use" in claims or diagnosis.verdict != "effect"
    assert ("share" in claims) <= (" explain" in text)
    if not result.get("before"):
        assert (diagnosis.mended_kind is None) == ("mended.xml" not in everything)
        assert ("A part of what is missing" in text) == (diagnosis.mended_kind == "partly explained")

    figures = dict(headline_numbers(result))
    assert claims.get("misfit", figures.get("misfit, believed model")) == figures.get("misfit, believed model")
    cells: dict[str, list[str]] = {}
    for table in joint_error_table(result):
        unit = table.columns.index("unit")
        for row in table.rows:
            cells[str(row[0])] = [f"{cell}{'' if row[unit] == '°' else ' '}{row[unit]}" for cell in row[1:unit]]
    for key, value in claims.items():
        if key.startswith("error of "):
            joint = key.removeprefix("error of ").rpartition(", ")[0]
            assert value in cells[joint]
    comment = header_comment(result)
    assert comment.count("<!--") == comment.count("-->") == 1
    assert "--" not in comment[4:-4]


def test_no_two_sentences_disagree(dataset: Dataset) -> None:
    rng = np.random.default_rng(0)
    for _ in range(500):
        check_no_two_sentences_disagree(*drawn_result(rng, dataset))


@pytest.mark.slow
def test_no_two_sentences_of_twenty_thousand_records_disagree(dataset: Dataset) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20_000):
        check_no_two_sentences_disagree(*drawn_result(rng, dataset))


def test_every_kind_of_record_is_drawn(dataset: Dataset) -> None:
    """The test above is not of one kind of record only."""
    rng = np.random.default_rng(2)
    many = [drawn(rng) for _ in range(600)]
    kinds = {(one.verdict, one.mended_kind, None if one.misfit is None else one.misfit.noise_reached) for one in many}
    assert {kind for _, kind, _ in kinds} == {"explained", "partly explained", "unnamed", "calibrated", None}
    assert {verdict for verdict, _, _ in kinds} == {"effect", "none", "unexplained"}
    assert {reached for _, _, reached in kinds} == {True, False, None}
