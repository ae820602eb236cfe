"""Whatever form recordings have: one function that recognises it."""

from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.data.dataset import FILE_NAME, Dataset, load
from btr_mjx.gap.data.formats.lerobot import INFO, is_lerobot_folder, load_lerobot
from btr_mjx.gap.data.formats.servo import FILE_NAME as SERVO_NAME
from btr_mjx.gap.data.formats.servo import is_servo_folder, load_servo


def open_dataset(folder: str | Path) -> Dataset:
    """Read a folder of recordings: a dataset.toml, LeRobot's form beside one, or BAM's JSON beside a servo.toml.

    Raises:
      InputError: none of these, or anything wrong with the folder's content, in one line.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    folder = Path(folder)
    if folder.is_file() and folder.name in (FILE_NAME, SERVO_NAME):
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (folder / FILE_NAME).is_file():
        return load_lerobot(folder) if is_lerobot_folder(folder) else load(folder)
    if is_servo_folder(folder):
        return load_servo(folder)
    raise InputError(
        f"{folder}: it holds no recordings that are known here; expected {FILE_NAME} (with {INFO} for LeRobot's form) "
        f"or {SERVO_NAME} beside .json files"
    )
