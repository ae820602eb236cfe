"""Flags and commands that messages, help and documents name exist."""

import ast
import dataclasses
import importlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from btr_mjx.coevolve import CoevolveConfig
from btr_mjx.diagnose import DiagnoseConfig
from btr_mjx.doctor import DoctorConfig
from btr_mjx.replay import ReplayConfig
from btr_mjx.report import ReportConfig
from btr_mjx.scan import ScanConfig

ROOT = Path(__file__).parents[2]
CONFIGS = (CoevolveConfig, ScanConfig, DiagnoseConfig, ReplayConfig, ReportConfig, DoctorConfig)
FLAGS = {field.name.replace("_", "-") for config in CONFIGS for field in dataclasses.fields(config)} | {"help", "quiet"}
FLAGS |= {f"no-{flag}" for flag in FLAGS}
OTHERS = {
    "scheduler-file",
    "nthreads",
    "extra",
    "reinstall",
    "force-reinstall",
    "no-optional-locks",
    "porcelain",
    "xla",
    "cases",
    "suites",
    "no",
}
"""Flags of other programs that are named or used: uv, pip, git, Dask, XLA, benchmarks; and the beginning of --no-..."""


def said() -> Iterator[tuple[str, str]]:
    """Texts in the source, with their place."""
    for path in sorted((ROOT / "btr_mjx").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", node.value


def test_flags_in_messages_exist() -> None:
    found = {(flag, place) for place, text in said() for flag in re.findall(r"(?<![\w-])--([a-z][a-z-]*[a-z])", text)}
    assert len(found) > 100
    assert not {(flag, place) for flag, place in found if flag not in FLAGS | OTHERS}


def test_commands_in_messages_and_documents_exist() -> None:
    documents = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    texts = [*said(), *((str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")) for path in documents)]
    named = {(name, place) for place, text in texts for name in re.findall(r"-m (btr_mjx[\w.]*\w)", text)}
    assert len(named) > 20
    for name, place in named:
        assert hasattr(importlib.import_module(name), "main"), f"{place}: python -m {name} is no command"
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for place, text in texts:
        for script in re.findall(r"(?<![\w./-])btr-(?!mjx)(\w+)(?= )", text):
            assert f"btr-{script}" in scripts, f"{place}: btr-{script} is no command"
