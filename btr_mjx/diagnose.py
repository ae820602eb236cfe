"""Name the effect that a simulation lacks: `python -m btr_mjx.diagnose MODEL.xml LOG [LOG ...] --out RUN`.

MODEL.xml is the MJCF of the believed robot; a LOG is a CSV, Parquet, NPZ, HDF5, MCAP, rosbag2 or .pt file, see
docs/logs.md, or the folder of a LeRobot dataset. A folder may stand for both: one that holds them, one with a
dataset.toml (see btr_mjx/gap/data/dataset.py), or with BAM's JSON beside a servo.toml.
`python -m btr_mjx.diagnose --demo` makes a hidden case from a seed and solves it.
With --check it only checks the data, within seconds, and writes nothing: docs/check.md.
With --before EARLIER the question is another one: what has changed since these earlier recordings of the same robot?
See docs/changes.md.

The run folder holds:

    config.json, environment.json   what was asked for, and with which versions and machine
    preflight.csv                   what was found before any fit
    dataset.toml                    what was inferred, where a model and logs were given
    result.json                     verdict, effects with intervals, ranking, gap, next experiment
    ranking.csv, believed.csv, disagreement.csv, *.npz   tables and arrays behind the page
    sets.csv                        with --before: numbers that were named, over the sets of recordings
    next_command.csv                what to command next, where the data cannot distinguish candidates
    mended.xml, mended.json         the believed model with what was found
    parameters.csv, parameters.json, randomisation.json   the same numbers for other programs
    report.html, figures/           the page
    demo/, truth.json               with --demo: the case, and the answer
    search/                         what was simulated so far, until the search ends; --resume goes on from there

The exit code is 0 for every verdict, and 2 for data that are refused.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from btr_mjx.errors import BAD_INPUT_CODE, InputError, cli_errors, is_bad_input, one_line, resume_command
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    atomic_write,
    check_sums,
    claimed_folder,
    content_digest,
    graceful_interrupt,
    progress,
    read_json,
    write_json,
    write_table,
)

if TYPE_CHECKING:
    from btr_mjx.gap.data import Dataset
    from btr_mjx.gap.effects import Effect
    from btr_mjx.gap.fitness_only import FitnessTable
    from btr_mjx.gap.preflight import Finding

JOURNAL = "search"
"""Folder of simulation results in a run folder, from which a search is resumed."""

LONG_READING = 10_000_000
"""Bytes of recordings from which on a bar is shown while they are read."""

STEPS_PER_BUDGET = 2.0
"""Estimated steps of a search per step of its budget, which pays for the windows of one round."""

DEMO_SEEDS = {"hexapod": 0, "quadruped": 3, "arm": 0, "pendulum": 0}
"""Default seeds of `--demo` by robot: hidden cases whose effect is found."""


@dataclass(frozen=True)
class DiagnoseConfig:
    """Settings of a diagnosis; every field is a flag."""

    dataset: Annotated[Path | None, tyro.conf.Positional] = None
    """Folder of the recordings, or the MJCF file of the believed model, followed by logs."""
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Logs of a model that was given as a file, each a recording; or the folder of a LeRobot dataset."""
    before: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Earlier recordings of the same robot, a folder or a log of the same model: say what has changed since. Given
    several times, the oldest first, each set is compared with the one before it."""
    out: Path | None = None
    """Run folder; by default the first unused one of runs/diagnosis-<seed>, runs/diagnosis-<seed>-2, ..."""
    resume: bool = False
    """Continue the run in --out."""
    seed: int | None = None
    """Seed of everything random, 0 unless given; with --demo that of the hidden case, by default one that is named."""
    progress: bool = True
    """Show a progress bar (lines now and then where there is no terminal)."""
    figures: bool = True
    """Draw the page and its figures."""

    check: bool = False
    """Only check the data and the model, without a search and without a run folder."""
    json: bool = False
    """With --check: print the findings as JSON."""

    effects: tuple[str, ...] = ("all",)
    """Effects that may be named: "all", names of the library or of effects of installed packages, or FILE.py:NAME for
    one of your own; "all FILE.py:NAME" adds that to the library."""
    max_effects: int = 5
    """Name at most so many effects."""
    residual: bool = False
    """Fit a smooth table of the force that nothing explains, for mended.json; for robots that touch nothing."""
    signal: Literal["trajectory", "fitness"] = "trajectory"
    """trajectory: recordings of the motion. fitness: a table of controllers and measured fitness, see
    btr_mjx/gap/fitness_only/fitness_table.py."""

    demo: bool = False
    """Make a hidden case from the seed and solve it; the last lines say what was hidden."""
    robot: Literal["hexapod", "pendulum", "quadruped", "arm"] = "hexapod"
    """Robot of the hidden case."""

    @property
    def chosen_seed(self) -> int:
        """The given seed, or the default one."""
        if self.seed is not None:
            return self.seed
        return DEMO_SEEDS[self.robot] if self.demo else 0


def diagnose(config: DiagnoseConfig | None = None, **changes: Any) -> dict[str, Any]:
    """Diagnose a dataset in a run folder.

    Args:
      config: the settings.
      **changes: fields of the config to replace.

    Returns:
      The content of result.json.

    Raises:
      InputError: bad settings or data, or a folder that cannot take this run.
      Interrupted: a signal asked to stop; the run can be resumed.
    """
    return _diagnose(dataclasses.replace(config or DiagnoseConfig(), **changes), lambda result, out: None)


def _diagnose(config: DiagnoseConfig, tell: Callable[[dict[str, Any], Path], None]) -> dict[str, Any]:
    """As `diagnose`; the result and its folder are told once all of it is saved, before anything is drawn."""
    check_diagnosis(config)
    # Loading what a search needs takes seconds: arguments, and then the data, are checked before.
    from btr_mjx.gap.effects import selected_effects

    library = selected_effects(config.effects)
    dataset: Dataset | FitnessTable | None = None
    earlier: list[Dataset] = []
    inputs = {}
    if not config.demo:
        assert config.dataset is not None
        dataset, findings = examine(config.dataset, library, config.signal, config.progress, config.logs)
        from btr_mjx.gap.preflight import refuse_errors

        refuse_errors(findings)
        inputs = {"the dataset": content_digest(dataset)}
        if config.before:
            earlier = _examine_earlier(config, library, dataset)
            inputs["the recordings before"] = content_digest(tuple(earlier))
    from btr_mjx.gap.report import draw_report, print_findings
    from btr_mjx.gap.results import RESULT
    from btr_mjx.pages import PAGE
    from btr_mjx.plotting import attempt

    ignore = (*IGNORED_FIELDS, "figures")
    with _claimed(config) as config:
        assert config.out is not None
        folder = RunFolder.create(config.out, config, config.resume, ignore=ignore, inputs=inputs)
        with folder as run, graceful_interrupt() as stop:
            if dataset is None:
                _make_demo(run.path, config)
                dataset, findings = examine(run.path / "demo", library, config.signal, config.progress)
                stop.checkpoint()
            print_findings(findings)
            rows = [
                dataclasses.asdict(f) | {"evidence": json.dumps(dict(f.evidence)), "lines": "\n".join(f.lines)}
                for f in findings
            ]
            write_table(run.path / "preflight.csv", rows)
            if inferred := getattr(dataset, "inferred", ""):
                with atomic_write(run.path / "dataset.toml") as file:
                    file.write(inferred.encode())
            if RESULT not in check_sums(run.path):
                search_missing(dataset, library, config, run.path, stop.checkpoint, earlier)
                run.seal()
                stop.checkpoint()
            result = read_json(run.path / RESULT)
            tell(result, run.path)
            if config.figures:
                attempt(PAGE, lambda: draw_report(run.path))
            return result


def check_diagnosis(config: DiagnoseConfig) -> None:
    """Check settings.

    Raises:
      InputError: neither or both of a dataset and `demo`, a dataset that does not exist, or `max_effects` below 1.
    """
    if (config.dataset is None) != config.demo:
        what = "no dataset" if config.dataset is None else f"a dataset ({config.dataset}) and --demo"
        raise InputError(f"got {what}; give a folder of recordings, or --demo alone")
    if config.dataset is not None and not config.dataset.exists():
        raise InputError(f"{config.dataset}: there is no such folder")
    if config.check and config.demo:
        raise InputError("got --check and --demo; --check takes a folder of recordings")
    if config.json and not config.check:
        raise InputError("got --json without --check; result.json in the run folder is for scripts")
    if config.logs and config.dataset is not None and config.dataset.is_dir():
        raise InputError(
            f"{config.dataset}: is a folder and logs follow it; give the MJCF file of the robot before them"
        )
    if config.logs and config.signal == "fitness":
        raise InputError("signal: fitness needs a folder with a dataset.toml and its table; got logs")
    if config.before and (config.demo or config.check or config.signal == "fitness"):
        other = "--demo" if config.demo else "--check" if config.check else "--signal fitness"
        raise InputError(
            f"got --before and {other}; --before compares recordings of the motion. Check each set by itself"
        )
    for path in config.before:
        if not path.exists():
            raise InputError(f"--before {path}: there is no such file or folder; give earlier recordings of the robot")
    if config.residual and (config.before or config.signal == "fitness"):
        other = "--before" if config.before else "--signal fitness"
        raise InputError(f"got --residual and {other}; --residual is for a diagnosis of one set of recordings")
    if not 1 <= config.max_effects <= 100:
        raise InputError(f"max_effects: got {config.max_effects}, expected at least 1, at most 100")
    if not 0 <= config.chosen_seed < 2**63:
        raise InputError(f"seed: got {config.chosen_seed}, expected 0 or more, below 2**63")


def _claimed(config: DiagnoseConfig) -> AbstractContextManager[DiagnoseConfig]:
    """The config with its seed and its run folder filled in; see `claimed_folder`."""
    config = dataclasses.replace(config, seed=config.chosen_seed)
    return claimed_folder(config, f"{'demo' if config.demo else 'diagnosis'}-{config.seed}")


def examine(
    folder: Path, library: "Sequence[Effect]", signal: str, show: bool = False, logs: Sequence[Path] = ()
) -> "tuple[Dataset | FitnessTable, list[Finding]]":
    """Read a dataset and check it before any fit.

    Args:
      folder: of the dataset, or a file: its dataset.toml, or the model that `logs` are of.
      library: effects that may be named.
      signal: "trajectory" or "fitness", see `DiagnoseConfig.signal`.
      show: show a progress bar while a long dataset is read.
      logs: files of recordings.

    Returns:
      The dataset, and the findings of the preflight checks.

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
        if bar is not None:
            bar.set_description("checks")
        from btr_mjx.gap.preflight import preflight

        return dataset, preflight(dataset, [effect.name for effect in library])


