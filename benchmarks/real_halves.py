"""Halves of real recordings, in which nothing has changed: `uv run python benchmarks/real_halves.py FOLDER ...`.

Each recording is cut in halves by time; the second halves are compared with the first ones, and the other way round.
Whatever is named as a change is false.
"""

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from btr_mjx.errors import cli_errors
from btr_mjx.gap.data import Dataset, open_dataset
from btr_mjx.gap.forces import identify_changes


def halves(folder: Path) -> tuple[Dataset, Dataset]:
    """A dataset with the first half of each recording, and one with the second halves."""
    whole = open_dataset(folder)

    def part(first: float, last: float) -> Dataset:
        parts = []
        for r in whole.recordings:
            rows = slice(int(first * len(r.time)), int(last * len(r.time)))
            cut = {name: getattr(r, name)[rows] for name in ("time", "ctrl", "qpos", "qvel")}
            parts.append(replace(r, force={}, sensor={}, **cut))
        return replace(whole, recordings=tuple(parts))

    return part(0, 0.5), part(0.5, 1)


def main() -> None:
    """Print what is named before and as a change, either way."""
    with cli_errors():
        for folder in map(Path, sys.argv[1:]):
            first, second = halves(folder)
            for pair in ((first, second), (second, first)):
                for which, found in zip(("before", "change"), identify_changes(pair).diagnoses, strict=True):
                    named = [f"{effect.effect}@{effect.location}" for effect in found.effects]
                    print(f"{folder.name} {which}: {found.verdict} {'; '.join(named)} {' '.join(found.unexplained)}")


if __name__ == "__main__":
    main()
