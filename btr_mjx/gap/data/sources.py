"""Detection of the format of a folder of recordings."""

from collections.abc import Sequence
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, ReadProgress, load
from btr_mjx.gap.data.formats.lerobot import load_lerobot, open_lerobot
from btr_mjx.gap.data.formats.lerobot_frames import is_lerobot_folder
from btr_mjx.gap.data.formats.servo import SERVO_FILE, is_servo_folder, load_servo
from btr_mjx.gap.data.inferred import is_model, logs_in, open_logs
from btr_mjx.runs import read_toml


def open_dataset(folder: str | Path, progress: ReadProgress | None = None, logs: Sequence[str | Path] = ()) -> Dataset:
    """Read a folder of recordings in any supported format, or a model and its logs.

    Formats: dataset.toml with logs or a LeRobot dataset, servo.toml with BAM JSON files, one MJCF file with logs or a
    LeRobot dataset.

    Args:
      folder: the folder, or its dataset.toml or servo.toml; or the model that `logs` are of.
      progress: called with the bytes that were read so far, and those of all files; not for LeRobot's and BAM's forms.
      logs: files of recordings, or the folder of a LeRobot dataset.

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
    datasets = [Path(log) for log in logs if is_lerobot_folder(log)]
    if datasets:
        if len(logs) > 1:
            raise InputError(
                f"{datasets[0]}: is a LeRobot dataset, and {len(logs) - 1} more logs were given; give it alone"
            )
        return open_lerobot(folder, datasets[0])
    if logs or folder.is_file():
        return open_logs(folder, logs, progress)
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (folder / DATASET_FILE).is_file():
        named = "lerobot" in read_toml(folder / DATASET_FILE)
        return load_lerobot(folder) if named or is_lerobot_folder(folder) else load(folder, progress)
    if is_servo_folder(folder):
        return load_servo(folder)
    if is_lerobot_folder(folder):
        models = [path for path in sorted(folder.iterdir()) if is_model(path) and path.is_file()]
        if len(models) != 1:
            raise InputError(
                f"{folder}: is a LeRobot dataset with {len(models)} MJCF files beside it; give the model, too: "
                f"MODEL.xml {folder}"
            )
        return open_lerobot(models[0], folder)
    try:
        model, logs = logs_in(folder)
    except InputError as error:
        raise InputError(f"{error}; or {SERVO_FILE} beside .json files") from None
    return open_logs(model, logs, progress)
