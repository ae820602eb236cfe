"""Detection of the format of a folder of recordings."""

from collections.abc import Sequence
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, ReadProgress, load
from btr_mjx.gap.data.formats.lerobot import INFO, is_lerobot_folder, load_lerobot
from btr_mjx.gap.data.formats.servo import SERVO_FILE, is_servo_folder, load_servo
from btr_mjx.gap.data.inferred import logs_in, open_logs


def open_dataset(folder: str | Path, progress: ReadProgress | None = None, logs: Sequence[str | Path] = ()) -> Dataset:
    """Read a folder of recordings in any supported format, or a model and its logs.

    Formats: dataset.toml with logs, dataset.toml with LeRobot files, servo.toml with BAM JSON files, one MJCF file with
    logs.

    Args:
      folder: the folder, or its dataset.toml or servo.toml; or the model that `logs` are of.
      progress: called with the bytes that were read so far, and those of all files; not for LeRobot's and BAM's forms.
      logs: files of recordings.

    Returns:
      The dataset.

    Raises:
      InputError: no supported format, or invalid content.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    folder = Path(folder)
    if folder.is_file() and folder.name in (DATASET_FILE, SERVO_FILE):
        folder = folder.parent
    if logs or folder.is_file():
        return open_logs(folder, logs, progress)
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (folder / DATASET_FILE).is_file():
        return load_lerobot(folder) if is_lerobot_folder(folder) else load(folder, progress)
    if is_servo_folder(folder):
        return load_servo(folder)
    if is_lerobot_folder(folder):
        raise InputError(
            f'{folder}: {INFO} needs a {DATASET_FILE} beside it that names the model: [model] file = "..."'
        )
    try:
        model, logs = logs_in(folder)
    except InputError as error:
        raise InputError(f"{error}; or {SERVO_FILE} beside .json files") from None
    return open_logs(model, logs, progress)
