"""The files of a robot in a run folder: copies, from which a run is shown and continued without the originals.

inputs/files.json          which copy stands for which setting, such as {"robot": "robot/walker/robot.toml"}
inputs/robot/walker/...    robot.toml, MJCF, meshes and Python files, to each other as they were
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.models.mjcf_checks import MAX_ASSET_BYTES, check_mjcf
from btr_mjx.robots import Robot
from btr_mjx.runs import atomic_write, note, read_json, read_limited, read_toml, write_json

COPIES = "inputs"
"""Folder of the copies in a run folder."""

_INDEX = "files.json"

_MOST_BYTES = 256 << 20
"""Size of files above which none are copied: a run folder is otherwise some megabytes [bytes]."""


def files_of_model(robot: Robot) -> list[Path]:
    """The file of a robot's MJCF, and those that it names."""
    own = _placed(Path(robot.template_path))
    text, folder = robot.render(robot.nominal), Path(robot.folder) if robot.folder else own.parent
    return [own, *map(_placed, check_mjcf(text, robot.template_path, folder))]


def files_of_robot(file: Path, robot: Robot) -> list[Path]:
    """A robot.toml, or the one of a folder, and all files that it and its MJCF name."""
    file = _placed(file / "robot.toml" if file.is_dir() else file)
    python = [_placed(file.parent / name) for name in _python_files(read_toml(file))]
    return [file, *python, *files_of_model(robot)]


def keep_files(folder: Path, named: Mapping[str, Sequence[Path]]) -> None:
    """Copy files into a run folder; copies that are there and were not altered stay.

    Args:
      folder: the run folder.
      named: setting -> the file that it names, and others that this one needs.

    Raises:
      InputError: a file that is not a regular one.
      OSError: a file cannot be read or written.
    """
    size = sum(file.stat().st_size for files in named.values() for file in set(files))
    if size > _MOST_BYTES:
        note(f"the robot's files ({size >> 20} MiB) are not copied: the run needs them where they are")
        return
    index = {name: copy.relative_to(folder / COPIES).as_posix() for name, copy in kept_files(folder).items()}
    for setting, files in named.items():
        root = Path(os.path.commonpath([file.parent for file in files])).parent  # a robot is named by its folder
        for file in dict.fromkeys(files):
            copy, content = folder / COPIES / setting / file.relative_to(root), read_limited(file, MAX_ASSET_BYTES)
            if not copy.is_file() or copy.read_bytes() != content:
                with atomic_write(copy) as opened:
                    opened.write(content)
        index[setting] = (Path(setting) / files[0].relative_to(root)).as_posix()
    if index:
        write_json(folder / COPIES / _INDEX, index)  # last: the copies are there when it is


def kept_files(folder: Path) -> dict[str, Path]:
    """Setting -> the copy of the file that it names, in a run folder.

    Raises:
      DamagedFile: the list of copies was altered.
    """
    index = folder / COPIES / _INDEX
    return {name: folder / COPIES / path for name, path in read_json(index).items()} if index.is_file() else {}


def _placed(file: Path) -> Path:
    """The absolute path of a file, with links in its folders followed."""
    return file.parent.resolve() / file.name


def _python_files(value: Any) -> Iterator[str]:
    """Files of FILE.py:NAME in a TOML value."""
    if isinstance(value, str):
        yield from re.findall(r"^(.+\.py):\w+$", value)
    elif isinstance(value, Mapping | list):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _python_files(part)
