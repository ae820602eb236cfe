"""Which folder a run may take: a new one, or one that was begun with the same config and inputs."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError
from btr_mjx.runs.atomic import is_temporary
from btr_mjx.runs.config_json import differences, read_config_json
from btr_mjx.runs.files import read_json
from btr_mjx.runs.locks import LOCK_NAME
from btr_mjx.runs.out_place import writing_to

INPUTS_NAME = "inputs.json"
"""Name of the file in a run folder."""


def is_unused(folder: Path) -> bool:
    """Whether nothing was ever saved here: absent, empty, or left by a process killed before its first file."""
    return not folder.exists() or all(path.name == LOCK_NAME or is_temporary(path) for path in folder.iterdir())


def check_folder_of_run(
    path: Path, data: Mapping[str, Any], resume: bool, ignore: Collection[str], inputs: Mapping[str, str]
) -> None:
    """Refuse a folder that cannot take this run, without touching it."""
    if path.exists() and not path.is_dir():
        raise InputError(f"--out {path}: is a file, not a run folder; choose another --out")
    if resume and not path.exists():
        raise InputError(f"nothing to resume: there is no folder {path}; check --out or leave out --resume")
    if is_unused(path):
        return
    if not resume:
        raise InputError(f"{path} exists and is not empty; continue it with --resume or choose another --out")
    changed = differences(read_config_json(path), data, ignore)
    if changed:
        raise InputError(
            f"{path} was started with another config ({'; '.join(changed)}); give the saved values or another --out"
        )
    check_inputs(path, inputs)


def check_inputs(path: Path, inputs: Mapping[str, str]) -> None:
    """Compare what a run refers to, see `RunFolder.create`, with what it was when the run started.

    Raises:
      InputError: a robot, a dataset, ... that changed since.
    """
    if (path / INPUTS_NAME).exists():
        saved = read_json(path / INPUTS_NAME)
        other = [name for name, digest in inputs.items() if not isinstance(saved, dict) or saved.get(name) != digest]
        if other:
            copies = f" (copies are in {path / 'inputs'})" if (path / "inputs").is_dir() else ""
            raise InputError(
                f"{path}: {' and '.join(other)} changed since the run was started; restore what was changed{copies}, "
                "or begin another run with another --out"
            )


@contextmanager
def claimed_folder[Config](config: Config, base: str) -> Iterator[Config]:
    """A command's config with its run folder: the named one, or a new one of runs/BASE, runs/BASE-2, ...

    A new folder is made at once, so that commands that begin together take different ones; it is removed again if it is
    empty at the end. The config has the fields `out` (a path or None) and `resume`.

    Raises:
      InputError: `resume` without a folder, or the folder cannot be made.
    """
    settings: Any = config
    if settings.out is not None:
        yield config
        return
    if settings.resume:
        raise InputError("--resume: say which run to continue with --out FOLDER")
    with writing_to(Path("runs"), "--out"):
        Path("runs").mkdir(exist_ok=True)
        for number in count(1):
            folder = Path("runs") / (base if number == 1 else f"{base}-{number}")
            with suppress(FileExistsError):
                folder.mkdir()
                break
    try:
        yield replace(settings, out=folder)
    finally:
        with suppress(OSError):  # not empty
            folder.rmdir()
