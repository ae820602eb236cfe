"""The page of a diagnosis, from files that a test can write by hand."""

import html.parser
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_models import QUADRUPED
from gap_results import RESULT

import btr_mjx.pages
from btr_mjx.errors import InputError
from btr_mjx.gap.report import draw_report, figures
from btr_mjx.gap.results import (
    REASON_NOT_NAMED,
    FoundEffect,
    detail_sentences,
    mend,
    verdict_sentence,
)
from btr_mjx.report import main
from btr_mjx.runs import read_arrays, write_arrays, write_json, write_table


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    write_json(tmp_path / "result.json", RESULT)
    rows = [f"joint {name}" for name in ("hip0", "knee0", "hip1", "knee1")]
    columns = ["slow", "fast", "small load", "large load", "contact", "air"]
    before = rng.uniform(0.9, 1.6, (4, 6))
    before[1, [1, 3]] = [21.0, 34.0]
    before[2, 4] = np.nan
    write_arrays(
        tmp_path / "disagreement.npz",
        {"rows": np.array(rows), "units": np.array(["N m"] * 4), "columns": np.array(columns)}
        | {"before": before, "after": np.minimum(before, 1.3)},
    )
    arrays: dict[str, Any] = {key: np.array([v, v]) for key, v in (("names", "knee0"), ("units", "rad"))}
    arrays["recordings"] = np.array(["trot-07", "trot-08"])
    for n, length in enumerate((0.08, 2.0)):
        time = np.linspace(1, 1 + length, 400)
        truth = 0.4 * np.sin(6 * time + n)
        arrays |= {f"time_{n}": time, f"measured_{n}": truth + 0.003 * rng.normal(size=400)}
        arrays |= {f"before_{n}": truth + 0.1 * np.sin(5 * time), f"after_{n}": truth}
    write_arrays(tmp_path / "overlays.npz", arrays)
    mended = mend(QUADRUPED, [FoundEffect("load_friction", "joint:knee0", {"coefficient": 0.312})])
    (tmp_path / "mended.xml").write_text(mended.xml)
    write_json(tmp_path / "mended.json", mended.as_json())
    write_json(tmp_path / "environment.json", {"mujoco": "3.17.0", "python": "3.12.1"})
    return tmp_path


