"""Co-evolve a robot and its simulation: `python -m btr_mjx.coevolve`.

A hidden simulation plays reality, or a robot is reached through files (--reality folder). A robot of your own:

    python -m btr_mjx.coevolve --robot my_robot/robot.toml --truth "trunk mass=3.6" --out runs/mine

The run folder holds:

    config.json, environment.json   what was asked for, and with which versions and machine
    inputs.json, SHA256SUMS         digests of the robot and the reality, and of all data files
    inputs/                         copies of the robot's files, from which the run is shown and continued
    generations.csv                 one row per generation of either search
    iterations.csv                  one row per iteration of Back-to-Reality
    trials.npz                      every evaluation in reality: controllers, f_r, f_s, iteration
    controllers-001.npz, ...        all controllers of step 1 of iteration 1: parameters and fitness in simulation
    simulations-001.npz, ...        all simulations of step 3 of iteration 1: unknown parameters and Delta_fitness
    result.json                     the numbers that a script wants
    simulation.xml                  the identified simulation as MJCF
    parameters.csv, parameters.json the identified parameters for other programs
    report.html, *.png              page and figures, drawn from these files

The exit code is 0 for a run that has ended, 75 for one that waits for measurements in --exchange (go on with --resume),
2 for bad input and 130 after an interrupt.
"""

import dataclasses
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from btr_mjx.backtoreality import (
    PRESETS,
    CoevolveConfig,
    Waiting,
    begin,
    build_problem,
    export_coevolution,
    export_simulation,
    inputs_of,
    keep_inputs,
    run_in_folder,
    setting_of_robot,
    summarise,
    summary_table,
    typed_settings,
    whole_trials,
    with_engine_of_folder,
    with_measured_engine,
)
from btr_mjx.errors import WAITING_CODE, Interrupted, cli_errors, resume_command
from btr_mjx.models import base_model
from btr_mjx.pages import PAGE, draw_run_page
from btr_mjx.plotting import attempt
from btr_mjx.robots import Robot
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    claimed_folder,
    graceful_interrupt,
    note,
    parsed,
    write_arrays,
    write_json,
)


def coevolve(robot: Robot | Path | str | None = None, **settings: Any) -> dict[str, Any]:
    """Run Back-to-Reality in a run folder, as the command does.

    Args:
      robot: a robot, or a robot.toml that describes one; None for the hexapod of the paper.
      **settings: fields of `CoevolveConfig`, the flags of the command; `preset` chooses the defaults of the others.
        `truth` may be a mapping of names to values.

    Returns:
      The content of result.json.

    Raises:
      InputError: bad settings, or a folder that cannot take this run.
      Waiting: measurements are missing in the exchange folder; continue with `resume` when they are there.
      Interrupted: a signal asked to stop; everything up to the last generation is saved.
    """
    own = robot if isinstance(robot, Robot) else None
    if robot is not None:
        settings = (setting_of_robot(robot) if isinstance(robot, Robot) else {"robot": robot}) | settings
    if isinstance(truth := settings.get("truth"), Mapping):
        settings["truth"] = [f"{name}={value}" for name, value in truth.items()]
    settings = typed_settings(CoevolveConfig, settings)
    with _claimed(dataclasses.replace(PRESETS[settings.get("preset", "quick")], **settings)) as config:
        say = note if config.progress else lambda line: None
        try:
            return run_config(config, own, lambda result, out: say(f"all files in {out}"))
        except Interrupted as error:
            raise Interrupted(f"{error}; go on with out={str(config.out)!r}, resume=True", error.signum) from None


def run_config(
    config: CoevolveConfig,
    robot: Robot | None = None,
    tell: Callable[[dict[str, Any], Path], None] = lambda result, out: None,
) -> dict[str, Any]:
    """Run Back-to-Reality with the settings of a config; see `coevolve`.

    Args:
      config: the settings.
      robot: the robot where the config does not name a file, see `build_problem`.
      tell: called with the result and its folder once all of it is saved, before anything is drawn.
    """
    with _claimed(config) as config:
        config = with_engine_of_folder(config)
        assert config.out is not None
        problem = build_problem(config, robot)
        # Bad input raises its error before anything is written.
        begin(problem)
        base_model(problem.robot)
        folder = RunFolder.create(
            config.out, config, config.resume, ignore=(*IGNORED_FIELDS, "figures", "wait"), inputs=inputs_of(problem)
        )
        with folder as run, graceful_interrupt() as stop:
            keep_inputs(run.path, config, problem.robot, problem.reality)
            batch = config.simulations * config.trials
            config = with_measured_engine(config, problem.robot, whole_trials(problem), batch, run.settle)
            problem = build_problem(config, robot)
            state = run_in_folder(problem, run, stop, config.progress, config.wait)
            result = summarise(problem, state)
            write_arrays(run.path / "trials.npz", vars(state.trials))
            write_json(run.path / "result.json", result)
            export_simulation(run.path, problem, state)
            export_coevolution(run.path)
            run.seal()
            tell(result, run.path)
            if config.figures:
                attempt(PAGE, lambda: draw_run_page(run.path))
    return result


def _claimed(config: CoevolveConfig) -> AbstractContextManager[CoevolveConfig]:
    return claimed_folder(config, f"{config.preset}-{config.seed}")


def parse(argv: Sequence[str]) -> CoevolveConfig:
    """The config of a command line; --preset chooses the defaults of all other flags."""
    chosen = "quick"
    for position, word in enumerate(argv):
        if word == "--preset" and position + 1 < len(argv):
            chosen = argv[position + 1]
        elif word.startswith("--preset="):
            chosen = word.removeprefix("--preset=")
    default = PRESETS.get(chosen, PRESETS["quick"])  # for another value, the error names the valid ones
    return parsed(CoevolveConfig, argv, default=default, description=__doc__, prog="btr_mjx.coevolve")


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    argv = sys.argv[1:] if argv is None else list(argv)
    with _claimed(parse(argv)) as config:
        resume = resume_command("btr_mjx.coevolve", argv, config.out)
        try:
            with cli_errors(resume):
                run_config(config, tell=lambda result, out: print(summary_table(result, out), flush=True))
        except Waiting as waiting:
            print("\n".join([*waiting.complaints, str(waiting), f"then go on with: {resume}"]))
            raise SystemExit(WAITING_CODE) from None


class _CallableModule(types.ModuleType):
    """Makes this module callable, since `btr_mjx.coevolve` is both the module and a public function."""

    def __call__(self, *args: Any, **settings: Any) -> dict[str, Any]:
        return coevolve(*args, **settings)


if __name__ == "__main__":
    main()
else:
    sys.modules[__name__].__class__ = _CallableModule
