"""The gate: its cache, its processes, and how two versions are compared."""

import itertools
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import gate
import numpy as np
import pytest
import toy_gate
from gates import answers, suites
from gates.cases import Case, Suite
from gates.pairing import cpu_ratio, mcnemar, paired, show_pairs
from gates.rows import NO_ANSWER, Row, row_of
from scipy.stats import binom
from toy_gate import answer, named

from btr_mjx.errors import InputError
from btr_mjx.runs import read_json

BASELINE = Path(gate.__file__).parent / "baselines" / "gate-0.1.0.json"


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> gate.Config:
    """Settings of a gate on toy cases."""
    monkeypatch.setattr(gate, "SUITES", {"toy": toy_gate.TOY})
    return gate.Config(("toy",), workers=2, limit=30.0, out=tmp_path / "out", json=tmp_path / "now.json")


def switch(config: gate.Config, text: str) -> None:
    config.out.mkdir(exist_ok=True)
    (config.out / toy_gate.SWITCH).write_text(text)


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> object:
    """Exit code of the command."""
    monkeypatch.setattr(sys, "argv", ["gate.py", *map(str, words)])
    try:
        gate.main()
    except SystemExit as exit_code:
        return exit_code.code
    return 0


def test_mcnemar_by_hand() -> None:
    test = mcnemar([True] * 9 + [False] * 10, [True] * 7 + [False] * 2 + [True] * 7 + [False] * 3)
    assert (test.both, test.lost, test.won, test.neither) == (7, 2, 7, 3)
    assert test.p == pytest.approx(2 * (1 + 9 + 36) / 2**9)
    assert mcnemar([], []).p == 1.0


def test_mcnemar_against_the_binomial_distribution() -> None:
    for lost, won in itertools.product(range(6), repeat=2):
        p = mcnemar([True] * lost + [False] * won, [False] * lost + [True] * won).p
        assert p == pytest.approx(min(1.0, 2 * binom.cdf(min(lost, won), lost + won, 0.5)))
        assert p == mcnemar([False] * lost + [True] * won, [True] * lost + [False] * won).p


def test_ratio_of_cpu_time() -> None:
    ratio, error = cpu_ratio([1.0, 10.0, None, 5.0], [2.0, 5.0, 3.0, None])
    assert ratio == pytest.approx(1.0)
    assert error == pytest.approx(np.log(2))  # standard error of ln 2 and -ln 2
    assert cpu_ratio([2.0, 4.0], [3.0, 6.0]) == pytest.approx((1.5, 0.0))
    assert np.isnan(cpu_ratio([None], [1.0])).all()


