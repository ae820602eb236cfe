"""Blind cases of the search by fitness alone: `uv run python benchmarks/fitness_gap.py --cases 10 --out FOLDER`.

Hidden cases of one robot with one missing effect each; the data are the fitness of 45 + 15 controllers. A case is
strong if its effect alone changes the fitness by at least `STRONG` times the change by errors of calibration; weaker
cases are left out. There are at most `PER_KIND` cases of one effect, so that few kinds do not dominate the result.

All cases use the same controllers, so that the responses of candidates are simulated once. Cases, answers and results
are files in the folder: the same command continues a killed benchmark.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hidden_cases import FitnessCaseSettings, Missing, case_draw, draw_reality, make_fitness_case
from summary_command import command

from btr_mjx.gap.effects import EFFECTS, Candidate, candidates
from btr_mjx.gap.fitness_only import (
    COARSE_FACTORS,
    SCREENING_TRIALS,
    CandidateResponses,
    FitnessTable,
    TrialSimulator,
    identify_fitness,
    load_fitness,
    simulate_candidates,
)
from btr_mjx.gap.results import Verdict, as_result
from btr_mjx.gap.simulate import World
from btr_mjx.runs import describe_environment, note, progress, read_arrays, read_json, write_arrays, write_json

STRONG = 3.0
"""Change of the fitness by a strong effect, in units of the change by errors of calibration."""
PER_KIND = 2
"""Largest number of cases of one effect."""
_PROBED = 12
"""Trials on which the strength of a drawn effect is measured."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    out: Path
    """Folder of cases and results."""
    cases: int = 10
    """Number of strong cases."""
    seed: int = 1000
    """Seed of the null; the cases have the following seeds."""
    controllers: int = 5
    """Seed of the controllers, which all cases share."""
    robot: str = "hexapod"
    """Robot of the cases."""


