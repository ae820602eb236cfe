"""Recordings read and checked before any fit: those that are diagnosed, and earlier ones to compare them with."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from btr_mjx.errors import InputError, is_bad_input, one_line
from btr_mjx.runs import progress

if TYPE_CHECKING:
    from btr_mjx.gap.data import Dataset
    from btr_mjx.gap.effects import Effect
    from btr_mjx.gap.fitness_only import FitnessTable
    from btr_mjx.gap.preflight import Finding

LONG_READING = 10_000_000
"""Bytes of recordings from which on a bar is shown while they are read."""


def examine(
    folder: Path, library: "Sequence[Effect]", signal: str, show: bool = False, logs: Sequence[Path] = ()
) -> "tuple[Dataset | FitnessTable, list[Finding]]":
    """Read a dataset and check it before any fit.

    Args:
      folder: of the dataset, or a file: its dataset.toml, or the model that `logs` are of.
      library: effects that may be named.
      signal: "trajectory", or "fitness" for a table of measured fitness.
      show: show a progress bar while a long dataset is read.
      logs: files of recordings.

    Returns:
      The dataset as it is to be searched, and the findings of the preflight checks.

    Raises:
      InputError: the dataset cannot be read.
    """
    if signal == "fitness":
        from btr_mjx.gap.fitness_only import load_fitness, preflight_fitness

        table = load_fitness(folder)
        return table, preflight_fitness(table)
    from btr_mjx.gap.data import open_dataset

    with ExitStack() as stack:
        bar = None

        def report(done: int, total: int) -> None:
            nonlocal bar
            if bar is None and show and total >= LONG_READING:
                bar = progress(total=total, description="reading", unit="B", unit_scale=True, show=True)
                stack.enter_context(bar)
            if bar is not None:
                bar.update(done - bar.n)

        dataset = open_dataset(folder, report, logs)
        checks = progress(description="checks", show=None if show else False, bar_format="{desc}")
        checks.leave = False
        stack.enter_context(checks)
        from btr_mjx.gap.preflight import checked

        return checked(dataset, [effect.name for effect in library])


def examine_earlier(
    paths: Sequence[Path],
    dataset: "Dataset | FitnessTable",
    model: Path | None,
    library: "Sequence[Effect]",
    show: bool = False,
) -> "list[Dataset]":
    """Read, check and print the findings about earlier recordings of the same robot.

    Args:
      paths: of each set, the oldest first.
      dataset: the recordings that they are compared with.
      model: the model file that logs without a model of their own are of; None where `dataset` is a folder.
      library: effects that may be named.
      show: show a progress bar while a long set is read.

    Raises:
      InputError: a set cannot be read or used, or is of another robot; it names the set.
    """
    from btr_mjx.gap.data import DATASET_FILE
    from btr_mjx.gap.fitness_only import FitnessTable
    from btr_mjx.gap.forces import check_same_robot
    from btr_mjx.gap.preflight import refuse_errors
    from btr_mjx.gap.report import print_findings

    earlier: list[Dataset] = []
    for path in paths:
        described = path.is_dir() and ((path / DATASET_FILE).is_file() or any(path.glob("*.xml")))
        alone = path.name == DATASET_FILE or described
        folder, logs = (path, ()) if alone or model is None else (model, (path,))
        try:
            own, findings = examine(folder, library, "trajectory", show, logs)
            refuse_errors(findings)
            assert not isinstance(own, FitnessTable)
            assert not isinstance(dataset, FitnessTable)
            check_same_robot(own, dataset)
        except Exception as error:
            if not is_bad_input(error):
                raise
            raise InputError(f"--before {path}: {one_line(error)}") from error
        print_findings(findings, str(path), show)
        earlier.append(own)
    return earlier
