"""Packages that are installed for a test: a module and its entry points in a folder of the search path."""

from pathlib import Path

import pytest


def install(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: str, group: str, entry: str) -> None:
    """Install a package of one module.

    Args:
      folder: into which it is written.
      monkeypatch: takes it away again.
      name: of the package and its module.
      code: of the module.
      group: entry point group.
      entry: "NAME = MODULE:OBJECT".
    """
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{group}]\n{entry}\n")
    (folder / f"{name}.py").write_text(code)
    monkeypatch.syspath_prepend(str(folder))
