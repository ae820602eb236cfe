"""Settings as commands have them, for tests of what saves and restores them."""

import enum
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal


class Coding(enum.Enum):
    BINARY = 1
    GRAY = 2


@dataclass(frozen=True)
class Mutation:
    rate: float = 0.02
    coding: Coding = Coding.GRAY


@dataclass(frozen=True)
class Hidden:
    limbs: dict[str, float]


@dataclass(frozen=True)
class Measured:
    folder: Path


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
    reality: Hidden | Measured = field(default_factory=lambda: Hidden({"bl_5": 0.7}))
    ladder: list[tuple[int, float]] = field(default_factory=lambda: [(1, 0.5)])
