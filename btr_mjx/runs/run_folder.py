"""Run folders: everything a run needs to be read, repeated and continued.

    runs/demo/
      config.json               the command's config, field by field
      inputs.json               digests of what the config refers to: a robot, a dataset, ...
      environment.json          versions, machine and git commit, at the start and at each resume
      history.csv               tables that grow row by row
      checkpoint-000012.npz     the state after step 12; the last few are kept
      result.json, *.npz, *.png what the command adds at its end
      SHA256SUMS                digests of all data files, once the run has ended
      .lock                     locked while a process writes to the folder; its presence alone means nothing

A run that is killed at any moment and resumed gives the same files as an uninterrupted run, except environment.json, if
checkpoints and tables hold nothing that depends on the clock. A file that was damaged in between is written again from
the newest sound checkpoint, or is named in an error; it never changes a result.

    with RunFolder.create(config.out, config, resume=config.resume) as run, graceful_interrupt() as stop:
        checkpoint = run.load_latest()
        history = run.history("history.csv", checkpoint)
        state = begin(config) if checkpoint is None else restore(checkpoint)
        for step in range(0 if checkpoint is None else checkpoint.step + 1, config.steps):
            state, row = advance(state)
            history.append(row)
            run.save_checkpoint(step, state.arrays, state.meta)  # writes the tables first
            stop.checkpoint()
        write_json(run.path / "result.json", summary(state))
        run.seal()
"""

import json
import os
import weakref
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from btr_mjx.errors import DamagedFile
from btr_mjx.runs import checkpoints
from btr_mjx.runs.atomic import is_temporary, sync_folder
from btr_mjx.runs.checkpoints import Checkpoint
from btr_mjx.runs.checksums import file_digest, write_sums
from btr_mjx.runs.config_json import CONFIG_NAME, config_to_json
from btr_mjx.runs.environment import describe_environment, environment_changes
from btr_mjx.runs.files import read_json, to_plain, write_json, write_table
from btr_mjx.runs.locks import take_lock
from btr_mjx.runs.out_place import writing_to
from btr_mjx.runs.progress_bar import note
from btr_mjx.runs.resume_check import INPUTS_NAME, check_folder_of_run

ENVIRONMENT_NAME = "environment.json"
"""Name of the file in a run folder."""

IGNORED_FIELDS = ("out", "resume", "progress")
"""Config fields that do not affect results and may differ on resume."""


