"""Name the effect that a simulation lacks: `python -m btr_mjx.diagnose MODEL.xml LOG [LOG ...] --out RUN`.

MODEL.xml is the MJCF of the believed robot; a LOG is a CSV, Parquet, NPZ, HDF5, MCAP, rosbag2 or .pt file, see
docs/logs.md, or the folder of a LeRobot dataset. A folder may stand for both: one that holds them, one with a
dataset.toml (docs/gap.md), or with BAM's JSON beside a servo.toml.
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
    diagnosis.rrd, diagnosis.mcap   with --export: measured and simulated motions for Rerun and Foxglove
    demo/, truth.json               with --demo: the case, and the answer
    search/                         what was simulated so far, until the search ends; --resume goes on from there

The exit code is 0 for every verdict, and 2 for data that are refused.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from btr_mjx.errors import BAD_INPUT_CODE, InputError, cli_errors, is_bad_input, one_line, resume_command
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    check_sums,
    claimed_folder,
    content_digest,
    graceful_interrupt,
    parsed,
    progress,
    read_json,
    write_json,
    write_text,
)

if TYPE_CHECKING:
    from btr_mjx.gap.data import Dataset
    from btr_mjx.gap.fitness_only import FitnessTable

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
    """Show progress and remarks (lines now and then where there is no terminal). --quiet is another name of
    --no-progress: the result, warnings and errors only."""
    figures: bool = True
    """Draw the page and its figures."""
    export: tuple[Literal["rerun", "mcap"], ...] = ()
    """Write what is measured and simulated for a viewer of recordings as well, see docs/exports.md. rerun:
    diagnosis.rrd, for Rerun. mcap: diagnosis.mcap, for Foxglove and others. Both need the extra of the same name."""

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
    """trajectory: recordings of the motion. fitness: a table of controllers and measured fitness, see docs/gap.md."""

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
      **changes: fields of the config to replace; a text may stand for a path.

    Returns:
      The content of result.json.

    Raises:
      InputError: bad settings or data, or a folder that cannot take this run.
      Interrupted: a signal asked to stop; the run can be resumed.
    """
    from btr_mjx.backtoreality import typed_settings

    changes = typed_settings(DiagnoseConfig, changes)
    return _diagnose(dataclasses.replace(config or DiagnoseConfig(), **changes), lambda result, out: None)


def _diagnose(config: DiagnoseConfig, tell: Callable[[dict[str, Any], Path], None]) -> dict[str, Any]:
    """As `diagnose`; the result and its folder are told once all of it is saved, before anything is drawn."""
    check_diagnosis(config)
    # What a resumed run needs is in complete files: a signal may stop it anywhere.
    with graceful_interrupt() as stop, stop.anywhere():
        return _run(config, tell, stop.checkpoint)


def _run(
    config: DiagnoseConfig, tell: Callable[[dict[str, Any], Path], None], checkpoint: Callable[[], None]
) -> dict[str, Any]:
    # Loading what a search needs takes seconds: arguments, and then the data, are checked before.
    from btr_mjx.gap import examine, examine_earlier, search_missing
    from btr_mjx.gap.effects import custom_effect_code, selected_effects
    from btr_mjx.gap.preflight import refuse_errors, save_findings

    library = selected_effects(config.effects)
    dataset: Dataset | FitnessTable | None = None
    earlier: list[Dataset] = []
    inputs = {}
    if not config.demo:
        assert config.dataset is not None
        dataset, findings = examine(config.dataset, library, config.signal, config.progress, config.logs)
        refuse_errors(findings)
        inputs = {"the dataset": content_digest(dataset)}
        if config.before:
            model = config.dataset if config.logs else None
            earlier = examine_earlier(config.before, dataset, model, library, config.progress)
            inputs["the recordings before"] = content_digest(tuple(earlier))
    from btr_mjx.gap.report import draw_report, print_findings
    from btr_mjx.gap.results import RESULT
    from btr_mjx.pages import PAGE
    from btr_mjx.plotting import attempt
    from btr_mjx.replays import export_motions

    ignore = (*IGNORED_FIELDS, "figures", "export")
    with _claimed(config) as config:
        assert config.out is not None
        folder = RunFolder.create(config.out, config, config.resume, ignore=ignore, inputs=inputs)
        with folder as run:
            if dataset is None:
                _make_demo(run.path, config)
                dataset, findings = examine(run.path / "demo", library, config.signal, config.progress)
            print_findings(findings, notes=config.progress)
            save_findings(findings, run.path / "preflight.csv")
            if inferred := getattr(dataset, "inferred", ""):
                write_text(run.path / "dataset.toml", inferred)
            if RESULT not in check_sums(run.path):
                search_missing(
                    dataset,
                    library,
                    run.path,
                    earlier=earlier,
                    seed=config.chosen_seed,
                    max_effects=config.max_effects,
                    residual=config.residual,
                    code=custom_effect_code(config.effects),
                    show=config.progress,
                    checkpoint=checkpoint,
                )
                run.seal()
            result = read_json(run.path / RESULT)
            tell(result, run.path)
            if config.figures:
                with progress(description=PAGE, show=config.progress, bar_format="drawing {desc}"):
                    attempt(PAGE, lambda: draw_report(run.path))
            for path in export_motions(run.path, config.export):
                print(path, flush=True)
            return result