def test_code_digest(tmp_path: Path) -> None:
    rooms = ("plotting/draw.py", "gap/report/page.py", "demo/cases.py", "diagnose.py")
    others = ("gap/inference/search.py", "gap/preflight/checks.py", "runs/files.py", "errors.py")
    for name in (*rooms, *others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\n")
    digests = {answers.code_digest(tmp_path)}
    for name in rooms:
        (tmp_path / name).write_text("x = 2\n")
    (tmp_path / "gap" / "inference" / "notes.txt").write_text("no code")
    assert digests == {answers.code_digest(tmp_path)}
    for name in others:
        (tmp_path / name).write_text("x = 2\n")
        digests.add(answers.code_digest(tmp_path))
    (tmp_path / "runs" / "files.py").rename(tmp_path / "runs" / "file.py")
    digests.add(answers.code_digest(tmp_path))
    assert len(digests) == len(others) + 2


def test_code_digest_covers_what_a_search_imports() -> None:
    rooms = ("data", "effects", "forces", "inference", "preflight", "results")
    lines = [*(f"import btr_mjx.gap.{room}" for room in rooms), "print(*(m for m in sys.modules if 'btr_mjx' in m))"]
    done = subprocess.run([sys.executable, "-c", "import sys\n" + "\n".join(lines)], capture_output=True, check=True)
    loaded = [Path(*module.split(".")[1:]) for module in done.stdout.decode().split()]
    assert Path("gap/inference") in loaded
    assert not [module for module in loaded for room in answers.ROOMS_OUTSIDE_SEARCH if module.is_relative_to(room)]
    top = {module.name for module in loaded if len(module.parts) == 1}
    assert top <= {"errors", "exports", "gap", "models", "robots", "runs"}  # no command


def test_answers_are_kept_and_belong_to_their_recordings(toy: gate.Config) -> None:
    rows = gate.gate(toy)
    assert [(row.case, row.right, row.is_null) for row in rows] == [
        ("toy-7-0000", True, True),
        ("toy-7-0001", True, False),
    ]
    files = sorted((toy.out / "answers" / answers.CODE).iterdir())
    assert [file.stem for file in files] == [row.case for row in rows]
    times = [file.stat().st_mtime_ns for file in files]
    assert gate.gate(toy) == rows
    assert [file.stat().st_mtime_ns for file in files] == times
    files[0].unlink()
    files[1].write_text(json.dumps(read_json(files[1]) | {"data": "of other recordings"}))
    assert gate.gate(toy) == rows
    assert all(file.stat().st_mtime_ns > old for file, old in zip(files, times, strict=True))


@pytest.mark.parametrize(
    ("fault", "limit", "message"),
    [
        ("crash", 30.0, "the process ended with 9"),
        ("hang", 4.0, "no end within 4 s"),
        ("raise", 30.0, "RuntimeError: the search broke"),
        ("unmade 1", 30.0, "RuntimeError: this case cannot be made"),
    ],
)
def test_a_case_that_fails_has_no_answer_and_is_tried_again(
    toy: gate.Config,
    fault: str,
    limit: float,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    switch(toy, fault)
    words = ("--suites", "toy", "--limit", limit, "--out", toy.out, "--json", toy.json)
    assert command(monkeypatch, *words) == 1
    told = capfd.readouterr()
    assert f"toy-7-0001: {message}" in told.err
    assert told.out.splitlines()[-1] == "no answer: toy-7-0001"
    rows = [Row.read(row) for row in read_json(toy.json)["rows"]]
    assert [(row.said, row.right) for row in rows] == [("none", True), (NO_ANSWER, False)]
    switch(toy, "")
    assert command(monkeypatch, *words) == 0
    assert [Row.read(row).right for row in read_json(toy.json)["rows"]] == [True] * 2


def test_versions_are_compared_by_case(
    toy: gate.Config, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code = "0123456789ab"
    switch(toy, "wrong")
    gate.gate(toy)
    before = tmp_path / "before.json"
    toy.json.rename(before)
    (toy.out / "answers" / answers.CODE).rename(toy.out / "answers" / code)
    switch(toy, "")
    monkeypatch.setattr(gate, "SUITES", {"toy": toy_gate.SLOW_TOY})
    words = ("--suites", "toy", "--out", toy.out)
    capsys.readouterr()
    assert command(monkeypatch, *words, "--json", toy.json, "--against", before) == 0
    table = capsys.readouterr().out.split("\n\n")
    line = " ".join(table[1].splitlines()[1].split())
    assert line == "toy 2 1 of 2 -> 2 of 2 0 1 1 1 -> 0 0 of 1 -> 0 of 1 1 of 2 -> 2 of 2 2.000 ± 0.000"
    assert table[2].splitlines() == [
        "changed answers: 1",
        "toy-7-0001, hidden spring@joint:knee: effect: damping@joint:knee (wrong) -> effect: spring@joint:knee (right)",
    ]
    # The same from the cache, and from two files.
    assert command(monkeypatch, *words, "--against", code) == 0
    assert capsys.readouterr().out.split("\n\n")[1:] == table[1:]
    assert command(monkeypatch, "--compare", before, toy.json) == 0
    assert capsys.readouterr().out.split("\n\n") == table[1:]
    # An earlier version with fewer answers: both are compared on the cases that both have.
    content = read_json(before)
    del content["answers"]["toy-7-0001"]
    before.write_text(json.dumps(content))
    assert command(monkeypatch, *words, "--against", before) == 0
    assert "changed answers: 0" in capsys.readouterr().out


def test_undetectable_cases_are_in_no_test_and_several_suites_are_summed(capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = answer(named("armature", "all")), answer()
    rows = {
        which: [
            Row(**vars(row_of(said, "armature@all", right)) | {"case": f"{suite}-1", "suite": suite})
            for suite, right in (("one", said is good), ("two", None))
        ]
        for which, said in (("before", bad), ("after", good))
    }
    show_pairs(paired(rows["before"], rows["after"]))
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[1].startswith("one 1 0 of 1 -> 1 of 1 0 1 1 ")
    assert lines[2].startswith("two 1 0 of 0 -> 0 of 0 0 0 1 ")
    assert lines[3].startswith("all 2 0 of 1 -> 1 of 1 0 1 1 ")
    assert "changed answers: 2" in lines
    with pytest.raises(InputError, match="no case in common"):
        paired(rows["before"], [])


def test_a_change_of_the_code_during_the_start_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="changed from 0123456789ab"):
        Case(toy_gate.TOY, 7, 0, tmp_path, "0123456789ab").solve()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--suites", "biped"), "--suites: there is no suite biped; known are hexapod, "),
        (("--cases", "0"), "--cases: got 0, expected at least 1"),
        (("--limit", "0"), "--limit: got 0, expected more than 0 s"),
        (("--against", "0123456789ab"), "has answers of no version"),
        (("--against", "nothing.json"), "nothing.json: No such file or directory"),
        (("--compare", gate.__file__, gate.__file__), "not valid JSON"),
        (("--compare", BASELINE, BASELINE), "expected a file written by --json"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[object, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert command(monkeypatch, "--out", tmp_path, *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert message in line


def test_baselines_answer_the_fixed_cases() -> None:
    saved = gate.saved(BASELINE, "answers")["answers"]
    counts = {"hexapod": 40, "pairs": 12, "quadruped": 20, "arm": 20, "pendulum": 20}
    assert set(saved) == {f"{name}-2026-{index:04d}" for name, count in counts.items() for index in range(count)}
    assert {answer["verdict"] for answer in saved.values()} <= {"effect", "none", "unexplained"}


@pytest.mark.slow
def test_a_pendulum_from_end_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A short case is made and solved, and then read from the cache."""
    make = partial(suites.make_hidden, "pendulum", duration=0.5)
    monkeypatch.setattr(
        gate, "SUITES", {"pendulum": Suite("pendulum", 1, 2026, make, suites.solve, suites.judge_hidden)}
    )
    words = ("--suites", "pendulum", "--out", tmp_path, "--json", tmp_path / "now.json")
    assert command(monkeypatch, *words) == 0
    assert "1/1" in capsys.readouterr().err
    content = read_json(tmp_path / "now.json")
    (row,) = content["rows"]
    assert row["cpu_seconds"] > 0
    assert row["sentence"]
    assert command(monkeypatch, *words, "--against", content["code"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert "changed answers: 0" in told.out
    assert read_json(tmp_path / "now.json")["answers"] == content["answers"]
