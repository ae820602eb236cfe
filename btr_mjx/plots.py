"""Every figure, drawn from saved files only."""

from pathlib import Path


def draw_run(folder: Path) -> list[Path]:
    """Draw the figures of a run folder of `btr_mjx.coevolve`."""
    return []