def _examine_earlier(config: DiagnoseConfig, library: "Sequence[Effect]", dataset: Any) -> "list[Dataset]":
    """Read and check the recordings of --before, the oldest first.

    Raises:
      InputError: one of them cannot be read or used, or is of another robot; it names the set.
    """
    from btr_mjx.gap.data import DATASET_FILE
    from btr_mjx.gap.fitness_only import FitnessTable
    from btr_mjx.gap.forces import check_same_robot
    from btr_mjx.gap.preflight import refuse_errors
    from btr_mjx.gap.report import print_findings

    assert config.dataset is not None
    earlier: list[Dataset] = []
    for path in config.before:
        described = path.is_dir() and ((path / DATASET_FILE).is_file() or any(path.glob("*.xml")))
        alone = path.name == DATASET_FILE or described or not config.logs
        # Logs without a model of their own are of the model that was given.
        folder, logs = (path, ()) if alone else (config.dataset, (path,))
        try:
            own, findings = examine(folder, library, config.signal, config.progress, logs)
            refuse_errors(findings)
            assert not isinstance(own, FitnessTable)  # refused with --before
            check_same_robot(own, dataset)
        except Exception as error:
            if not is_bad_input(error):
                raise
            raise InputError(f"--before {path}: {one_line(error)}") from error
        print_findings(findings, str(path))
        earlier.append(own)
    return earlier


