"""What pages say can be typed: commands parse, code runs, files and links are there."""

import contextlib
import os
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tyro

from btr_mjx import coevolve
from btr_mjx.backtoreality import ScanConfig
from btr_mjx.diagnose import DiagnoseConfig, check_diagnosis
from btr_mjx.doctor import DoctorConfig
from btr_mjx.errors import InputError
from btr_mjx.replay import ReplayConfig
from btr_mjx.report import ReportConfig
from btr_mjx.robots import Robot

ROOT = Path(__file__).parents[2]
PAGES = {"README.md": (8, 4), "docs/coevolution.md": (8, 4), "docs/changes.md": (2, 1)}
"""Pages, and how many commands and links there are at least."""
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
INLINE = re.compile(r"`((?:uv|python|pip) [^`]*)`")
UV = (
    "pip install uv",
    "uv build",
    "uv pip install /path/to/this/checkout",
    "uv run pytest",
    "uv run --group docs mkdocs serve",
)
"""Commands of uv itself."""


def of(config: type) -> Callable[[list[str]], Any]:
    return lambda argv: tyro.cli(config, args=argv)


PARSERS: dict[str, Callable[[list[str]], Any]] = {
    "coevolve": coevolve.parse,
    "scan": of(ScanConfig),
    "diagnose": of(DiagnoseConfig),
    "replay": of(ReplayConfig),
    "doctor": of(DoctorConfig),
    "report": of(ReportConfig),
}


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def commands(page: str) -> list[str]:
    """All commands of a page, without comments, one a line."""
    blocks = [code for language, code in FENCE.findall(text_of(page)) if language == ""]
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    found = [re.sub(r"\s+#.*", "", line).strip() for line in lines]
    found += [code.replace("\n", " ") for code in INLINE.findall(FENCE.sub("", text_of(page)))]
    return [part.strip() for line in found if line for part in line.split("&&")]


def words_after(command: str, *head: str) -> list[str]:
    words = shlex.split(command)
    assert tuple(words[: len(head)]) == head, command
    return words[len(head) :]


@pytest.mark.parametrize("page", PAGES)
def test_commands_parse(page: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    seen = commands(page)
    assert len(seen) > PAGES[page][0]
    for command in seen:
        if command in UV:
            continue
        program, *argv = words_after(command, "uv", "run", "python")
        if program == "-m":
            name, argv = argv[0].removeprefix("btr_mjx."), argv[1:]
            config = PARSERS[name](argv)  # a wrong flag exits
            if name == "diagnose" and config.demo:
                check_diagnosis(config)
        else:
            assert (ROOT / program).is_file(), command
            monkeypatch.setattr(sys, "argv", [program, "--help"])
            with contextlib.suppress(SystemExit):
                runpy.run_path(str(ROOT / program), run_name="__main__")
            help_text = capsys.readouterr().out
            assert help_text, command
            for flag in (word for word in argv if word.startswith("--")):
                assert flag in help_text, f"{program} has no {flag}"
        for word in argv:
            if word.split("/")[0] in ("examples", "experiments", "benchmarks", "assets"):
                assert (ROOT / word).exists(), command


def test_a_wrong_flag_would_be_found() -> None:
    with pytest.raises(SystemExit):
        PARSERS["replay"](["runs/quick", "--with", "240"])
    with pytest.raises(InputError, match="--preset"):
        PARSERS["coevolve"](["--presets", "paper"])


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_are_there(page: str) -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", text_of(page))
    assert len(links) > PAGES[page][1]
    for link in links:
        if not link.startswith("http"):
            assert (ROOT / page).parent.joinpath(link.partition("#")[0]).is_file(), link


def test_the_page_of_the_project_is_short_and_its_picture_light() -> None:
    assert len(text_of("README.md").splitlines()) <= 120
    assert (ROOT / "docs/images/coevolution.gif").stat().st_size < 2_000_000


def test_names_in_the_notebook_recipe_exist() -> None:
    import btr_mjx

    (code,) = (code for language, code in FENCE.findall(text_of("README.md")) if language == "python")
    compile(code, "README.md", "exec")
    for name in {*re.findall(r"btr\.([\w.]+)", code)} - {"scan.along"}:
        found: Any = btr_mjx
        for part in name.split("."):
            found = getattr(found, part)
    assert isinstance(btr_mjx.hexapod(), Robot)


@pytest.mark.slow
def test_the_notebook_recipe_runs(tmp_path: Path) -> None:
    (code,) = (code for language, code in FENCE.findall(text_of("README.md")) if language == "python")
    (tmp_path / "recipe.py").write_text(f"{code}\nprint(curve.shape, int(np.argmin(curve)), len(plt.gca().lines))\n")
    environment = os.environ | {"MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, "recipe.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=900,
    )
    assert done.stdout.split("\n")[-2] == "(49,) 48 1"  # least at the last point, 1.6


@pytest.mark.slow
def test_the_quick_commands_run(tmp_path: Path) -> None:
    """The recipe of a diagnosis, as it stands, and what draws the picture of a run."""
    ran = [line for line in commands("README.md") if re.search(r"diagnose .*runs/|replay runs/robot|doctor$", line)]
    assert len(ran) == 5
    for command in sorted(ran, key=lambda line: "replay" in line):
        argv = words_after(command, "uv", "run", "python")
        done = subprocess.run([sys.executable, *argv], cwd=tmp_path, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0 or ("doctor" in command and done.returncode == 1), done.stderr
    assert (tmp_path / "runs/robot/report.html").read_text().count("data:image/gif") == 1
