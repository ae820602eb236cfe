"""The dataset.toml that says what was inferred from a model and its logs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from btr_mjx.gap.data.columns.remedy import quoted
from btr_mjx.gap.data.recordings.recording import Recording


def inferred_toml(
    described: str, folder: Path, told: Sequence[str], control: Sequence[str], scales: Sequence[Sequence[str]]
) -> str:
    """The text of it.

    Args:
      described: the model and the recordings.
      folder: where a dataset.toml of them would be.
      told: choices, which become comments.
      control: lines of [control].
      scales: lines of each table of a LeRobot joint.
    """
    model, _, rest = described.rstrip().partition("\n\n")
    blocks = [
        f"# Inferred from the files. To change it, copy it to {folder} and give that folder to diagnose.",
        *(f"# {line}" for line in dict.fromkeys(told)),
    ]
    tables = ["\n".join(lines) for lines in (blocks, [model], ["[control]", *control], [rest], *scales)]
    return "\n\n".join(tables) + "\n"


def control_lines(recordings: Sequence[Recording], shifts: Mapping[str, float], forces: bool) -> list[str]:
    """Lines of [control]: of all recordings, or of each by its name; "" is the name of all."""
    by_log = {one.log or one.name: quoted(one.interpolation) for one in recordings}
    said = _inline(by_log) if len(set(by_log.values())) > 1 else next(iter(by_log.values()))
    lines = [f"interpolation = {said}"]
    shift = {log: f"{seconds:g}" for log, seconds in shifts.items()}
    lines += [f"shift = {shift[''] if list(shift) == [''] else _inline(shift)}"] if shift else []
    return lines + ['measured = "force"'] * forces


def _inline(table: Mapping[str, str]) -> str:
    """A table of TOML in one line."""
    return f"{{ {', '.join(f'{quoted(name)} = {value}' for name, value in table.items())} }}"
