"""Which replay and which exports a run folder has."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.plotting import kind_of_run
from btr_mjx.replays.replay_records import Replay


def read_replay(folder: str | Path, frames: int, seconds: float) -> Replay:
    """The motions that a run folder is about, simulated again from its saved files.

    At most so many seconds of a recording are shown; trials of a co-evolution are shown whole.

    Raises:
      InputError: no such run, a robot or dataset that is gone or changed since.
    """
    folder, kind = Path(folder), kind_of_run(folder)
    if kind == "diagnose":
        from btr_mjx.replays.diagnosis_motions import diagnosis_replay

        return diagnosis_replay(folder, frames, seconds)
    if kind == "coevolve":
        from btr_mjx.replays.coevolution_motions import coevolution_replay

        return coevolution_replay(folder, frames)
    raise InputError(f"{folder}: only runs of btr_mjx.coevolve and btr_mjx.diagnose have motions that can be shown")


def check_exports(kinds: Sequence[str]) -> None:
    """Check that exports can be written.

    Args:
      kinds: "rerun" and "mcap", each the name of an extra and of the module that it brings.

    Raises:
      InputError: a package that is not installed.
    """
    for kind in kinds:
        if find_spec(kind) is None:
            raise InputError(
                f"--export {kind} needs the extra {kind!r}, which is not installed: uv add 'btr-mjx[{kind}]', "
                f"uv sync --extra {kind}, or pip install 'btr-mjx[{kind}]'"
            )


def export_motions(folder: str | Path, kinds: Sequence[str]) -> list[Path]:
    """Write what a diagnosis compares for viewers of recordings: diagnosis.rrd for Rerun, diagnosis.mcap for Foxglove.

    Args:
      folder: the run folder of a diagnosis that has ended.
      kinds: "rerun" and "mcap".

    Returns:
      The files; those that fail are left out, which one line each on stderr says.
    """
    if not kinds:
        return []
    from btr_mjx.replays.exported import export_diagnosis_motions

    return export_diagnosis_motions(Path(folder), kinds)
