"""The documentation: every public name is in the reference and explained, links hold, tutorials and adapters run."""

import importlib
import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import griffe
import pytest

import btr_mjx
from btr_mjx.gap.effects import KNOWN_EFFECTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TUTORIALS = sorted(DOCS.glob("tutorials/*.py"))
DOORS = sorted(
    ["btr_mjx.errors"]
    + [
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in Path(btr_mjx.__file__).parent.rglob("__init__.py")
        if "__all__" in path.read_text(encoding="utf-8")
    ]
)
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
ADAPTERS = {"Optuna": "optuna", "evosax": "evosax", "pyribs": "ribs"}
"""Heading of docs/adapters.md -> package that its code needs."""


def public_names(door: str) -> list[str]:
    """Names that a door re-exports; of the room of errors, which is a file, what it defines."""
    room = importlib.import_module(door)
    own = [name for name, value in vars(room).items() if getattr(value, "__module__", "") == door]
    return [name for name in getattr(room, "__all__", own) if not name.startswith("_")]


@pytest.fixture(scope="module")
def source() -> griffe.Module:
    found = griffe.load("btr_mjx", search_paths=[ROOT])
    assert isinstance(found, griffe.Module)
    return found


@pytest.mark.parametrize("door", DOORS)
def test_every_public_name_has_a_docstring(source: griffe.Module, door: str) -> None:
    assert len(DOORS) > 25
    bare = []
    for name in public_names(door):
        found = source[f"{door}.{name}".removeprefix("btr_mjx.")]
        found = found.final_target if isinstance(found, griffe.Alias) else found
        if not found.has_docstring:
            bare.append(name)
    assert bare == []


def slugs(page: Path) -> set[str]:
    """Anchors of a page's headings, as MkDocs and GitHub make them."""
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}