def check_diagnosis(config: DiagnoseConfig) -> None:
    """Check settings.

    Raises:
      InputError: neither or both of a dataset and `demo`, a dataset that does not exist, an export whose package is not
        installed, or `max_effects` below 1.
    """
    if (config.dataset is None) != config.demo:
        what = "no dataset" if config.dataset is None else f"a dataset ({config.dataset}) and --demo"
        raise InputError(f"got {what}; give MODEL.xml and its LOGS, a folder of both, or --demo alone")
    if config.dataset is not None and not config.dataset.exists():
        raise InputError(f"{config.dataset}: there is no such file or folder")
    if config.check and config.demo:
        raise InputError("got --check and --demo; --check takes a folder of recordings")
    if config.json and not config.check:
        raise InputError("got --json without --check; result.json in the run folder is for scripts")
    if config.logs and config.dataset is not None and config.dataset.is_dir():
        remedy = "give the MJCF file of the robot before them"
        raise InputError(f"{config.dataset}: is a folder and logs follow it; {remedy}")
    if config.logs and config.signal == "fitness":
        raise InputError("signal: fitness needs a folder with a dataset.toml and its table; got logs")
    others = {"--demo": config.demo, "--check": config.check, "--signal fitness": config.signal == "fitness"}
    if config.before and (other := next((flag for flag, given in others.items() if given), "")):
        why = "--before compares recordings of the motion. Check each set by itself"
        raise InputError(f"got --before and {other}; {why}")
    for path in config.before:
        if not path.exists():
            raise InputError(f"--before {path}: there is no such file or folder; give earlier recordings of the robot")
    if config.residual and (config.before or config.signal == "fitness"):
        other = "--before" if config.before else "--signal fitness"
        raise InputError(f"got --residual and {other}; --residual is for a diagnosis of one set of recordings")
    if config.export and config.signal == "fitness":
        raise InputError("got --export and --signal fitness; a table of fitness holds no motion")
    if config.export:
        from btr_mjx.replays import check_exports

        check_exports(config.export)
    if not 1 <= config.max_effects <= 100:
        raise InputError(f"max_effects: got {config.max_effects}, expected at least 1, at most 100")
    if not 0 <= config.chosen_seed < 2**63:
        raise InputError(f"seed: got {config.chosen_seed}, expected 0 or more, below 2**63")


def _claimed(config: DiagnoseConfig) -> AbstractContextManager[DiagnoseConfig]:
    """The config with its seed and its run folder filled in; see `claimed_folder`."""
    config = dataclasses.replace(config, seed=config.chosen_seed)
    return claimed_folder(config, f"{'demo' if config.demo else 'diagnosis'}-{config.seed}")


def check_data(config: DiagnoseConfig) -> bool:
    """Check a dataset, print the findings, and say whether the data can be used.

    Raises:
      InputError: the dataset cannot be read; with `json` it is printed as a finding instead.
    """
    from btr_mjx.gap import examine
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
        found = [dataclasses.asdict(finding) for finding in findings]
        print(json.dumps({"dataset": str(config.dataset), "usable": usable, "findings": found}, indent=2))
    else:
        from btr_mjx.gap.report import print_findings

        print_findings(findings)
        print("the data can be used" if usable else "refused: the errors above have to be mended")
    return usable


def _make_demo(folder: Path, config: DiagnoseConfig) -> None:
    """Make the hidden case; the same one again on resume, so that damaged files of it do no harm."""
    from btr_mjx.demo import make_demo, make_fitness_demo

    case = make_fitness_demo if config.signal == "fitness" else make_demo
    write_json(folder / "truth.json", case(folder / "demo", config.chosen_seed, config.robot))


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
    config = parsed(DiagnoseConfig, argv, description=__doc__, prog="btr_mjx.diagnose")
    check_diagnosis(config)
    with nullcontext(config) if config.check else _claimed(config) as config:
        import mujoco

        mujoco.set_mju_user_warning(lambda _: None)  # checks and the search report unstable candidates
        if config.check:
            if not check_data(config):
                raise SystemExit(BAD_INPUT_CODE)
            return
        with cli_errors(resume_command("btr_mjx.diagnose", argv, config.out)):
            _diagnose(config, partial(_print_all, config))


if __name__ == "__main__":
    main()
