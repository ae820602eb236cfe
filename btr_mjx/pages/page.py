"""Rendering of pages: templates, figures and films inside them, folded settings and environment."""

import base64
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from btr_mjx.pages.page_content import Figure, Table, cell_order, cell_text, flat_rows
from btr_mjx.runs import CONFIG_NAME, atomic_write, read_json, read_limited

PAGE = "report.html"
"""File name of a page."""

LARGEST_FILM = 8_000_000
"""Size up to which a film is inside the page; a larger one is a link [bytes]."""

_TEMPLATES = Path(__file__).with_name("templates")
_FILMS = {".gif": "image/gif", ".mp4": "video/mp4"}


def write_page(folder: Path, variables: Mapping[str, Any]) -> Path:
    """Render a page about a run folder and write it there.

    Its config.json, environment.json, *.gif and *.mp4 are shown where they are there. Variables are heading, name,
    sentence, numbers, sections and footer, and a film_caption where films have one.

    Raises:
      DamagedFile: config.json or environment.json was altered.
      OSError: it cannot be written.
    """
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"cell": cell_text, "order": cell_order, "sentences": sentences}
    parts = {
        "films": _films(folder, str(variables.get("film_caption", ""))),
        "settings": _settings_table(folder / CONFIG_NAME, "setting"),
        "environment": _settings_table(folder / "environment.json", "of the machine"),
    }
    variables = dict(variables) | {"sections": [one for one in variables["sections"] if not one.is_empty]}
    html = environment.get_template("page.html.j2").render(parts | variables)
    with atomic_write(folder / PAGE) as file:
        file.write(html.encode("utf-8"))
    return folder / PAGE


def sentences(text: str) -> list[str]:
    """The sentences of a text; a full stop ends one where a space and a capital letter follow."""
    return re.split(r"(?<=[.!?)]) (?=[A-Z])", text)


def embedded(file: Path, alt: str, caption: str, photo: bool = False) -> Figure:
    """A PNG file as a figure inside a page."""
    return Figure(base64.b64encode(read_limited(file)).decode("ascii"), alt, caption, photo)


def _settings_table(file: Path, name: str) -> Table | None:
    """The entries of a JSON file; None where it is not there or is empty."""
    content = read_json(file) if file.is_file() else None
    rows = flat_rows(content) if isinstance(content, dict) else []
    return Table([name, "value"], rows) if rows else None


def _films(folder: Path, caption: str = "") -> list[dict[str, str]]:
    """The films of a folder: name, kind, caption and, of those that are not too large, the address of their data."""
    found = []
    for file in sorted(folder.iterdir()):
        kind = _FILMS.get(file.suffix.lower())
        if kind is not None and file.is_file():
            size = file.stat().st_size
            data = base64.b64encode(file.read_bytes()).decode("ascii") if size <= LARGEST_FILM else ""
            found.append({"name": file.name, "kind": kind, "data": data, "caption": caption or file.name})
    return found
