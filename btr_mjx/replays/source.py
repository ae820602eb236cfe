"""Which replay a run folder has."""

from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.replays.motion import Replay
from btr_mjx.runs import read_json


def read_replay(folder: str | Path, frames: int, seconds: float) -> Replay:
    """The motions that a run folder is about, simulated again from its saved files.

    Args:
      folder: of a co-evolution or a diagnosis that has ended.
      frames: number of frames.
      seconds: longest part of a recording that is shown [s]; trials of a co-evolution are shown whole.

    Returns:
      The motions.

    Raises:
      InputError: no such run, a robot or dataset that is gone or changed since.
    """
    folder = Path(folder)
    if not (folder / "result.json").is_file():
        raise InputError(
            f"{folder} holds no result.json: expected a run of btr_mjx.coevolve or diagnose that has ended"
        )
    result = read_json(folder / "result.json")
    if isinstance(result, dict) and "verdict" in result:
        from btr_mjx.replays.diagnosis import diagnosis_replay

        return diagnosis_replay(folder, frames, seconds)
    if isinstance(result, dict) and "best_controller" in result:
        from btr_mjx.replays.coevolution import coevolution_replay

        return coevolution_replay(folder, frames)
    raise InputError(f"{folder}: only runs of btr_mjx.coevolve and btr_mjx.diagnose have motions that can be shown")
