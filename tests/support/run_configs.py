"""Settings as commands have them, for tests of what saves and restores them."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class Mutation:
    rate: float = 0.02
    coding: Literal["binary", "gray"] = "gray"


@dataclass(frozen=True)
class Config:
    out: Path = Path("runs/demo")
    resume: bool = False
    seed: int = 0
    unknown: tuple[str, ...] = ("bl_5", "bl_14")
    box: tuple[float, float] = (0.4, 1.6)
    engine: Literal["lanes", "mjx", "native"] | None = None
    stop: float = math.inf
    mutation: Mutation = field(default_factory=Mutation)
    limbs: dict[str, float] = field(default_factory=lambda: {"bl_5": 0.7})
    ladder: list[tuple[int, float]] = field(default_factory=lambda: [(1, 0.5)])
