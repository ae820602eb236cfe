"""Delta_fitness over a line of simulations: `python -m btr_mjx.scan --parameter bl_14 --grid 49`.

A robot of your own: `python -m btr_mjx.scan --robot my_robot/robot.toml --parameter "trunk mass"`. In a notebook:

    robot = btr.hexapod()
    line = btr.scan.along(robot, "bl_14", 49)                       # (49, 12) simulations
    f_r = btr.evaluate(robot, [truth], controllers).fitness[0]
    btr.scan.delta_fitness(robot, line, controllers, f_r)           # (49,)

One compiled program serves any number of simulations and controllers; what is compiled for one scan serves the next.

The run folder of the command holds scan.npz (parameter, grid, truth, controllers, fitness, f_r, delta, delta_fitness),
result.json (the statistics), report.html with scan.png, and in blocks/ the fitness of blocks of pairs, written as they
are done: a scan that was killed continues with --resume. With --cluster the blocks are computed on a Dask cluster
(docs/scaling.md).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from btr_mjx.backtoreality import (
    ScanConfig,
    along,
    build_scan,
    curve_statistics,
    delta,
    delta_fitness,
    keep_inputs,
    run_scan,
    with_engine_of_folder,
    with_measured_engine,
)
from btr_mjx.errors import InputError, cli_errors, resume_command
from btr_mjx.gap.results import format_number
from btr_mjx.models import robot_digest
from btr_mjx.pages import PAGE, draw_run_page
from btr_mjx.plotting import attempt
from btr_mjx.runs import (
    IGNORED_FIELDS,
    RunFolder,
    content_digest,
    parsed,
    progress,
    say_progress,
    write_arrays,
    write_json,
)

__all__ = ["ScanConfig", "along", "curve_statistics", "delta", "delta_fitness", "main", "run_scan"]


@cli_errors()
def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    config = parsed(ScanConfig, argv, description=__doc__, prog="btr_mjx.scan")
    resume = None if config.out is None else resume_command("btr_mjx.scan", argv)
    with cli_errors(resume):
        if config.resume and config.out is None:
            raise InputError("--resume: say which scan to continue with --out FOLDER")
        config = with_engine_of_folder(config)
        scan = build_scan(config)
        evolved = 0 if config.behaviours == "random" else config.controllers * config.generations
        total = evolved + config.trials * (config.grid + 1)
        batch = config.trials * config.grid
        if config.out is None:
            config = with_measured_engine(config, scan.robot, total, batch, lambda settled: None)
            _print_result(config, *_with_bar(config, total))
            return
        ignore = (*IGNORED_FIELDS, "cluster", "figures")
        inputs = {
            "the robot": robot_digest(scan.robot),
            "the fitness function": content_digest(scan.fitness),
        }
        with RunFolder.create(config.out, config, config.resume, ignore=ignore, inputs=inputs) as run:
            keep_inputs(run.path, config, scan.robot)
            config = with_measured_engine(config, scan.robot, total, batch, run.settle)
            arrays, result = _with_bar(config, total)
            write_arrays(run.path / "scan.npz", arrays)
            write_json(run.path / "result.json", result)
            run.seal()
            _print_result(config, arrays, result)
            if config.figures:
                attempt(PAGE, lambda: draw_run_page(run.path))


def _print_result(config: ScanConfig, arrays: dict[str, np.ndarray], result: dict[str, Any]) -> None:
    print(f"{arrays['parameter']}: {arrays['delta'].shape[1]} behaviours, {config.grid} simulations")
    for name, value in result.items():
        text = format_number(value, 4) if isinstance(value, float) else "-" if value is None else value
        print(f"  {name:20} {text}")
    if config.out is not None:
        print(f"all files in {config.out}", flush=True)


def _with_bar(config: ScanConfig, total: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    with progress(total=total, description="scan", unit="pairs", show=config.progress) as bar:
        say_progress(bar, "scan (compiling)", numbers=False)

        def update(pairs: int) -> None:
            if bar.bar_format:  # the first pairs are done
                say_progress(bar, "scan")
            bar.update(pairs)

        return run_scan(config, update)


if __name__ == "__main__":
    main()