def check_data(config: DiagnoseConfig) -> bool:
    """Check a dataset and print the findings.

    Args:
      config: the settings.

    Returns:
      Whether the data can be used.

    Raises:
      InputError: the dataset cannot be read; with `json` it is printed as a finding instead.
    """
    from btr_mjx.gap.effects import selected_effects
    from btr_mjx.gap.preflight import Finding

    assert config.dataset is not None
    library = selected_effects(config.effects)
    try:
        _, findings = examine(config.dataset, library, config.signal, config.progress and not config.json, config.logs)
    except Exception as error:
        if not (config.json and is_bad_input(error)):
            raise
        findings = [Finding("error", "loading", one_line(error))]
    usable = all(finding.level != "error" for finding in findings)
    if config.json:
        found = [dataclasses.asdict(f) | {"evidence": dict(f.evidence)} for f in findings]
        print(json.dumps({"dataset": str(config.dataset), "usable": usable, "findings": found}, indent=2))
    else:
        from btr_mjx.gap.report import print_findings

        print_findings(findings)
        print("the data can be used" if usable else "refused: the errors above have to be mended")
    return usable


def search_missing(
    dataset: "Dataset | FitnessTable",
    library: "Sequence[Effect]",
    config: DiagnoseConfig,
    folder: Path,
    checkpoint: Callable[[], None] = lambda: None,
    earlier: "Sequence[Dataset]" = (),
) -> None:
    """Search for missing effects, or for what has changed, and write all files from which the report is drawn.

    Args:
      dataset: the recordings, or the table of measured fitness.
      library: effects that may be named.
      config: the settings.
      folder: the run folder.
      checkpoint: called often; raises Interrupted to stop the search.
      earlier: recordings of the same robot before these, the oldest first.
    """
    from btr_mjx.gap.effects import custom_effect_code, of_forces
    from btr_mjx.gap.experiments import propose
    from btr_mjx.gap.fitness_only import FitnessTable, expected_steps, identify_fitness
    from btr_mjx.gap.forces import identify_changes
    from btr_mjx.gap.inference import identify
    from btr_mjx.gap.results import as_result, before_entry, save_diagnosis, save_quantities
    from btr_mjx.gap.simulate import Journal
    from btr_mjx.gap.windows import Options

    if isinstance(dataset, FitnessTable):
        total = expected_steps(dataset, library)
    else:
        total = (1 + len(earlier)) * STEPS_PER_BUDGET * Options().budget(dataset.model.nv)
    with progress(
        total=round(total), description="search", unit="steps", unit_scale=True, show=config.progress or False
    ) as bar:

        def report_stage(stage: str) -> None:
            bar.set_description(stage)
            checkpoint()

        def count(steps: int) -> None:
            if bar.total is not None and steps > bar.total:
                bar.total = None  # more than was estimated: nothing is known of the time left
            bar.update(steps - bar.n)
            checkpoint()

        journal = Journal(folder / JOURNAL, count, custom_effect_code(config.effects))
        more: dict[str, Any] = {"seed": config.chosen_seed, "signal": config.signal}
        if isinstance(dataset, FitnessTable):
            diagnosis, data, proposal = (
                identify_fitness(dataset, library, report_stage, counter=journal),
                dataset.head,
                None,
            )
            more["gap"] = as_result(diagnosis, data)["gap"] | {"unit": "m/s of Delta_fitness"}
        else:
            if earlier:
                sets = [*earlier, dataset]
                found = identify_changes(sets, library, config.max_effects, report_stage, journal)
                diagnosis = found.diagnoses[-1]
                said: list[dict[str, Any]] = []
                for one, own in zip(found.diagnoses[:-1], earlier, strict=True):
                    said.append(before_entry(one, own, said[-1] if said else None))
                more |= {"before": said[-1], "sets": said}
                save_quantities(folder, found.quantities, [own.folder.name for own in sets])
            else:
                diagnosis = identify(
                    dataset,
                    library,
                    config.max_effects,
                    config.chosen_seed,
                    report_stage,
                    counter=journal,
                    residual=config.residual,
                )
            report_stage("next experiment")
            data, proposal = dataset, propose(diagnosis, dataset, config.chosen_seed, counter=journal)
        bar.total = bar.n
    save_diagnosis(diagnosis, data, folder, effects=sum(of_forces(library), ()), next_experiment=proposal, more=more)
    journal.close()