class Page(html.parser.HTMLParser):
    """Collects text, images and addresses of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.addresses: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "img":
            self.images.append(given)
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def test_the_page_is_complete_and_self_contained(folder: Path) -> None:
    page = Page(draw_report(folder).read_text(encoding="utf-8"))
    assert "Simulation and data disagree most at joint knee0, when it moves fast under load." in page.text
    assert (
        "A part of what is missing is load-dependent gear friction at joint knee0 (0.312 ± 0.030 of the motor torque)."
        in page.text
    )
    assert (
        "It explains 12 % of the disagreement on recordings that were not used: predicted over 0.25 s, joint knee0 is "
        "off by 0.573° instead of 4.01°, where noise and the time step make 0.115°; more than noise is left, most of "
        "it at joint knee1." in page.text
    )
    assert "falls from 62.2 to 55 (1: what noise and the time step make, root mean square over joints)." in page.text
    assert "The next best that is not equivalent: dry friction at joint knee0, far behind" in page.text
    assert "quadruped <left>" in page.text  # escaped in the source
    assert "joint knee0 4.01 0.573 0.115 0.115 ° 35 5 position of body torso 4 1 0.2 0.2 mm 20 5" in page.text
    for heading in ("What is missing", "Where simulation", "Candidates", "Before and after", "Believed", "mistaken"):
        assert heading in page.text
    assert "Drive knee0 at twice the speed" in page.text
    assert "712 000 simulated steps" in page.text
    assert "joint knee0 " in page.text[page.text.index("Where simulation and data disagree") :]
    assert not page.images
    assert not page.addresses


def test_the_same_files_draw_the_same_page(folder: Path) -> None:
    assert draw_report(folder).read_bytes() == draw_report(folder).read_bytes()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"verdict": "none", "effects": [], "equivalent": []}, "though more than noise is left"),
        (
            {"verdict": "unexplained", "effects": [], "unexplained": ["joint knee0, a force that follows its angle"]},
            "follows",
        ),
        (
            {"verdict": "unexplained", "effects": [], "unexplained": ["a", "b"]},
            "It looks like this: a.",
        ),
    ],
)
def test_other_verdicts(folder: Path, change: dict[str, Any], expected: str) -> None:
    write_json(folder / "result.json", RESULT | change)
    for name in ("disagreement.npz", "overlays.npz", "mended.xml", "environment.json"):
        (folder / name).unlink()
    shutil.rmtree(folder / "figures", ignore_errors=True)
    assert expected in Page(draw_report(folder).read_text(encoding="utf-8")).text


def test_a_model_that_was_not_mended_is_drawn_once(folder: Path) -> None:
    assert "the two models differ most" in Page(draw_report(folder).read_text(encoding="utf-8")).text
    arrays = dict(read_arrays(folder / "overlays.npz"))
    write_arrays(folder / "overlays.npz", arrays | {f"after_{n}": arrays[f"before_{n}"] for n in range(2)})
    write_json(folder / "result.json", RESULT | {"verdict": "unexplained", "unexplained": ["a force"]})
    page = Page(draw_report(folder).read_text(encoding="utf-8"))
    assert "the believed model is worst" in page.text


def curves_of(page: Path) -> list[dict[str, Any]]:
    found = re.findall(r'<script type="application/json">(.*?)</script>', page.read_text(encoding="utf-8"), re.S)
    return [json.loads(text) for text in found]


def test_curves_hold_the_saved_stretches_in_degrees_and_millimetres(folder: Path) -> None:
    arrays = dict(read_arrays(folder / "overlays.npz"))
    arrays |= {"units": np.array(["rad", "m"]), "measured_1": np.where(np.arange(400) == 7, np.nan, 0.25)}
    write_arrays(folder / "overlays.npz", arrays)
    page = draw_report(folder)
    first, second = curves_of(page)
    assert [name for name, _ in first["lines"]] == ["measured", "believed model", "mended model"]
    np.testing.assert_allclose(first["time"], arrays["time_0"], atol=1e-6)
    for (_, values), key in zip(first["lines"], ("measured", "before", "after"), strict=True):
        np.testing.assert_allclose(values, np.degrees(arrays[f"{key}_0"]), rtol=1e-5)
    assert second["lines"][0][1][6:9] == [250.0, None, 250.0]
    text = page.read_text(encoding="utf-8")
    assert "knee0, recording trot-07 [°]" in text
    assert "knee0, recording trot-08 [mm]" in text


def test_long_stretches_leave_the_page_small(folder: Path) -> None:
    rng = np.random.default_rng(0)
    arrays: dict[str, Any] = {key: np.array(["x"] * 9) for key in ("recordings", "names")} | {
        "units": np.array(["rad"] * 9)
    }
    for n in range(9):
        arrays |= {f"{key}_{n}": rng.normal(size=50_000) for key in ("measured", "before", "after")}
        arrays[f"time_{n}"] = np.arange(50_000) / 1000
    write_arrays(folder / "overlays.npz", arrays)
    assert draw_report(folder).stat().st_size < 3_000_000


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js on this machine: scripts are not run")
def test_curves_are_drawn_zoomed_and_read_off(folder: Path, tmp_path: Path) -> None:
    """The script of the page with a stand-in for the browser's document."""
    template = Path(btr_mjx.pages.__file__).parent / "templates" / "curves.js"
    data = curves_of(draw_report(folder))[1]
    (tmp_path / "run.js").write_text(BROWSER % json.dumps(data) + template.read_text() + ACTIONS)
    done = subprocess.run(["node", str(tmp_path / "run.js")], capture_output=True, text=True, timeout=60, check=True)
    said = json.loads(done.stdout)
    assert said["drawn"] == said["again"] == 3  # a path for each curve
    assert said["hidden"] == [True, False, True]
    time, measured = data["time"], data["lines"][0][1]
    assert said["read"].startswith(f"{time[200]:.4g} s, measured {measured[200]:.4g}".replace("-", "\N{MINUS SIGN}"))
    assert said["zoomed"] == pytest.approx([100, 300], abs=2)
    assert said["fewer"] == 2
    assert "measured 0," in said["minus"]


