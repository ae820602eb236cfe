"""The paired comparison of two versions of the search: its test, its digests and its cache."""

import itertools
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hidden_cases import Truth
from scipy.stats import binom

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    import naming_gate

    return naming_gate


def answer(kind: str | None = None, **more: Any) -> dict[str, Any]:
    named = {"effect": kind, "location": "joint:servo", "score": 80.0, "parameters": {}}
    number = {"value": 0.1, "low": 0.05, "high": 0.15, "null": 0.0}
    named["parameters"] = {"torque" if kind == "dry_friction" else "damping": number}
    gap = {"before": 3.0, "after": 1.5, "nulls": 1.0, "closed": 0.75}
    said = {"verdict": "effect" if kind else "none", "effects": [named] if kind else [], "equivalent": [], "gap": gap}
    return said | {"best_score": 5.0, "margin": 30.0, "steps": 1e5, "seconds": 9.0, "cpu_seconds": 8.0} | more


@pytest.fixture
def cases(gate: ModuleType, tmp_path: Path) -> Any:
    """Config of four invented cases with answers: an effect, a weak effect, a null, one outside the library."""
    config = gate.Config(cases=4, robot="pendulum", workers=1, out=tmp_path / "cache")
    effect = ({"effect": "viscous_damping", "location": "joint:servo", "parameters": {"damping": 0.1}},)
    hidden = [("effect", effect, ""), ("effect", effect, ""), ("none", (), ""), ("unexplained", (), "spring at servo")]
    for files, (verdict, effects, outside), gain in zip(files_of(gate, config), hidden, (90.0, 9.0, 0, 0), strict=True):
        files.data.mkdir(parents=True)
        (files.data / "recording").write_bytes(bytes([files.index]))
        gate.write_json(files.truth, Truth("pendulum", 1, verdict, effects, outside, 400, 1.0, 500.0))
        gate.write_json(files.oracle, {"gains": [gain] * len(effects), "scores": [gain] * len(effects)})
        put(gate, files, answer())
    return config


def files_of(gate: ModuleType, config: Any, code: str | None = None) -> list[Any]:
    return [gate.Files(config.out, index, "pendulum-2026", code or gate.CODE) for index in range(config.cases)]


def put(gate: ModuleType, files: Any, said: dict[str, Any]) -> None:
    gate.write_json(files.answer, said | {"data": gate.data_digest(files.data)})


def test_mcnemar_by_hand(gate: ModuleType) -> None:
    before = [True] * 9 + [False] * 10
    after = [True] * 7 + [False] * 2 + [True] * 7 + [False] * 3
    test = gate.mcnemar(before, after)
    assert {key: test[key] for key in ("both", "only_before", "only_after", "neither")} == {
        "both": 7,
        "only_before": 2,
        "only_after": 7,
        "neither": 3,
    }
    assert test["p"] == pytest.approx(2 * (1 + 9 + 36) / 2**9)


def test_mcnemar_against_the_binomial_distribution(gate: ModuleType) -> None:
    for lost, won in itertools.product(range(6), repeat=2):
        p = gate.mcnemar([True] * lost + [False] * won, [False] * lost + [True] * won)["p"]
        expected = min(1.0, 2 * binom.cdf(min(lost, won), lost + won, 0.5))
        assert p == pytest.approx(expected)
        assert p == gate.mcnemar([False] * lost + [True] * won, [True] * lost + [False] * won)["p"]


def test_code_digest(gate: ModuleType, tmp_path: Path) -> None:
    package = tmp_path / "package"
    rooms = ("plotting/draw.py", "gap/report/page.py", "demo/cases.py", "diagnose.py")
    others = ("gap/inference/search.py", "runs/files.py", "errors.py")
    for name in (*rooms, *others):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text("x = 1\n")
    first = gate.code_digest(package)
    assert len(first) == 12
    for name in rooms:
        (package / name).write_text("x = 2\n")
    (package / "gap" / "inference" / "notes.txt").write_text("no code")
    assert gate.code_digest(package) == first
    digests = {first}
    for name in others:
        (package / name).write_text("x = 2\n")
        digests.add(gate.code_digest(package))
    (package / "runs" / "files.py").rename(package / "runs" / "file.py")
    digests.add(gate.code_digest(package))
    assert len(digests) == len(others) + 2


def test_code_digest_covers_what_a_search_imports(gate: ModuleType) -> None:
    rooms = ("data", "effects", "inference", "results")
    lines = [*(f"import btr_mjx.gap.{room}" for room in rooms), "print(*(m for m in sys.modules if 'btr_mjx' in m))"]
    done = subprocess.run([sys.executable, "-c", "import sys\n" + "\n".join(lines)], capture_output=True, check=True)
    loaded = [Path(*module.split(".")[1:]) for module in done.stdout.decode().split()]
    assert Path("gap/inference") in loaded
    assert not [module for module in loaded for room in gate.ROOMS_OUTSIDE_SEARCH if module.is_relative_to(room)]
    top = {module.name for module in loaded if len(module.parts) == 1}
    assert top <= {"errors", "exports", "gap", "models", "robots", "runs"}  # no command


