"""Blind cases of the missing-effect workflow: `uv run python benchmarks/blind_gap.py --cases 300 --json FILE`.

One process makes a case and writes data and truth into separate folders. Another process solves it: it reads the data
only, and writes its answer before anything reads the truth. Then the detectability of the true effect is computed: its
gain at the true parameters, on the same windows.

Every case is a file of its own: the same command continues a killed benchmark.
"""

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import gap_scores as scores
import mujoco
import numpy as np
import tyro
from case_runs import Files, on_cluster, scheduled
from hidden_cases import PER_JOINT_EFFECTS, CaseSettings, Truth, case_robot, make_case

from btr_mjx.cluster import check_cluster
from btr_mjx.errors import cli_errors
from btr_mjx.gap.data import load
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench, identify, nearest
from btr_mjx.gap.results import as_result
from btr_mjx.runs import describe_environment, progress, read_json, to_plain, write_json, write_table

MIXED = ("hexapod", "hexapod", "hexapod", "quadruped", "arm", "pendulum")
"""Robots of a mixed benchmark, in turn."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: int = 300
    """Number of cases."""
    seed: int = 0
    """Seed of the cases."""
    robot: Literal["hexapod", "pendulum", "quadruped", "arm", "mixed"] = "hexapod"
    """Robot of the cases; mixed takes all in turn."""
    effects: int = 1
    """Number of missing effects in a case with effects of the library: 1 or 2."""
    each: bool = False
    """Only friction, damping and inertia of motors, with a number of their own for every joint."""
    only_effects: bool = False
    """Only cases with effects of the library: no nulls, nothing outside the library."""
    workers: int = 1
    """Number of processes that make cases, and of those that solve them; several solvers get one core each."""
    cluster: str | None = None
    """Use a Dask cluster whose workers see the same files: local:N, tcp://HOST:PORT or file:SCHEDULER.json."""
    out: Path | None = None
    """Folder of the files; by default runs/blind_gap-<robot>-<effects>-<seed>."""
    json: Path | None = None
    """Also write the numbers to this file."""
    duration: float | None = None
    """Another duration of the recordings [s], for a quick look."""
    oracle: bool = True
    """Compute detectability from the windows of the search; without it, from `Truth.visible`."""


def make(config: Config, files: Files) -> None:
    """Make a case and write its truth."""
    robot = MIXED[files.index % len(MIXED)] if config.robot == "mixed" else config.robot
    seed = int(np.random.SeedSequence([config.seed, files.index]).generate_state(1)[0])
    temporary = Path(tempfile.mkdtemp(prefix=f".{files.name}.", dir=_created(files.data.parent)))
    truth: Truth = make_case(
        temporary,
        seed,
        robot,
        CaseSettings(
            verdict="effect" if config.only_effects or config.each else None,
            effects=(PER_JOINT_EFFECTS[files.index % len(PER_JOINT_EFFECTS)],) if config.each else config.effects,
            each=config.each,
            duration=config.duration,
        ),
    )
    shutil.rmtree(files.data, ignore_errors=True)
    temporary.rename(files.data)
    write_json(files.truth, truth)