BROWSER = """
const handlers = new Map(), on = owner => (name, act) => handlers.set(owner + ":" + name, act);
const element = (name, more) => Object.assign({addEventListener: on(name), children: []}, more);
const part = () => element("part", {setAttribute(k, v) { this[k] = v; }, remove() {}});
const svg = element("svg", {clientWidth: 652, clientHeight: 220, querySelectorAll: () => [], setPointerCapture() {},
  getBoundingClientRect: () => ({left: 0}), replaceChildren() { this.children = []; },
  appendChild(one) { this.children.push(one); return one; }});
const boxes = ["a", "b", "c", "minus"].map(name => element(name, {checked: name !== "minus"}));
const said = {textContent: "hint"}, whole = element("whole", {hidden: true});
const figure = {querySelectorAll: () => boxes, querySelector: what => (
  {script: {textContent: `%s`}, svg, ".read": said, button: whole})[what]};
globalThis.document = {querySelectorAll: () => [figure], createElementNS: part};
globalThis.addEventListener = () => {};
"""
ACTIONS = """
const curves = () => svg.children.filter(one => /^l\\d/.test(one.class));
const at = i => ({clientX: 52 + 600 * i / 399, pointerId: 1});
const act = (name, event) => handlers.get(name)(event), out = {drawn: curves().length, hidden: [whole.hidden]};
act("svg:pointermove", at(200)); out.read = said.textContent;
act("svg:pointerdown", at(100)); act("svg:pointermove", at(300)); act("svg:pointerup", at(300));
out.hidden.push(whole.hidden); out.zoomed = [];
const ends = JSON.parse(figure.querySelector("script").textContent).time;
for (const x of [52, 652]) { act("svg:pointermove", {clientX: x}); const t = parseFloat(said.textContent);
  out.zoomed.push(ends.findIndex(one => Math.abs(one - t) < 2e-3)); }
act("whole:click"); out.hidden.push(whole.hidden); out.again = curves().length;
boxes[1].checked = false; act("b:change"); out.fewer = curves().length;
boxes[3].checked = true; act("minus:change"); act("svg:pointermove", at(200)); out.minus = said.textContent;
console.log(JSON.stringify(out));
"""