class History:
    """A table that grows row by row, a CSV file rewritten whole and atomically by `write`.

    All rows have the same columns; values are None, bool, int, float, str, or lists, which the file holds as JSON.
    Times and other values that differ from run to run do not belong here.
    """

    def __init__(self, path: str | Path, rows: Sequence[Mapping[str, Any]] = ()) -> None:
        self.path = Path(path)
        self._rows: list[dict[str, Any]] = [dict(row) for row in rows]

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> list[dict[str, Any]]:
        """A copy of the rows."""
        return [dict(row) for row in self._rows]

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row in memory, of the same columns; numpy scalars and arrays become plain numbers and lists."""
        plain = to_plain(row, strict=False)
        if self._rows and set(plain) != set(self._rows[0]):
            raise ValueError(f"{self.path.name}: expected the columns {list(self._rows[0])}, got {list(plain)}")
        self._rows.append(plain)

    def write(self) -> None:
        """Replace the file by all rows so far."""
        cell = lambda value: json.dumps(value) if isinstance(value, list) else value  # noqa: E731
        write_table(self.path, [{name: cell(value) for name, value in row.items()} for row in self._rows])


class RunFolder:
    """A folder that this process alone writes to, until it is closed; a context manager."""

    def __init__(self, path: Path, resumed: bool, lock: int | None) -> None:
        self.path = path
        self.resumed = resumed
        """True where config.json was there before."""
        self._histories: dict[str, History] = {}
        self._files: dict[str, str] = {}
        self._release = (lambda: None) if lock is None else weakref.finalize(self, os.close, lock)

    @classmethod
    def create(
        cls,
        path: str | Path,
        config: Any,
        resume: bool = False,
        *,
        ignore: Collection[str] = IGNORED_FIELDS,
        inputs: Mapping[str, str] | None = None,
    ) -> Self:
        """Begin a run in a new folder, or continue one that was interrupted.

        Nothing in the folder is changed if this raises an error. A folder whose first `create` was killed counts as
        new, with or without `resume`.

        Args:
          path: the folder; missing parent folders are created.
          config: a dataclass, written to config.json; see `btr_mjx.runs.config_json`.
          resume: continue the run in the folder, which must have been started with an equal config.
          ignore: names of config fields that may differ on resume since they do not affect results.
          inputs: what the run reads, in words -> its digest (`content_digest`); a resumed run must be given the same.

        Raises:
          InputError: the folder is not empty (without `resume`), is no run folder, was begun with another config (every
            field that differs is named with both values) or other inputs, is in use by another process, or cannot be
            made or written to.
          TypeError: the config cannot be saved as JSON.
          OSError: a file of it cannot be written.
        """
        path = Path(path)
        data = config_to_json(config)
        with writing_to(path):
            check_folder_of_run(path, data, resume, ignore, inputs or {})
            path.mkdir(parents=True, exist_ok=True)
            lock = take_lock(path)
        run = cls(path, (path / CONFIG_NAME).exists(), lock)
        try:
            # Again: another process may have been here before the lock.
            check_folder_of_run(path, data, resume, ignore, inputs or {})
            for leftover in [file for file in path.rglob("*") if is_temporary(file)]:
                leftover.unlink(missing_ok=True)
            # Written on resume as well: only fields that do not affect results can differ, or be damaged. A run whose
            # first process was killed at once is begun by a resume, and is the same run.
            run.settle(config)
            if not run.resumed:
                sync_folder(path.parent)
            if inputs:
                run._record_inputs(inputs)
            run._record_environment()
        except BaseException:
            run.close()
            raise
        return run

    def settle(self, config: Any) -> None:
        """Replace config.json, by a config in which the run has settled what was left to it, such as the engine.

        Raises:
          TypeError: the config cannot be saved as JSON.
          OSError: the file cannot be written.
        """
        data = config_to_json(config)
        write_json(self.path / CONFIG_NAME, data | ({"resume": False} if data.get("resume") else {}))

    def close(self) -> None:
        """Release the lock of the folder."""
        self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def history(self, name: str, checkpoint: Checkpoint | None = None) -> History:
        """A table of this folder as it was at `checkpoint`, empty where that is None or did not have it.

        `save_checkpoint` stores the rows and writes the file, which is never read back: it may have been damaged, or
        hold rows that were written after the checkpoint.
        """
        rows = [] if checkpoint is None else checkpoint.tables.get(name, [])
        self._histories[name] = History(self.path / name, rows)
        if rows:
            self._histories[name].write()
        return self._histories[name]

    def add_file(self, name: str) -> None:
        """Count a file of the folder as finished: checkpoints from now on hold its digest.

        Raises:
          OSError: the file cannot be read.
        """
        self._files[name] = file_digest(self.path / name)

    def save_checkpoint(self, step: int, arrays: Mapping[str, Any], meta: Mapping[str, Any] | None = None) -> Path:
        """Write the tables of `history`, then the state after `step`; see `checkpoints.save_checkpoint`."""
        for table in self._histories.values():
            table.write()
        tables = {name: table.rows for name, table in self._histories.items()}
        return checkpoints.save_checkpoint(self.path, step, arrays, meta, tables=tables, files=self._files)

    def load_latest(self) -> Checkpoint | None:
        """The newest undamaged checkpoint, None where there is none yet; see `checkpoints.load_latest`.

        Surplus older checkpoints are deleted, such as one left by a kill between writing a checkpoint and deleting the
        checkpoint that it replaces.

        Raises:
          DamagedFile: every checkpoint is damaged, or a file that was finished before it is missing or was altered.
        """
        checkpoint = checkpoints.load_latest(self.path)
        if checkpoint is not None:
            for name, digest in checkpoint.files.items():
                path = self.path / name
                if not path.is_file() or file_digest(path) != digest:
                    what = "was altered" if path.is_file() else "is missing"
                    raise DamagedFile(
                        f"{path}: {what} since it was written; restore it, or start again with another --out"
                    )
            self._files |= checkpoint.files
            checkpoints.drop_older(self.path, checkpoint.step)
        return checkpoint

    def seal(self) -> None:
        """Write SHA256SUMS, at the end of a run; see `btr_mjx.runs.checksums`."""
        write_sums(self.path)

    def _record_inputs(self, inputs: Mapping[str, str]) -> None:
        path = self.path / INPUTS_NAME
        if self.resumed and not path.exists():
            note(f"warning: {path} is missing: whether {' and '.join(inputs)} are those of the start is not known")
        write_json(path, inputs)

    def _record_environment(self) -> None:
        path = self.path / ENVIRONMENT_NAME
        now = describe_environment()
        if not path.exists():
            write_json(path, {**now, "resumed": []})
            return
        try:
            first = read_json(path)
            if not isinstance(first, dict) or not isinstance(first.get("resumed", []), list):
                raise DamagedFile(f"{path}: not the description of an environment")
        except DamagedFile as error:  # no result depends on it
            note(f"warning: {error}; written anew")
            first = now
        for change in environment_changes(first, now):
            note(f"warning: {change} since {self.path} was started; results may differ in the last bits")
        write_json(path, {**first, "resumed": [*first.get("resumed", []), now]})
