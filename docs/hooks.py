"""What MkDocs makes of code: executed tutorials, a page of the reference for every room, and files of the examples.

A tutorial is a script in jupytext's percent format. It is executed when the site is built and becomes a page with its
output; an exception in it ends the build. What was executed is kept in `.cache/tutorials`, under a digest of the
script, the package and the examples: a second build without changes executes nothing.
"""

import hashlib
import importlib
import re
from pathlib import Path
from types import ModuleType
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "btr_mjx"
EXAMPLES = [path for path in sorted(ROOT.joinpath("examples").rglob("*.*")) if "__pycache__" not in path.parts]
CACHE = ROOT / ".cache/tutorials"


def doors() -> list[str]:
    """Modules with public names: the package, its errors, and all rooms whose door lists names."""
    rooms = [path.parent for path in PACKAGE.rglob("__init__.py") if "__all__" in path.read_text(encoding="utf-8")]
    return sorted(["btr_mjx.errors", *(".".join(path.relative_to(ROOT).parts) for path in rooms)])


def reference(door: str) -> str:
    """Page of a room: its door, and the names that mkdocstrings does not find there.

    Those are modules, and objects that are named like the file that defines them.
    """
    room = importlib.import_module(door)
    lines = [f"# `{door}`", "", f"::: {door}", ""]
    for name in getattr(room, "__all__", ()):
        found = getattr(room, name)
        home = found.__name__ if isinstance(found, ModuleType) else str(getattr(found, "__module__", ""))
        if isinstance(found, ModuleType) and home not in doors():
            lines += [f"## `{home}`", "", f"::: {home}", "    options: {heading_level: 3}", ""]
        elif isinstance(found, ModuleType):
            lines += [f"- [`{home}`]({home}.md)", ""]
        elif home.endswith(f".{name}"):
            lines += [f"::: {home}.{name}", "    options: {show_root_heading: true, heading_level: 2}", ""]
    return "\n".join(lines)


def on_config(config: Any) -> Any:
    """List the pages of the reference in the navigation, under the heading API."""
    (section,) = (item for item in config.nav if "API" in item)
    section["API"] = ["api/index.md", *({name.removeprefix("btr_mjx."): f"api/{name}.md"} for name in doors())]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made of code."""
    rows = ["# API reference", "", "Everything public, by room.", "", "| room | |", "|---|---|"]
    for name in doors():
        first = (importlib.import_module(name).__doc__ or "").partition("\n")[0]
        rows.append(f"| [`{name}`]({name}.md) | {first} |")
        files.append(File.generated(config, f"api/{name}.md", content=reference(name)))
    files.append(File.generated(config, "api/index.md", content="\n".join(rows) + "\n"))
    for script in sorted(ROOT.joinpath("docs/tutorials").glob("*.py")):
        text, pictures = executed(script)
        files.append(File.generated(config, f"tutorials/{script.stem}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"tutorials/{name}", content=data))
    for path in EXAMPLES:
        files.append(File.generated(config, str(path.relative_to(ROOT)), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Name pages by their titles; in the site, the examples lie beside them."""

    def titled(link: re.Match[str]) -> str:
        target = Path(page.file.abs_src_path or ROOT).parent / link[1]
        return f"[{target.read_text(encoding='utf-8').partition('\n')[0].lstrip('# ')}]({link[1]})"

    return re.sub(r"\[(?:docs/)?(?=(\w+\.md)\]\(\1\))[^\]]*\]\([^)]*\)", titled, markdown).replace(
        "](../examples/", "](examples/"
    )


def executed(script: Path) -> tuple[str, dict[str, bytes]]:
    """A tutorial with its output as Markdown, and its pictures by file name.

    Args:
      script: in percent format.

    Returns:
      Text and pictures.

    Raises:
      CellExecutionError: a cell raises.
    """
    import jupytext
    import nbclient
    import nbconvert
    import nbformat
    from traitlets.config import Config

    digest = hashlib.sha256(script.read_bytes())
    for source in [*sorted(PACKAGE.rglob("*.py")), *EXAMPLES]:
        digest.update(source.read_bytes())
    kept = CACHE / f"{script.stem}-{digest.hexdigest()[:16]}.ipynb"
    if kept.is_file():
        notebook = nbformat.read(kept, as_version=4)
    else:
        notebook = jupytext.read(script)
        where = {"metadata": {"path": str(ROOT)}}
        ports = Config({"KernelManager": {"transport": "ipc"}})  # none are opened
        nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=where, config=ports).execute()
        CACHE.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, kept)
    text, resources = nbconvert.MarkdownExporter().from_notebook_node(notebook, {"unique_key": script.stem})
    return f"{text}\n[This page as a script]({script.name}){{download}}\n", resources["outputs"]