@pytest.mark.parametrize("page", [*PAGES, *TUTORIALS], ids=lambda path: str(path.relative_to(DOCS)))
def test_links_inside_hold(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith(("http", "mailto")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if target.parent == DOCS / "api":  # pages that are made of the rooms
            assert target.stem in (*DOORS, "index"), link
            continue
        script = target.with_suffix(".py")
        assert target.is_file() or (target.parent == DOCS / "tutorials" and script.is_file()), link
        assert not anchor or anchor in slugs(target), link


def test_the_navigation_names_every_page() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = re.findall(r"[\w/]+\.md", text[text.index("\nnav:") :])
    made = [path.with_suffix(".md") for path in TUTORIALS]
    assert sorted(named) == sorted(str(path.relative_to(DOCS)) for path in [*PAGES, *made])


def test_the_page_on_excitation_says_what_the_library_says() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \|", (DOCS / "excitation.md").read_text(encoding="utf-8"), re.M)
    assert rows == [(effect.name, effect.excited_by) for effect in KNOWN_EFFECTS if effect.law is None]


@pytest.mark.slow
def test_the_page_on_excitation_shows_what_the_benchmark_prints() -> None:
    command = [sys.executable, ROOT / "benchmarks/excitation.py"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
    cells = re.compile(r"^\| `([\w@:]+)` \| `([\w@:]+)` \| ([\d. |]+) \|$", re.M)
    expected = {(a, b): numbers.split(" | ") for a, b, numbers in cells.findall(printed)}
    shown = {(a, b): n.split(" | ") for a, b, n in cells.findall((DOCS / "excitation.md").read_text(encoding="utf-8"))}
    assert len(expected) == 15
    assert shown.keys() == expected.keys()
    for pair, numbers in expected.items():  # other processors differ in the last digits
        assert [float(n) for n in shown[pair]] == pytest.approx([float(n) for n in numbers], abs=0.03), pair


def test_nothing_is_fetched_by_a_reader() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "http" not in text
    assert "font: false" in text


@pytest.mark.slow
@pytest.mark.parametrize("script", TUTORIALS, ids=lambda path: path.stem)
def test_tutorials_run(script: Path) -> None:
    """As a reader runs them: from a checkout. What they claim, they assert."""
    if importlib.util.find_spec("mkdocs") is not None:
        pytest.skip("the site executes them")
    environment = os.environ | {"MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, script], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert "\n# %%" in script.read_text(encoding="utf-8")


def adapters() -> dict[str, str]:
    """Code of docs/adapters.md by heading."""
    text = (DOCS / "adapters.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (.+)$", text, flags=re.M)[1:]
    found = {title: FENCE.findall(body) for title, body in zip(parts[::2], parts[1::2], strict=True)}
    return {title: next(code for language, code in blocks if language == "python") for title, blocks in found.items()}


def test_adapters_are_short() -> None:
    code = adapters()
    assert set(code) == set(ADAPTERS)
    for title, text in code.items():
        lines = [line for line in text.splitlines() if line.strip() and not line.startswith(("import ", "from "))]
        assert len(lines) <= 20, title
        compile(text, title, "exec")


@pytest.mark.slow
@pytest.mark.parametrize("title", ADAPTERS)
def test_adapters_run(title: str, tmp_path: Path) -> None:
    if importlib.util.find_spec(ADAPTERS[title]) is None:
        pytest.skip(f"needs `uv run --with {ADAPTERS[title]}`")
    (tmp_path / "runs").mkdir()
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    before = {
        "Optuna": "import btr_mjx as btr, pathlib\n"
        "btr.coevolve(robot=pathlib.Path('examples/thrower'), iterations=1, trials=4, controllers=16,"
        " controller_generations=2, simulations=8, simulation_generations=3, figures=False, progress=False,"
        " out=pathlib.Path('runs/mine'))\n"
    }.get(title, "")
    after = {
        "Optuna": "(study,) = optuna.get_all_study_summaries(storage)\n"
        "assert study.n_trials == 24\n"
        "found = json.loads(Path('runs/mine/result.json').read_text())\n"
        "assert study.best_trial.params.keys() == found['simulation'].keys()\n"
        "assert abs(study.best_trial.value - found['delta_fitness_last']) < 1e-9\n",
        "evosax": "assert abs(found - [0.4, 0.7]).max() < 0.02, found\n",
        "pyribs": "assert len(archive) > 10\nassert -best['objective'].max() < 0.05\n"
        "assert transferred.shape == (6, box.n)\n",
    }[title]
    (tmp_path / "adapter.py").write_text(before + adapters()[title] + after, encoding="utf-8")
    done = subprocess.run([sys.executable, "adapter.py"], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_site_holds_every_public_name(tmp_path: Path) -> None:
    """The built reference, by its inventory; the build is strict."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("needs `uv run --group docs`")
    from mkdocstrings import Inventory

    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1800)
    assert done.returncode == 0, done.stderr
    with open(tmp_path / "site/objects.inv", "rb") as file:
        listed = set(Inventory.parse_sphinx(file))
    missing = []
    for door in DOORS:
        for name in public_names(door):
            found = getattr(importlib.import_module(door), name)
            if isinstance(found, ModuleType):  # a page, or a part of one: it is there by what it holds
                names = {other for other in listed if other.startswith(f"{found.__name__}.")}
            else:
                home = f"{getattr(found, '__module__', door)}.{getattr(found, '__qualname__', name)}"
                names = {f"{door}.{name}", home}
            if not names & listed:
                missing.append(f"{door}.{name}")
    assert missing == []
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > 50
    fetched = re.compile(r"""<(?:script|img|iframe|link rel="(?:stylesheet|preconnect))[^>]*(?:src|href)="?https?:""")
    assert [str(page) for page in pages if fetched.search(page.read_text(encoding="utf-8"))] == []


def test_the_group_of_the_docs_is_not_a_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert not any("mkdocs" in name for name in project["project"]["dependencies"])