def run(config: Config) -> dict[str, Any]:
    """Make and solve the cases; returns what is written to results.json."""
    null = load_fitness(_case(config, config.seed, None))
    trials = TrialSimulator(null)
    fit = np.flatnonzero(~null.test)
    floor = _delta(trials, null, fit)
    note(f"errors of calibration alone: Delta_fitness {floor:.4f} m/s")
    responses = _responses(config, trials, fit[:SCREENING_TRIALS])
    seeds = _strong(config, trials, responses, floor)
    rows = []
    for seed in progress(seeds["strong"], description="cases", unit="cases"):
        rows.append(_solved(config, seed, responses))
        note(_line(rows[-1]))
    result = {"config": config, "floor": floor, **seeds, "cases": rows, "summary": summary(rows)}
    write_json(config.out / "results.json", {**result, "environment": describe_environment()})
    return result


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Shares of cases, and the median reduction of Delta_fitness."""
    falls = np.array([row["fall"] for row in rows])
    return {
        "kind_first": float(np.mean([row["kind_rank"] == 1 for row in rows])),
        "kind_in_top_3": float(np.mean([row["kind_rank"] is not None and row["kind_rank"] <= 3 for row in rows])),
        "kind_in_top_3_rows": float(np.mean([row["row_rank"] is not None and row["row_rank"] <= 3 for row in rows])),
        "fall_median": float(np.median(falls)),
        "fall_at_least_half": float(np.mean(falls >= 0.5)),
        "named": float(np.mean([row["verdict"] == "effect" for row in rows])),
    }


def _case(config: Config, seed: int, effects: int | None) -> Path:
    """Folder of a case, made if absent; a null without effects."""
    folder = config.out / f"case-{seed}"
    truths = config.out / f"truth-{seed}.json"
    if not truths.is_file():
        verdict: Verdict = "none" if effects is None else "effect"
        truth = make_fitness_case(
            folder,
            seed,
            config.robot,
            FitnessCaseSettings(verdict=verdict, effects=effects or 1, controllers=config.controllers),
        )
        write_json(truths, truth)
    return folder


def _responses(config: Config, trials: TrialSimulator, rows: np.ndarray) -> CandidateResponses:
    """Responses of the candidates, simulated once and kept in a file."""
    model = trials.table.head.model
    library = candidates(model, trials.scales(np.flatnonzero(~trials.table.test)[:3]), EFFECTS)
    path, step = config.out / "answers.npz", COARSE_FACTORS[0] * float(model.opt.timestep)
    if not path.is_file():
        found = simulate_candidates(trials, library, rows, step, note)
        arrays = {f"tried_{i}": own for i, own in enumerate(found.tried)}
        arrays |= {f"change_{i}": own for i, own in enumerate(found.change)}
        write_arrays(path, arrays | {"rows": rows, "believed": found.believed})
    saved = read_arrays(path)
    each = range(len(library))
    return CandidateResponses(
        tuple(library),
        saved["rows"],
        step,
        saved["believed"],
        tuple(saved[f"tried_{i}"] for i in each),
        tuple(saved[f"change_{i}"] for i in each),
    )


def _strong(config: Config, trials: TrialSimulator, responses: CandidateResponses, floor: float) -> dict[str, Any]:
    """Seeds of strong cases, and the number of draws by effect."""
    path = config.out / "strong.json"
    if not path.is_file():
        by_name = {c.name: c for c in responses.candidates}
        strong: list[int] = []
        drawn: Counter[str] = Counter()
        kinds: Counter[str] = Counter()
        seed = config.seed
        while len(strong) < config.cases:
            seed += 1
            (missing,) = draw_reality(case_draw(config.robot, seed, config.controllers), "effect", 1, None, 1.0)[1]
            drawn[missing.effect] += 1
            candidate = by_name.get(f"{missing.effect}@{missing.location}")
            if kinds[missing.effect] >= PER_KIND or candidate is None:
                continue
            world = candidate.apply(World.of(trials.table.head.model), values_of(candidate, missing))
            fitness = trials.fitness([world], responses.rows[:_PROBED], responses.timestep)[0]
            if np.nanmean(np.abs(fitness - responses.believed[:_PROBED])) >= STRONG * floor:
                strong.append(seed)
                kinds[missing.effect] += 1
        write_json(path, {"strong": strong, "drawn": dict(drawn)})
    return read_json(path)


def values_of(candidate: Candidate, missing: Missing) -> np.ndarray:
    """Values of a hidden effect in the order of a candidate's parameters.

    Args:
      candidate: the candidate at the place of the hidden effect.
      missing: the hidden effect.

    Returns:
      (p,) values; parameters that the hidden effect does not have are at their null.
    """
    return np.array([missing.parameters.get(p.name, p.null) for p in candidate.parameters])


def _delta(trials: TrialSimulator, table: FitnessTable, rows: np.ndarray) -> float:
    found = trials.fitness([World.of(table.head.model)], rows)[0]
    return float(np.nanmean(np.abs(found - table.fitness[rows])))


def _solved(config: Config, seed: int, responses: CandidateResponses) -> dict[str, Any]:
    """Result of one case, compared with the truth."""
    folder = _case(config, seed, 1)
    if not (folder / "result.json").is_file():
        table = load_fitness(folder)
        write_json(folder / "result.json", as_result(identify_fitness(table, responses=responses), table.head))
    result, (missing,) = read_json(folder / "result.json"), read_json(config.out / f"truth-{seed}.json")["effects"]
    names = [row["effect"] for row in result["ranking"]]
    kinds = list(dict.fromkeys(names))
    first = result["ranking"][0]
    gap = result["misfit"]["before"]
    return {
        "seed": seed,
        "missing": missing,
        "found": {key: first[key] for key in ("effect", "location", "parameters")},
        "verdict": result["verdict"],
        "row_rank": names.index(missing["effect"]) + 1 if missing["effect"] in names else None,
        "kind_rank": kinds.index(missing["effect"]) + 1 if missing["effect"] in kinds else None,
        "top": [f"{row['effect']}@{row['location']}" for row in result["ranking"][:5]],
        "before": gap,
        "fall": float(first["held_out"]) / gap,
        "steps": result["steps"],
        "seconds": result["seconds"],
    }


def _line(row: Mapping[str, Any]) -> str:
    missing, found = row["missing"], row["found"]
    return (
        f"{row['seed']}: {missing['effect']}@{missing['location']}, found {found['effect']}@{found['location']}, "
        f"kind ranks {row['kind_rank']}, Delta_fitness on unseen controllers {row['before']:.3f} falls by "
        f"{100 * row['fall']:.0f} %, {row['steps'] / 1e6:.1f} M steps, {row['seconds']:.0f} s"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    command(Config, run, __doc__, argv)


if __name__ == "__main__":
    main()