def _make_demo(folder: Path, config: DiagnoseConfig) -> None:
    """Make the hidden case; the same one again on resume, so that damaged files of it do no harm."""
    from btr_mjx.demo import make_demo, make_fitness_demo

    case = make_fitness_demo if config.signal == "fitness" else make_demo
    write_json(folder / "truth.json", case(folder / "demo", config.chosen_seed, config.robot))


def _silence_mujoco() -> None:
    """No messages of MuJoCo: unstable candidates are handled and reported by checks and search."""
    import mujoco

    mujoco.set_mju_user_warning(lambda _: None)


def _print_all(config: DiagnoseConfig, result: dict[str, Any], out: Path) -> None:
    from btr_mjx.gap.report import print_result, print_truth

    print_result(result, out, config.figures)
    if config.demo:
        print_truth(read_json(out / "truth.json"))
    sys.stdout.flush()


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    argv = sys.argv[1:] if argv is None else list(argv)
    config = tyro.cli(DiagnoseConfig, args=list(argv), description=__doc__, prog="btr_mjx.diagnose")
    if config.check:
        check_diagnosis(config)
        _silence_mujoco()
        if not check_data(config):
            raise SystemExit(BAD_INPUT_CODE)
        return
    with _claimed(config) as config:
        check_diagnosis(config)
        _silence_mujoco()
        with cli_errors(resume_command("btr_mjx.diagnose", argv, config.out)):
            _diagnose(config, partial(_print_all, config))


if __name__ == "__main__":
    main()