def _created(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def solve(data: Path) -> dict[str, Any]:
    """The answer to a case from its data alone, as a user gets it.

    Args:
      data: folder of the dataset.
    """
    dataset = load(data)
    diagnosis = identify(dataset)
    result = as_result(diagnosis, dataset)
    others = [
        row
        for row in result["ranking"]
        if not row["beside"] and f"{row['effect']}@{row['location']}" not in diagnosis.equivalent
    ]
    best = result["ranking"][0]["score"] if result["ranking"] else 0.0
    keys = ("verdict", "effects", "equivalent", "unexplained", "share", "lack_of_fit", "steps", "seconds")
    answer = (
        {key: result[key] for key in keys}
        | {"gap": result["chi2"], "misfit": result["misfit"]}
        | {"ranking": result["ranking"][:10], "best_score": best}
    )
    return answer | {"margin": best - others[0]["score"] if others and result["ranking"] else None}


def score_truth(config: Config, files: Files) -> None:
    """Write gain and score of the hidden effects at their true parameters, each of a pair beside the other.

    Args:
      config: settings of the benchmark.
      files: files of the case.
    """
    truth = read_json(files.truth)
    missing = truth["effects"]
    gains: list[float] = []
    gain_scores: list[float] = []
    if missing and config.oracle:
        bench = Bench(load(files.data), EFFECTS)
        found = {candidate.name: candidate for candidate in bench.candidates}
        model = bench.dataset.model
        added = []
        for one in missing:
            names = [c for c in found if c.split("@")[0] == one["effect"]]
            match = [c for c in names if scores.same_place(model, c.partition("@")[2], one["location"])]
            match.sort(
                key=lambda c: c.partition("@")[2] != one["location"]
            )  # the same place first: ground friction of one foot is another candidate than of all
            if match:
                candidate = found[match[0]]
                values = scores.true_values(model, one, [p.name for p in candidate.parameters])
                added.append((candidate, np.array(values)))
        if len(added) == len(missing):
            gains, gain_scores = _true_gains(bench, added)
    elif missing:
        gains = gain_scores = [float(truth["visible"])]
    write_json(files.oracle, {"gains": gains, "scores": gain_scores})


def _true_gains(bench: Bench, added: list[Any]) -> tuple[list[float], list[float]]:
    """Gains and scores of effects at given values, each beside the others.

    Starting states are estimated with each hypothesis, with and without the effect; every hypothesis uses the best of
    these for each window.

    Args:
      bench: bench of the search.
      added: candidates with their values.

    Returns:
      Falls of the loss, summed over both sides of the split, without a bound on the contribution of a window; and
      scores as in the search, with bounded contributions, less the price of the parameters.
    """
    several = [added, *([a for a in added if a is not one] for one in added)]
    hypotheses = []
    for some in several:
        hypothesis = bench.base
        for candidate, values in some:
            hypothesis = hypothesis.with_effect(candidate, values)
        hypotheses.append(hypothesis)
    contact_sensitive = any(candidate.name in bench.contact_sensitive for candidate, _ in added)
    plain, robust = np.zeros(len(added)), np.zeros(len(added))
    for side, free in ((bench.fit, bench.free), (bench.test, bench.nuisance)):
        centres = [side.with_fitted_states(hypothesis) for hypothesis in hypotheses]
        if contact_sensitive:
            centres += [own.with_own_directions(h) for own, h in zip(centres, hypotheses, strict=True)]
        fits = []
        for hypothesis in hypotheses:
            own = nearest([centre.based(hypothesis) for centre in centres])
            fits.append(free(own, hypothesis).profile(own.windows.residual, bench.cut))
        for i, ((candidate, _), without) in enumerate(zip(added, fits[1:], strict=True)):
            plain[i] += (without.loss - fits[0].loss) / bench.dispersion
            robust[i] += bench.fall(without, fits[0], even=candidate.name not in bench.contact_sensitive)
    price = np.log(bench.fit.windows.residual.size + bench.test.windows.residual.size)
    numbers = np.array([len(values) for _, values in added])
    return plain.tolist(), (robust - price * numbers).tolist()


def work(config: Config, files: Files) -> None:
    """Solve a case, then compute the detectability of its truth."""
    if not files.answer.is_file():
        write_json(files.answer, solve(files.data))
    score_truth(config, files)
    shutil.rmtree(files.data, ignore_errors=True)


def run(config: Config, folder: Path) -> Iterator[int]:
    """Make and solve the remaining cases; yields the index of every case that is done."""
    left = []
    for index in range(config.cases):
        if Files(folder, index).oracle.is_file():
            yield index
        else:
            left.append(Files(folder, index))
    steps = (partial(make, config), partial(work, config))
    if config.cluster is None:
        yield from scheduled(left, *steps, config.workers, folder / "failed")
    else:
        yield from on_cluster(left, *steps, config.cluster, folder / "failed")


def table(folder: Path, cases: int) -> list[dict[str, Any]]:
    """Rows of the cases that are done."""
    models: dict[str, mujoco.MjModel] = {}
    rows = []
    for index in range(cases):
        files = Files(folder, index)
        if not files.oracle.is_file():
            continue
        truth = read_json(files.truth)
        name = truth["robot"]
        models.setdefault(name, case_robot(name).model)
        case = {"truth": truth, "answer": read_json(files.answer), "oracle": read_json(files.oracle)}
        rows.append({"case": index, **scores.judge(models[name], case)})
    return rows


def show(numbers: Mapping[str, Any], rows: list[dict[str, Any]]) -> None:
    """Print the aims, further shares, and the table of hidden against reported verdicts."""
    print(f"{'':32}{'measured':>12}{'bar':>12}")
    for name, bar in scores.bars(numbers).items():
        value = "-" if bar["measured"] is None else f"{bar['measured']:.4g}"
        print(
            f"{name:32}{value:>12}{bar['bar']:>12}  {'' if bar['met'] is None else 'met' if bar['met'] else 'NOT MET'}"
        )
    shares = (
        "right_or_lag_for_delay",
        "scoring",
        "right_of_scoring",
        "in_set_of_scoring",
        "right_of_all_effects",
        "false_names",
        "outside_flagged",
    )
    sets = ("truth_named_or_not_ruled_out", "nulls_with_something_listed", "set_size_mean")
    pairs = ("pairs_detectable", "pairs_or_lag_for_delay")
    for name in ("cases", "detectable", "undetectable_share", *shares, *sets, *pairs):
        value = numbers[name]
        print(f"{name:32}{'-' if value is None else format(value, '.4g'):>12}")
    print(f"\n{'hidden':24}{'said':24}{'cases':>6}")
    for entry in scores.confusion(rows):
        print(f"{entry['hidden']:24}{entry['said']:24}{entry['cases']:6d}")


def main() -> None:
    """Entry point."""
    config = tyro.cli(Config, description=__doc__)
    with cli_errors():
        if config.cluster is not None:
            check_cluster(config.cluster)
        folder = config.out or Path("runs") / f"blind_gap-{config.robot}-{config.effects}-{config.seed}"
        folder = folder.absolute()  # workers may run in another folder
        unrelated = ("cases", "workers", "cluster", "out", "json")
        key = {k: v for k, v in to_plain(config).items() if k not in unrelated}
        if (folder / "config.json").is_file() and read_json(folder / "config.json") != key:
            print(f"error: {folder} holds cases of other settings; choose another --out", file=sys.stderr)
            raise SystemExit(2)
        write_json(folder / "config.json", key)
        write_json(folder / "environment.json", describe_environment())
        with progress(total=config.cases, description="blind cases", unit="cases") as bar:
            for _ in run(config, folder):
                bar.update(1)
        rows = table(folder, config.cases)
        numbers = scores.summary(rows)
        report = {
            "config": key,
            "environment": read_json(folder / "environment.json"),
            "numbers": numbers,
            "bars": scores.bars(numbers),
            "confusion": scores.confusion(rows),
            "calibration": scores.calibration(rows),
            "rows": rows,
        }
        write_json(folder / "numbers.json", report)
        if rows:
            write_table(
                folder / "cases.csv", [{k: r.get(k) for k in dict.fromkeys(k for q in rows for k in q)} for r in rows]
            )
        if config.json is not None:
            write_json(config.json, report)
        show(numbers, rows)
        print(json.dumps({k: v for k, v in numbers.items() if v is not None}))


if __name__ == "__main__":
    main()