def test_a_figure_that_fails_leaves_the_rest_of_the_page(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("of a bug")

    write_table(folder / "next_command.csv", {"time": np.arange(5.0), "u": np.ones(5)})
    assert len(Page(draw_report(folder).read_text(encoding="utf-8")).images) == 1
    monkeypatch.setattr(figures, "commands", fails)
    page = Page(draw_report(folder).read_text(encoding="utf-8"))
    assert capsys.readouterr().err.splitlines() == ["no next-command.png: ZeroDivisionError: of a bug"]
    assert "Next experiment Drive knee0 at twice the speed" in page.text
    assert not page.images


class Nesting(html.parser.HTMLParser):
    """Checks that every element that is opened is closed, in order."""

    EMPTY = frozenset({"meta", "img", "input", "br", "link"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.feed(text)
        assert not self.stack

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.EMPTY:
            self.stack.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop() == tag


def test_the_page_is_well_formed(folder: Path) -> None:
    Nesting(draw_report(folder).read_text(encoding="utf-8"))


def test_one_more_effect_has_candidates_of_its_own(folder: Path) -> None:
    second = {"effect": "payload", "location": "body:torso", "parameters": {"mass": {"value": 2.0, "unit": "kg"}}}
    row = {"effect": "payload", "location": "body:torso", "score": 900.0, "beside": ["load_friction@joint:knee0"]}
    changed = {"effects": [*RESULT["effects"], second], "ranking": [*RESULT["ranking"], row]}
    write_json(folder / "result.json", RESULT | changed)
    page = Page(draw_report(folder).read_text(encoding="utf-8"))
    table = page.text[page.text.index("Candidates") :]
    assert "a payload body torso 111 named load-dependent gear friction at joint knee0" in table


@pytest.mark.parametrize(("score", "said"), [(900.0, True), (700.0, False)])
def test_the_caption_explains_candidates_that_score_more_than_the_name(folder: Path, score: float, said: bool) -> None:
    row = {"effect": "link_length", "location": "body:thigh0", "score": score, "margin": 812.0 - score}
    ranking = [RESULT["ranking"][0], row, *RESULT["ranking"][1:]]
    write_json(folder / "result.json", RESULT | {"ranking": ranking})
    text = Page(draw_report(folder).read_text(encoding="utf-8")).text
    assert ("What scores more than the name" in text) is said


def test_candidates_that_are_not_ruled_out_are_listed(folder: Path) -> None:
    none = RESULT | {
        "verdict": "none",
        "effects": [],
        "equivalent": [{"effect": "link_length", "location": "body:shin2"}],
    }
    text = verdict_sentence(none | {"misfit": none["misfit"] | {"noise_reached": True}})
    assert text.startswith("Nothing need be missing")
    assert text.endswith("Another length of the link at body shin2 is not ruled out.")
    assert "explains more than chance, but small errors of calibration explain" in " ".join(detail_sentences(none))
    write_json(folder / "result.json", none)
    page = Page(draw_report(folder).read_text(encoding="utf-8")).text
    assert f"Not ruled out, though {REASON_NOT_NAMED}:" in page
    assert "These data cannot distinguish" not in page
    assert f"Alike: {REASON_NOT_NAMED}." in page


def test_a_folder_of_an_earlier_version(folder: Path) -> None:
    write_json(folder / "result.json", {key: value for key, value in RESULT.items() if key != "misfit"})
    with pytest.raises(InputError, match="earlier version; diagnose again"):
        draw_report(folder)


def test_a_folder_without_a_diagnosis(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"result\.json"):
        draw_report(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main([str(tmp_path)])
    assert stopped.value.code == 2


def test_candidates_are_listed_with_their_distance_to_the_first(folder: Path) -> None:
    more = [{"effect": "air_drag", "location": "world", "score": -k, "margin": 812.0 + k} for k in range(4, 30)]
    write_json(folder / "result.json", RESULT | {"ranking": [*RESULT["ranking"], *more]})
    text = Page(draw_report(folder).read_text(encoding="utf-8")).text
    friction = "load-dependent gear friction"
    assert f"{friction} joint knee0 100 named {friction} every joint from body thigh0 down 98.5 alike" in text
    assert "dry friction joint knee0 49.5" in text
    assert "held-out gain" not in text
    first, rest = text[text.index("Candidates") :].split("More candidates")
    assert (first.count("air drag the world"), rest.count("air drag the world")) == (10, 16)


def test_a_candidate_without_a_number_has_an_empty_cell(folder: Path) -> None:
    first, *others = RESULT["ranking"]
    ranking = [first | {"held_out": 3.5}, *(row | {"held_out": "NaN"} for row in others)]
    write_json(folder / "result.json", RESULT | {"ranking": ranking})
    text = Page(draw_report(folder).read_text(encoding="utf-8")).text
    assert "held-out gain" in text
    assert "joint knee0 100 0.431 named" in text
    assert "NaN" not in text[text.index("Candidates") : text.index("The mended model")]


def test_the_first_page_says_what_is_odd_about_the_data(folder: Path) -> None:
    assert "What is odd about the data" not in Page(draw_report(folder).read_text(encoding="utf-8")).text
    rows = [
        {"level": "warning", "topic": "gaps", "message": "r1: 2 gaps <long>", "remedy": "", "evidence": "{}"},
        {"level": "note", "topic": "sampling", "message": "250.0 samples per second", "remedy": "", "evidence": "{}"},
    ]
    write_table(folder / "preflight.csv", rows)
    text = Page(draw_report(folder).read_text(encoding="utf-8")).text
    assert text.index("What is odd about the data r1: 2 gaps <long>") < text.index("Where simulation")
    assert "All that was looked at 250.0 samples per second" in text
    write_table(folder / "preflight.csv", rows[1:])
    assert "Nothing that matters was found" in Page(draw_report(folder).read_text(encoding="utf-8")).text
