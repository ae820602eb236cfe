"""Pages in a browser: light and dark, wide and narrow, without errors, sorted by a click."""

import json
import os
import re
import shutil
import subprocess
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from claims_page import claims_sentence, draw_claims_page
from failing_pages import SAID, failing_page

from btr_mjx import coevolve, report, scan
from btr_mjx.backtoreality import bound_words, prediction_errors, summary_table
from btr_mjx.errors import InputError
from btr_mjx.gap.results import format_number, verdict_sentence
from btr_mjx.pages import Section, Table, write_page
from btr_mjx.pages.coevolution_page import coevolution_sentence
from btr_mjx.pages.page import sentences
from btr_mjx.pages.page_content import cell_text, flat_rows
from btr_mjx.pages.scan_page import scan_sentence
from btr_mjx.plotting import ScanData, kind_of_run, read_run, robot_figure
from btr_mjx.runs import read_json, write_arrays, write_json

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
WIDTHS = (1200, 400)
"""Of the page, on a desk and on a phone [pixels]."""
browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: pages are not opened")

PROBE = """<script>
window.faults = [];
addEventListener("error", event => faults.push(String(event.message)));
addEventListener("load", () => {
  const tables = [...document.querySelectorAll("table.sortable")].map(table => {
    const read = column => [...table.tBodies[0].rows].map(row => row.cells[column].textContent.trim());
    const before = read(0).length, columns = [];
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = head.querySelector("button");
      if (!button) return;
      button.click();
      const up = read(column), upward = head.getAttribute("aria-sort");
      button.click();
      columns.push({up, upward, down: read(column), downward: head.getAttribute("aria-sort")});
    });
    return {before, columns};
  });
  document.querySelectorAll("details").forEach(one => one.open = true);
  const style = getComputedStyle(document.body);
  parent.postMessage(JSON.stringify({
    faults, tables, width: innerWidth, needed: document.documentElement.scrollWidth,
    ink: style.color, paper: style.backgroundColor,
    images: [...document.images].map(image => image.naturalWidth),
    plots: [...document.querySelectorAll("img.plot")].map(image => image.clientWidth),
    ticks: [...document.querySelectorAll(".curves svg")].map(
      svg => [...svg.querySelectorAll("text")].filter(one => !one.textContent.endsWith("s")).length),
  }), "*");
});
</script>"""


@pytest.fixture(autouse=True)
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    grey = lambda motions, width, height, camera: [np.full((1, height, width, 3), 99, np.uint8)] * len(motions)  # noqa: E731
    monkeypatch.setattr(robot_figure, "render", grey)