def test_unchanged_answers_are_not_computed_again(
    gate: ModuleType, cases: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def scheduled(missing: list[Any], make: Any, work: Any, workers: int, failed: Path) -> Any:
        for files in missing:
            asked.append(files.name)
            put(gate, files, answer("dry_friction"))
            yield files.index

    monkeypatch.setattr(gate.case_runs, "scheduled", scheduled)
    assert gate.gate(cases)["versions"][0]["numbers"]["cases"] == 4
    assert asked == []
    files_of(gate, cases)[2].answer.unlink()
    gate.write_json(files_of(gate, cases)[3].answer, answer(data="of other recordings"))
    report = gate.gate(cases)
    assert asked == ["pendulum-2026-0002", "pendulum-2026-0003"]
    assert report["versions"][0]["numbers"]["nulls_named"] == 1.0
    assert report["failed"] == []


@pytest.mark.parametrize(
    ("name", "prefix", "count"),
    [
        ("hexapod", "hexapod-2026", 40),
        ("hexapod-pairs", "hexapod-2026-pairs", 12),
        ("quadruped", "quadruped-2026", 20),
        ("arm", "arm-2026", 20),
        ("pendulum", "pendulum-2026", 20),
    ],
)
def test_baselines_answer_the_fixed_cases(gate: ModuleType, name: str, prefix: str, count: int) -> None:
    file = Path(gate.__file__).parent / "baselines" / f"naming_gate-0.1.0-{name}.json"
    _, saved = gate.earlier(gate.Config(against=str(file)))
    assert sorted(saved) == [f"{prefix}-{index:04d}" for index in range(count)]
    assert {answer["verdict"] for answer in saved.values()} <= {"effect", "none", "unexplained"}


def test_versions_are_compared_by_case(
    gate: ModuleType, cases: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = "0123456789ab"
    before = [answer("viscous_damping"), answer("dry_friction"), answer("dry_friction"), answer()]
    for files, said in zip(files_of(gate, cases, code), before, strict=True):
        put(gate, files, said)
    report = gate.gate(replace(cases, against=code))
    effects, everything = report["paired"]["tests"].values()
    assert [effects[key] for key in ("both", "only_before", "only_after", "neither")] == [0, 1, 0, 0]
    assert [everything[key] for key in ("both", "only_before", "only_after", "neither")] == [0, 1, 1, 1]
    assert [version["code"] for version in report["versions"]] == [code, gate.CODE]
    hidden = "hidden viscous_damping@joint:servo"
    assert report["paired"]["changed"] == [
        f"pendulum-2026-0000, {hidden} (gain 90): viscous_damping@joint:servo (right) -> none (wrong)",
        f"pendulum-2026-0001, {hidden} (gain 9): dry_friction@joint:servo -> none",
        "pendulum-2026-0002, hidden - (gain 0): dry_friction@joint:servo (wrong) -> none (right)",
    ]
    gate.show(report)
    table = capsys.readouterr().out.splitlines()
    assert " ".join(table[2].split()) == "detectable effects right 1 of 1 0 of 1"
    assert " ".join(table[5].split()) == "numbers within intervals 1 of 1 0 of 0"
    assert " ".join(table[6].split()) == "nulls named 1 of 1 0 of 1"
    # An earlier version with fewer answers, from a file: both are compared on the cases that both answered.
    path = tmp_path / "before.json"
    saved = {files.name: json.loads(files.answer.read_text()) for files in files_of(gate, cases, code)[:2]}
    path.write_text(json.dumps({"code": code, "answers": saved}))
    report = gate.gate(replace(cases, against=str(path)))
    assert [version["numbers"]["cases"] for version in report["versions"]] == [2, 2]
    assert len(report["answers"]) == 4
    path.write_text(json.dumps({"code": code, "answers": {}}))
    with pytest.raises(gate.InputError, match="no answers to these 4 cases"):
        gate.gate(replace(cases, against=str(path)))


def test_a_change_of_the_code_during_the_start_is_refused(gate: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(gate.InputError, match="changed from 0123456789ab"):
        gate.work(gate.Files(tmp_path, 0, "pendulum-2026", "0123456789ab"))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cases": 0}, "--cases: got 0, expected at least 1"),
        ({"duration": -1.0}, "--duration: got -1.0"),
        ({"against": "0123456789ab"}, "has answers of no version"),
        ({"against": str(FOLDER / "naming_gate.py")}, "not valid JSON"),
    ],
)
def test_bad_settings(gate: ModuleType, tmp_path: Path, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(gate.InputError, match=message):
        gate.gate(gate.Config(out=tmp_path, **settings))


@pytest.mark.slow
def test_end_to_end(gate: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A short case is made and solved, and then read from the cache."""
    config = gate.Config(robot="pendulum", cases=1, duration=0.5, workers=1, out=tmp_path)
    report = gate.gate(config)
    assert "1/1" in capsys.readouterr().err
    assert report["failed"] == []
    (saved,) = report["answers"].values()
    assert saved["cpu_seconds"] > 0
    (file,) = (tmp_path / "answers" / gate.CODE).iterdir()
    content = file.read_bytes()
    again = gate.gate(replace(config, against=gate.CODE))
    assert again["answers"] == report["answers"]
    assert again["paired"]["changed"] == []
    assert capsys.readouterr().err == ""
    assert file.read_bytes() == content


def test_bad_input_is_one_line(
    gate: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["naming_gate.py", "--against=nothing.json"])
    with pytest.raises(SystemExit) as exit_code:
        gate.main()
    assert exit_code.value.code == 2
    assert capsys.readouterr().err == "error: nothing.json: No such file or directory\n"
