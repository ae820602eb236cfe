"""Which format a folder has, or a model and its logs; what is inferred without a dataset.toml is written as one."""

import os
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.data.columns.remedy import Answer, quoted
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, header_of, read_header
from btr_mjx.gap.data.files.readers import is_log, is_prose, log_suffixes
from btr_mjx.gap.data.lerobot.frames import is_lerobot_folder
from btr_mjx.gap.data.lerobot.loading import load_lerobot
from btr_mjx.gap.data.lists import listed
from btr_mjx.gap.data.loading import ReadProgress, load_table
from btr_mjx.gap.data.servo import SERVO_FILE, load_servo
from btr_mjx.runs import naming_lines

_MODELS = (".xml", ".mjcf")
_NO_LOGS = ("readme.txt", "license.txt", "requirements.txt")


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
    if logs or folder.is_file():
        return open_logs(folder, logs, progress)
    with naming_lines(folder / DATASET_FILE), naming_lines(folder / SERVO_FILE):
        return _open_folder(folder, progress)


def _open_folder(folder: Path, progress: ReadProgress | None) -> Dataset:
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder")
    if (folder / DATASET_FILE).is_file():
        head, table = read_header(folder, more=("lerobot",))
        if "lerobot" in table or is_lerobot_folder(folder):
            return load_lerobot(head, table, Answer(folder / DATASET_FILE))
        return load_table(head, table, folder / DATASET_FILE, progress)
    if (folder / SERVO_FILE).is_file():
        return load_servo(folder)
    model, found, prose = _inside(folder)
    data = open_logs(model, found, progress)
    told = f"{listed(path.name for path in prose)}: text without a row of numbers, which is not read"
    return replace(data, notes=(*data.notes, told)) if prose else data


def open_logs(model: str | Path, logs: Sequence[str | Path], progress: ReadProgress | None = None) -> Dataset:
    """Read logs of a robot, or a LeRobot dataset, without a dataset.toml.

    Args:
      model: MJCF file of the believed model.
      logs: files of recordings, or rosbag2 folders; each is a recording of its own, unless only together they have all
        columns. Or the folder of a LeRobot dataset.
      progress: called while recordings are read.

    Returns:
      The dataset; `Dataset.inferred` is the dataset.toml that says the same.

    Raises:
      InputError: a file that does not exist or is no recording, or columns that cannot be matched to the model; with
        what to write and to run.
      DamagedFile: a file that does not parse.
      OSError: a file that cannot be read.
    """
    model, paths = Path(model), [Path(log) for log in logs]
    if not model.is_file():
        raise InputError(f"{model}: there is no such model file")
    if model.suffix.lower() not in _MODELS:
        raise InputError(f"{model}: the first file is the model, a {' or '.join(_MODELS)} file; the logs come after it")
    if not paths:
        raise InputError(f"{model}: got a model without logs; give the files of its recordings after it")
    lerobot = [path for path in paths if is_lerobot_folder(path)]
    if lerobot and len(paths) > 1:
        raise InputError(
            f"{lerobot[0]}: is a LeRobot dataset, and {len(paths) - 1} more logs were given; give it alone"
        )
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
        if not lerobot and not is_log(path):
            raise InputError(
                f"{path}: is no recording; expected a {', '.join(log_suffixes())} file, a rosbag2 folder, or the "
                "folder of a LeRobot dataset (that holds meta/info.json)"
            )
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError("a log was given twice; give each once")
    places = [path.resolve() for path in (model, *paths)]
    folder = Path(os.path.commonpath([place if place.is_dir() and lerobot else place.parent for place in places]))
    names = [quoted(str(place.relative_to(folder))) for place in places]
    rows = ["[lerobot]\nfolder = " + names[1]] if lerobot else ["[[recording]]\nfile = " + name for name in names[1:]]
    text, where = _described(names[0], rows), folder / DATASET_FILE
    table = tomllib.loads(text)
    head = header_of(table, folder, where, ("lerobot",))
    if lerobot:
        data = load_lerobot(head, table, Answer(where, text))
    else:
        try:
            data = load_table(head, table, where, progress, text)
        except InputError:
            one = _described(names[0], [f"[[recording]]\nfile = [{', '.join(names[1:])}]"])
            together = _read(head, one, where)
            if len(paths) == 1 or together is None:
                raise
            parts = (_read(head, _described(names[0], [row]), where) for row in rows)
            # A log with forces alone is not complete where another one has the commands.
            if any(part is not None and part.forces == together.forces for part in parts):
                raise
            note = f"{listed(names[1:])} are read as one recording: only together they have all columns"
            data, text = replace(together, notes=(note, *together.notes)), one
    why = f"was not read; to use it, give {folder}"
    first = f"{where} {why}" if where.is_file() else f"there is no {DATASET_FILE}"
    notes = f"{first}; what was inferred is listed here, and written as {DATASET_FILE} into the folder of a run"
    return replace(data, notes=(notes, *data.notes), described=text)


def _described(model: str, rows: Sequence[str]) -> str:
    """A dataset.toml of a model and of rows."""
    return "\n\n".join([f"[model]\nfile = {model}", *rows]) + "\n"


def _read(head: Dataset, text: str, where: Path) -> Dataset | None:
    """The dataset that a dataset.toml describes; None where it is refused."""
    try:
        return load_table(head, tomllib.loads(text), where, text=text)
    except InputError:
        return None


def _inside(folder: Path) -> tuple[Path, list[Path], list[Path]]:
    """The model and the logs of a folder without a dataset.toml, and files of text that are none."""
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    models = [path for path in inside if path.suffix.lower() in _MODELS and path.is_file()]
    if is_lerobot_folder(folder):
        if len(models) != 1:
            raise InputError(
                f"{folder}: is a LeRobot dataset with {len(models)} MJCF files beside it; give the model, too: "
                f"MODEL.xml {folder}"
            )
        return models[0], [folder], []
    logs = [path for path in inside if is_log(path) and path.name.lower() not in _NO_LOGS]
    prose = [path for path in logs if is_prose(path)]
    logs = [path for path in logs if path not in prose]
    if len(models) != 1 or not logs:
        raise InputError(
            f"{folder}: it holds no {DATASET_FILE} and {len(models)} .xml files and {len(logs)} logs; expected a "
            f"{DATASET_FILE}, or one MJCF file and logs ({', '.join(log_suffixes())}); or give the files: MODEL.xml "
            f"LOG [LOG ...]; or {SERVO_FILE} beside .json files"
        )
    return models[0], logs, prose
