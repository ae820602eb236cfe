"""Which replay a run folder has."""

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