def opened(page: Path, folder: Path, dark: bool) -> dict[int, dict]:
    """What a browser says about a page by its width, in frames: windows cannot be as narrow as a phone."""
    assert CHROMIUM is not None
    text = page.read_text(encoding="utf-8").replace("<head>", "<head>" + PROBE, 1)
    (folder / "page.html").write_text(text, encoding="utf-8")
    (folder / "frame.html").write_text(
        "".join(f'<iframe src="page.html" style="width:{w}px;height:900px;border:0"></iframe>' for w in WIDTHS)
        + '<pre id="said"></pre><script>const said = [], place = document.getElementById("said");'
        'addEventListener("message", event => { said.push(event.data); place.textContent = `[${said}]`; })</script>',
        encoding="utf-8",
    )
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    done = subprocess.run(
        [
            *(CHROMIUM, "--headless", "--disable-gpu", *sandbox, f"--user-data-dir={folder / 'profile'}"),
            *("--window-size=1300,1000", f"--blink-settings=preferredColorScheme={0 if dark else 1}"),
            *("--virtual-time-budget=10000", "--dump-dom", (folder / "frame.html").as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    said = re.search(r'<pre id="said">(.*?)</pre>', done.stdout, re.S)
    assert said is not None
    assert said[1], "the page sent nothing: its script failed"
    every = json.loads(said[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    return {one["width"]: one for one in every}


def make_coevolution(folder: Path) -> Path:
    flags = "--engine=native --duration=0.05 --controllers=8 --controller-generations=2 --trials=3 --simulations=6"
    coevolve.main([*flags.split(), "--simulation-generations=2", "--no-progress", f"--out={folder}"])
    return folder


def make_scan(folder: Path) -> Path:
    flags = "--engine=native --duration=0.05 --grid=4 --trials=3 --behaviours=random --no-progress"
    scan.main([*flags.split(), f"--out={folder}"])
    return folder


def make_diagnosis(folder: Path) -> Path:
    folder.mkdir()
    effect = {"effect": "payload", "location": "body:torso", "parameters": {"mass": {"value": 2.0, "unit": "kg"}}}
    rows = [
        {"effect": "payload", "location": f"body:{n}", "score": s, "margin": 9.0 - s, "held_out": 1.0}
        for n, s in (("torso", 9.0), ("leg", -3.5), ("arm", 1e-7))
    ]
    result = {"verdict": "effect", "dataset": "d", "where": "joint knee", "effects": [effect], "ranking": rows}
    result["misfit"] = None
    result |= {"believed": [{"name": n, "before": v} for n, v in (("a", -0.5), ("b", 10.0), ("c", 2.0))]}
    write_json(folder / "result.json", result | {"sentence": verdict_sentence(result)})
    ends = np.radians([(-36, 49), (0, 1.01), (19.9, 81), (-1e-3, 9e3)])
    arrays = {
        key: np.array([text] * len(ends)) for key, text in (("recordings", "r"), ("names", "j"), ("units", "rad"))
    }
    for n, (low, high) in enumerate(ends):
        arrays |= {f"{key}_{n}": np.linspace(low, high, 9) for key in ("measured", "before", "after")}
        arrays[f"time_{n}"] = np.linspace(3.51, 4.01, 9)
    write_arrays(folder / "overlays.npz", arrays)
    report.report(folder)
    return folder


MAKERS: dict[str, Callable[[Path], Path]] = {
    "coevolve": make_coevolution,
    "scan": make_scan,
    "diagnose": make_diagnosis,
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    made: dict[str, Path] = {}

    def folder(kind: str) -> Path:
        if kind not in made:
            made[kind] = MAKERS[kind](tmp_path_factory.mktemp("runs") / kind)
        return made[kind]

    return folder


def as_number(text: str) -> float | None:
    plain = text.replace("\N{MINUS SIGN}", "-").replace("·10^", "e")
    found = re.match(r"(-?\d+\.?\d*(?:e-?\d+)?)(?: |$)", plain)
    return float(found[1]) if found else None


@browser
@pytest.mark.parametrize("kind", list(MAKERS))
def test_pages_in_a_browser(folders: Callable[[str], Path], kind: str, tmp_path: Path) -> None:
    page = folders(kind) / "report.html"
    assert kind_of_run(folders(kind)) == kind
    looks = set()
    for dark in (False, True):
        frames = opened(page, tmp_path, dark)
        assert set(frames) == set(WIDTHS)
        for width, said in frames.items():
            assert said["faults"] == []
            assert said["needed"] <= width  # no scrolling sideways
            assert all(said["images"])
            assert min(said["plots"], default=width) >= 400  # smaller, their words are not legible
            assert len(said["ticks"]) == (4 if kind == "diagnose" else 0)
            assert all(3 <= count <= 9 for count in said["ticks"])
            light = [sum(map(int, re.findall(r"\d+", said[key])[:3])) for key in ("ink", "paper")]
            assert (light[0] > light[1]) is dark
            assert abs(light[0] - light[1]) > 400
            looks.add((said["ink"], said["paper"]))
    assert len(looks) == 2
    sorted_columns = 0
    for table in said["tables"]:
        for column in table["columns"]:
            assert (column["upward"], column["downward"]) == ("ascending", "descending")
            assert sorted(column["up"]) == sorted(column["down"])  # no row is lost
            assert len(column["up"]) == table["before"]
            numbers = [as_number(text) for text in column["up"]]
            if None not in numbers:
                assert numbers == sorted(numbers)
                assert [as_number(text) for text in column["down"]] == sorted(numbers, reverse=True)
                sorted_columns += len(set(numbers)) > 1
    assert sorted_columns > 0


@pytest.mark.parametrize("kind", list(MAKERS))
def test_pages_need_no_other_file_and_are_reproducible(folders: Callable[[str], Path], kind: str) -> None:
    page = folders(kind) / "report.html"
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)[^"]*"', text)
    assert report.report(folders(kind)) == page
    assert page.read_text(encoding="utf-8") == text


def test_a_film_in_the_folder_is_in_the_page(folders: Callable[[str], Path], tmp_path: Path) -> None:
    folder = shutil.copytree(folders("coevolve"), tmp_path / "copy")
    (folder / "replay.gif").write_bytes(b"GIF89a")
    assert "data:image/gif;base64,R0lGODlh" in report.report(folder).read_text()
    (folder / "replay.gif").rename(folder / "replay.mp4")
    assert "<video" in report.report(folder).read_text()


def test_the_verdict_of_a_coevolution(folders: Callable[[str], Path]) -> None:
    folder = folders("coevolve")
    run, result = read_run(folder), read_json(folder / "result.json")
    text = coevolution_sentence(run)
    assert len(sentences(text)) <= 2
    trials = run.trials
    errors = [np.abs(trials["f_s"] - trials["f_r"])[trials["iteration"] == k].mean() for k in (1, 2, 3)]
    np.testing.assert_allclose(prediction_errors(*(trials[name] for name in ("f_s", "f_r", "iteration"))), errors)
    assert result["prediction_error_first"] == pytest.approx(errors[0])
    assert result["prediction_error_last"] == pytest.approx(errors[2])
    assert text.startswith(f"With {result['reality_evaluations']} trials in reality, the mean error of the predicted")
    assert ("falls from" in text) is bool(errors[2] < errors[0])
    everything = replace(run, result=result | {"told": result["told"] | {"told": ["bl_5", "bl_14"]}})
    said = f"bl_14 goes from 1.36 to {format_number(result['simulation']['bl_14'])} m (truth: 1.6 m)."
    assert said in coevolution_sentence(everything)
    assert f"{format_number(result['f_s_best'])} m/s were predicted" in text
    run.trials["f_s"][trials["iteration"] == 3] += 10.0
    assert "does not fall: it goes from" in coevolution_sentence(run)


def test_the_verdict_of_many_parameters_is_in_percent_of_their_ranges(folders: Callable[[str], Path]) -> None:
    """Metres and kilograms have no mean."""
    run = read_run(folders("coevolve"))
    names, high, units = ["a", "b", "c", "d"], [1.0, 100.0, 10.0, 2.0], ["m", "kg", "m", "s"]
    truth = {name: 0.5 * end for name, end in zip(names, high, strict=True)}
    result = run.result | {
        "space": {n: {"low": 0.0, "high": h, "unit": u} for n, h, u in zip(names, high, units, strict=True)},
        "start": dict.fromkeys(names, 0.0),
        "simulation": {name: 0.9 * value for name, value in truth.items()},
        "truth": truth,
        "told": {"told": names},
    }
    text = coevolution_sentence(replace(run, result=result))
    assert "4 parameters are told, the mean error of 4 of them goes from 50 % to 5 % of their ranges." in text


def test_the_table_says_what_is_not_told(folders: Callable[[str], Path]) -> None:
    result = read_json(folders("coevolve") / "result.json")
    told = {
        "intervals": {"bl_5": [0.4, 1.6], "bl_14": [1.5, 1.6]},
        "told": ["bl_14"],
        "combinations": ["only a is told"],
    }
    text = summary_table(result | {"told": told}, Path("run"))
    (row,) = [line for line in text.splitlines() if line.startswith("bl_5")]
    assert " 0.4        1.6 " in row
    assert row.endswith("not told by these trials")
    assert "only a is told" in text.splitlines()
    (row,) = [line for line in text.splitlines() if line.startswith("bl_14")]
    assert "not told" not in row


def test_values_at_a_bound_are_marked() -> None:
    words = [bound_words(value, 0.4, 1.6) for value in (0.4, 0.41, 1.0, 1.6)]
    assert words == ["at its lower bound", "", "", "at its upper bound"]


def test_the_verdict_of_a_scan_knows_its_grid() -> None:
    grid = np.linspace(0.4, 1.6, 49)
    delta = np.abs(grid - 0.88)[:, None] * np.ones(3)
    numbers = {"spearman": 0.9, "spearman_left": 0.97, "spearman_right": 0.99}
    data = ScanData("bl_5", "m", "m/s", grid, 0.88, delta, delta[:, 0], numbers)
    text = scan_sentence(data, (0.875, 0.875, 0.875))
    assert "least at bl_5 = 0.875 m; the truth is 0.88 m, and this is the nearest point of the grid, whose" in text
    assert "spacing is 0.025 m. " in text
    assert text.endswith("rank correlation of 0.97 below and 0.99 above the truth.")
    text = scan_sentence(replace(data, truth=1.6, result={"spearman": 0.9, "spearman_left": 0.9}), (1.6, 1.575, 1.6))
    assert "least at bl_5 = 1.6 [1.57, 1.6] m; the truth is 1.6 m. It orders" in text
    assert text.endswith("correlation of 0.9.")


def test_the_sentence_of_claims_counts() -> None:
    rows = [{"verdict": word} for word in ("holds", "holds", "does not", "undecided")]
    assert claims_sentence(rows) == "2 of 4 claims hold, 1 does not, 1 is undecided."
    assert claims_sentence(rows[:2]) == "2 of 2 claims hold."


def test_small_numbers_are_printed_with_their_digits(folders: Callable[[str], Path]) -> None:
    result = read_json(folders("coevolve") / "result.json")
    small = {"lp": 1.23e-4, "prediction_error_last": 2.5e-4, "f_r_best": 3.4e-5, "delta_fitness_last": 1.1e-4}
    text = summary_table(result | small, Path("runs/x"))
    for number in ("learning performance 0.000123,", " 0.00025", " 3.400·10^−5", ": 0.00011 [m/s]"):
        assert number in text


def test_the_page_of_claims(tmp_path: Path) -> None:
    gallery = Path(__file__).parents[2] / "docs" / "gallery"
    for name in ("claims.json", "claims.png", "fig2.png"):
        shutil.copyfile(gallery / name, tmp_path / name)
    text = draw_claims_page(tmp_path).read_text(encoding="utf-8")
    assert text.count("<img") == 2
    assert claims_sentence(read_json(tmp_path / "claims.json")) in text


def test_parts_of_a_page() -> None:
    assert cell_text(-2) == "\N{MINUS SIGN}2"
    assert cell_text(float("nan")) == "–"
    assert cell_text(True) == "yes"
    assert Table(["a", "b"], [["x", 1.0], ["y", None]]).numeric == [False, True]
    assert Table(["a"], []).numeric == [False]
    assert flat_rows({"a": {"b": 1, "c": None}, "d": [1, 2], "e": True}) == [["a.b", "1"], ["d", "1 2"], ["e", "true"]]
    text = "Gears slip (0.3 [0.2, 0.4] N m). Their friction is 1.5 times that. Runner-up: dry friction."
    assert sentences(text) == [text[:32], text[33:66], text[67:]]


def test_text_is_escaped(tmp_path: Path) -> None:
    parts = {"heading": "<h>", "name": "<n>", "sentence": "<b>1</b>", "numbers": [("<l>", "<v>")], "footer": ["<f>"]}
    parts["sections"] = [Section("<t>", ["<s>"])]
    text = write_page(tmp_path, parts).read_text()
    for tag in ("<h>", "<n>", "<b>", "<l>", "<v>", "<f>", "<t>", "<s>"):
        assert tag not in text
    assert Section("title").folded is False


def test_folders_without_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="--resume"):
        report.report(tmp_path)
    write_json(tmp_path / "result.json", [1])
    with pytest.raises(SystemExit) as stopped:
        report.main([str(tmp_path)])
    assert stopped.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize(("command", "said"), [(coevolve, "learning performance"), (scan, "spearman")])
def test_a_page_that_fails_is_one_line_after_the_result(
    command: types.ModuleType,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed: list[str] = []
    monkeypatch.setattr(command, "draw_run_page", failing_page(capsys, printed))
    (make_coevolution if command is coevolve else make_scan)(tmp_path / "run")
    assert said in printed[0]
    assert capsys.readouterr().err.splitlines()[-1] == SAID


def test_no_figures_skips_the_page(tmp_path: Path) -> None:
    flags = "--engine=native --duration=0.05 --grid=3 --trials=2 --behaviours=random --no-progress --no-figures"
    scan.main([*flags.split(), f"--out={tmp_path / 'scan'}"])
    assert not (tmp_path / "scan" / "report.html").exists()
