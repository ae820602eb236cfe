"""Suites without a simulation for the tests of the gate; processes of their own import this module."""

import os
import time
from functools import partial
from pathlib import Path
from typing import Any

from gates.cases import Suite
from gates.rows import row_of

SWITCH = "switch"
"""File beside the folders of cases and answers that changes what a case does: "crash", "hang", "raise" or "wrong"."""


def make(folder: Path, seed: int, index: int) -> dict[str, Any]:
    switch = _switch(folder)
    if switch == f"unmade {index}":
        raise RuntimeError("this case cannot be made")
    (folder / "log.csv").write_text(f"{seed} {index}")
    return {"hidden": "spring@joint:knee" if index else "nothing", "index": index}


def solve(folder: Path, slow: float = 1.0) -> dict[str, Any]:
    """An answer that is right, and what the switch says for case 1."""
    index = int((folder / "log.csv").read_text().split()[1])
    switch = _switch(folder) if index == 1 else ""
    if switch == "crash":
        os._exit(9)
    if switch == "hang":
        time.sleep(60)
    if switch == "raise":
        raise RuntimeError("the search broke")
    named = [{"effect": "damping" if switch == "wrong" else "spring", "location": "joint:knee"}] if index else []
    return {"verdict": "effect" if named else "none", "effects": named, "cpu_seconds": slow * (index + 1)}


def judge(_: Path, truth: Any, answer: Any) -> Any:
    right = [f"{e['effect']}@{e['location']}" for e in answer["effects"]] == (
        [truth["hidden"]] if truth["index"] else []
    )
    false = ["damping@joint:knee"] if answer["effects"] and not right else []
    return row_of(answer, truth["hidden"], right, false, is_null=not truth["index"], inside=[right])


def _switch(folder: Path) -> str:
    file = folder.parents[2] / SWITCH
    return file.read_text() if file.is_file() else ""


TOY = Suite("toy", 2, 7, make, solve, judge)
SLOW_TOY = Suite("toy", 2, 7, make, partial(solve, slow=2.0), judge)


def named(name: str, location: str, **values: float) -> dict[str, Any]:
    numbers = {k.replace("__", "[") + "]" * ("__" in k): v for k, v in values.items()}
    parameters = {k: {"value": v, "low": v - 0.1, "high": v + 0.1, "null": 0.0} for k, v in numbers.items()}
    return {"effect": name, "location": location, "parameters": parameters}


def answer(*effects: dict[str, Any], verdict: str | None = None) -> dict[str, Any]:
    return {"verdict": verdict or ("effect" if effects else "none"), "effects": list(effects), "cpu_seconds": 1.0}
