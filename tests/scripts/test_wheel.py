"""The wheel alone, installed in an empty environment, has all that the commands need."""

import json
import os
import subprocess
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TINY = (
    *("--iterations=1", "--trials=2", "--controllers=4", "--controller-generations=1", "--simulations=4"),
    *("--simulation-generations=1", "--duration=0.05", "--engine=native", "--no-progress"),
)


def run(*command: str | Path, folder: Path, timeout: float = 600) -> str:
    """Output of a command that succeeds, run in a folder without this checkout on its path."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def run_online(*command: str | Path, folder: Path) -> None:
    """Run a command of uv that may have to download; the test is skipped where the registry cannot be reached.

    Where the command fails, a question that only the registry can answer tells a missing network from a real fault.
    """
    try:
        run(*command, folder=folder)
    except AssertionError:
        question = ["uv", "pip", "compile", "--no-cache", "--quiet", "-"]
        asked = subprocess.run(question, input="hatchling", cwd=folder, capture_output=True, text=True, timeout=120)
        if asked.returncode:
            pytest.skip(f"the package registry cannot be reached: {asked.stderr.strip().splitlines()[-1]}")
        raise


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the source distribution and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("dist")
    run_online("uv", "build", "--quiet", "--out-dir", folder, folder=ROOT)
    return folder


@pytest.fixture(scope="module")
def scripts(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of executables of an environment that holds the wheel and its requirements only."""
    folder = tmp_path_factory.mktemp("environment")
    run_online("uv", "venv", "--quiet", "--python", "3.12", folder / "venv", folder=folder)
    (wheel,) = dist.glob("*.whl")
    run_online("uv", "pip", "install", "--quiet", "--python", folder / "venv" / "bin" / "python", wheel, folder=folder)
    return folder / "venv" / "bin"


def test_the_citation_names_this_version() -> None:
    assert f"version: {PROJECT['version']}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


@pytest.mark.slow
def test_files_of_the_distributions(dist: Path) -> None:
    (wheel,), (source,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if name.startswith("btr_mjx/")}
    files = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "btr_mjx").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assets = {f"btr_mjx/{path.relative_to(ROOT).as_posix()}" for path in (ROOT / "assets").iterdir()}
    assert packed == files | assets
    assert {"btr_mjx/py.typed", "btr_mjx/assets/hexapod.xml.j2", "btr_mjx/plotting/style.mplstyle"} <= packed
    with tarfile.open(source) as archive:
        top = {name.split("/")[1] for name in archive.getnames()}
    assert {"btr_mjx", "assets", "examples", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"} <= top
    assert top.isdisjoint({"tests", "benchmarks", "experiments", "uv.lock"})


@pytest.mark.slow
def test_commands_of_the_wheel(scripts: Path, tmp_path: Path) -> None:
    location = run(scripts / "python", "-c", "import btr_mjx; print(btr_mjx.__file__)", folder=tmp_path)
    assert location.startswith(str(scripts.parent))
    for script, target in PROJECT["scripts"].items():
        module = target.removesuffix(":main")
        assert script == module.replace("btr_mjx.", "btr-")
        by_name, by_module = (
            run(*command, "--help", folder=tmp_path)
            for command in ((scripts / script,), (scripts / "python", "-m", module))
        )
        assert by_name == by_module
        assert by_name.startswith(f"usage: {module}")
    run(scripts / "btr-coevolve", "--out=tiny", *TINY, folder=tmp_path)
    assert json.loads((tmp_path / "tiny" / "result.json").read_text())["reality_evaluations"] > 0
    assert (tmp_path / "tiny" / "robot.png").stat().st_size > 0
    report = json.loads(run(scripts / "btr-doctor", "--only", "versions", "runs", "--json", folder=tmp_path))
    assert report["ok"] is True


@pytest.mark.slow
def test_the_demo_of_the_wheel(scripts: Path, tmp_path: Path) -> None:
    command = (scripts / "python", "-m", "btr_mjx.diagnose", "--demo", "--robot", "pendulum", "--out", "demo")
    output = run(*command, "--no-progress", folder=tmp_path)
    found = json.loads((tmp_path / "demo" / "result.json").read_text())
    assert found["verdict"] == "effect"
    assert f"hidden was: {found['effects'][0]['effect'].replace('_', ' ')}" in output
    assert (tmp_path / "demo" / "report.html").stat().st_size > 0
