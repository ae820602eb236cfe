"""Datasets without a dataset.toml: a model and its logs, with what could be inferred written as a dataset.toml."""

import os
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, ReadProgress, header_of, load_table
from btr_mjx.gap.data.logs import LOG_SUFFIXES, is_log
from btr_mjx.gap.data.names.remedy import quoted

_MODELS = (".xml", ".mjcf")
_NO_LOGS = ("readme.txt", "license.txt", "requirements.txt")


def is_model(path: Path) -> bool:
    """Whether a path has the name of an MJCF file."""
    return path.suffix.lower() in _MODELS


def open_logs(model: str | Path, logs: Sequence[str | Path], progress: ReadProgress | None = None) -> Dataset:
    """Read logs of a robot without a dataset.toml.

    Args:
      model: MJCF file of the believed model.
      logs: files of recordings, or rosbag2 folders; each is a recording of its own.
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
    if not is_model(model):
        raise InputError(f"{model}: the first file is the model, a {' or '.join(_MODELS)} file; the logs come after it")
    if not paths:
        raise InputError(f"{model}: got a model without logs; give the files of its recordings after it")
    for path in paths:
        if not path.exists():
            raise InputError(f"{path}: there is no such file")
        if not is_log(path):
            raise InputError(
                f"{path}: is no recording; expected a {', '.join(LOG_SUFFIXES)} file, a rosbag2 folder, or the folder "
                "of a LeRobot dataset (that holds meta/info.json)"
            )
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError("a log was given twice; give each once")
    folder = Path(os.path.commonpath([path.resolve().parent for path in (model, *paths)]))
    names = [str(path.resolve().relative_to(folder)) for path in (model, *paths)]
    text = _written(names[0], names[1:])
    table = tomllib.loads(text)
    where = folder / DATASET_FILE
    data = load_table(header_of(table, folder, where), table, where, progress, text)
    unread = f"{where} was not read, as the model and logs were given; to use it, give {folder}"
    first = unread if where.is_file() else f"there is no {DATASET_FILE}"
    notes = (
        f"{first}; what was inferred is listed here, and written as {DATASET_FILE} into the folder of a run",
        *data.notes,
    )
    told = [line for one in data.recordings for line in one.notes]
    header = [
        f"# Inferred from the files. To change it, copy it to {folder} and give that folder to diagnose.",
        *(f"# {line}" for line in dict.fromkeys([*data.notes, *told])),
    ]
    interpolation = ["", "[control]", f"interpolation = {quoted(data.interpolation)}"]
    inferred = "\n".join([*header, "", text.rstrip(), *interpolation]) + "\n"
    return replace(data, notes=notes, inferred=inferred)


def logs_in(folder: Path) -> tuple[Path, list[Path]]:
    """The model and the logs of a folder without a dataset.toml.

    Raises:
      InputError: no model or several, or no logs.
    """
    inside = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    models = [path for path in inside if is_model(path) and path.is_file()]
    logs = [path for path in inside if is_log(path) and path.name.lower() not in _NO_LOGS]
    if len(models) != 1 or not logs:
        found = f"{len(models)} .xml files and {len(logs)} logs"
        raise InputError(
            f"{folder}: it holds no {DATASET_FILE} and {found}; expected a {DATASET_FILE}, or one MJCF file and logs "
            f"({', '.join(LOG_SUFFIXES)}); or give the files: MODEL.xml LOG [LOG ...]"
        )
    return models[0], logs


def _written(model: str, logs: Sequence[str]) -> str:
    """The dataset.toml of a model and its logs, without what is in their columns."""
    lines = ["[model]", f"file = {quoted(model)}"]
    for log in logs:
        lines += ["", "[[recording]]", f"file = {quoted(log)}"]
    return "\n".join(lines) + "\n"
