"""Recordings saved by choosing the next command: `uv run python benchmarks/next_experiment.py --out FOLDER`.

Each case is a robot with one missing effect and one short recording that does not identify it: the true effect and its
closest rival have scores within `DECISIVE_MARGIN` of each other. New recordings may use any of ten variations of the
recorded commands. They are taken either in the order of the expected disagreement of the two, or in random order.
Counted are the recordings until truth and rival are separated, in a simulated reality with the sensors' noise.

Every case is a file in the folder, written when it is done: the same command continues a killed benchmark.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hidden_cases import CaseSettings, Truth, make_case
from recorded_margins import Measurement, recordings_needed
from summary_command import command

from btr_mjx.gap.data import load
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.experiments import DECISIVE_MARGIN, random_commands
from btr_mjx.gap.inference import Bench, Hypothesis
from btr_mjx.gap.windows import Options
from btr_mjx.runs import describe_environment, note, progress, read_json, write_json

_QUICK = Options(steps=2e4, leaders=8, contact_leaders=0)
"""Options of a search that needs the first two candidates only."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    out: Path
    """Folder of cases and results."""
    cases: int = 12
    """Number of ambiguous cases."""
    seed: int = 0
    """Seed of the first case that is tried."""
    robot: str = "pendulum"
    """Robot of the cases."""
    orders: int = 4
    """Number of random orders that are compared with the chosen one."""
    commands: int = 10
    """Number of commands to choose from."""
    most: int = 6
    """Largest number of recordings; unresolved cases count as one more."""
    duration: float = 1.0
    """Duration of the first recording [s]."""


def run(config: Config) -> dict[str, Any]:
    """Try seeds until there are enough ambiguous cases; returns what is written to results.json."""
    rows: list[Any] = []
    seed = config.seed
    with progress(total=config.cases, description="ambiguous cases", unit="cases") as bar:
        while sum(row["ambiguous"] for row in rows) < config.cases:
            path = config.out / f"case-{seed}.json"
            if not path.is_file():
                write_json(path, _case(config, seed))
            rows.append(read_json(path))
            if rows[-1]["ambiguous"]:
                note(_line(rows[-1]))
                bar.update(1)
            seed += 1
    ambiguous = [row for row in rows if row["ambiguous"]]
    result = {"config": config, "tried": len(rows), "cases": ambiguous, "summary": summary(ambiguous, config.most)}
    write_json(config.out / "results.json", {**result, "environment": describe_environment()})
    return result


def summary(rows: Sequence[Mapping[str, Any]], most: int) -> dict[str, float]:
    """Mean numbers of recordings, and shares of cases in which the chosen order needs fewer or more than random orders.

    Args:
      rows: ambiguous cases.
      most: largest number of recordings.

    Returns:
      Means over all cases, means over the resolved cases ("told"), and the share of these.
    """
    chosen = np.array([row["chosen"] for row in rows], float)
    chance = np.array([np.mean(row["random"]) for row in rows])
    told = (chosen <= most) | (chance <= most)
    return {
        "told": float(told.mean()),
        "recordings_chosen_told": float(chosen[told].mean()) if told.any() else float("nan"),
        "recordings_random_told": float(chance[told].mean()) if told.any() else float("nan"),
        "recordings_chosen": float(chosen.mean()),
        "recordings_random": float(chance.mean()),
        "saved": float(1 - chosen.mean() / chance.mean()),
        "fewer": float(np.mean(chosen < chance)),
        "more": float(np.mean(chosen > chance)),
    }


def _case(config: Config, seed: int) -> dict[str, Any]:
    """One seed: whether the case is ambiguous, and the numbers of recordings that are needed."""
    folder = config.out / f"data-{seed}"
    truth = make_case(
        folder,
        seed,
        config.robot,
        CaseSettings(verdict="effect", recordings=(1, 1), duration=config.duration, noise=2.0),
    )
    dataset = load(folder)
    bench = Bench(dataset, EFFECTS, _QUICK)
    judged = bench.find()
    (missing,) = truth.effects
    own = next((j for j in judged if j.name == f"{missing.effect}@{missing.location}"), None)
    rivals = [j for j in judged if j is not own]
    if own is None or not rivals or own.score - rivals[0].score > DECISIVE_MARGIN:
        return {"seed": seed, "ambiguous": False, "missing": missing}
    real, rival = _at_truth(bench, own.hypothesis, truth), rivals[0].hypothesis
    measurement = Measurement(bench.sigma, bench.survey.span)
    needed = []
    for order in range(config.orders + 1):
        # All orders have the same commands; they differ in sequence and noise.
        commands = random_commands(dataset, np.random.default_rng([seed, 3]), config.commands)
        rng = np.random.default_rng([seed, 4, order])
        chosen = order == 0
        if not chosen:
            commands = [commands[i] for i in rng.permutation(len(commands))]
        needed.append(recordings_needed(real, rival, dataset, measurement, rng, chosen, config.most, commands))
    return {
        "seed": seed,
        "ambiguous": True,
        "missing": missing,
        "rival": rival.name,
        "lead": own.score - rivals[0].score,
        "chosen": needed[0],
        "random": needed[1:],
    }


def _at_truth(bench: Bench, found: Hypothesis, truth: Truth) -> Hypothesis:
    """Hypothesis of the true effect at its true values."""
    candidate = found.effects[-1][0]
    values = [truth.effects[0].parameters.get(p.name, p.null) for p in candidate.parameters]
    return bench.base.with_effect(candidate, np.array(values))


def _line(row: Mapping[str, Any]) -> str:
    missing = row["missing"]
    return (
        f"{row['seed']}: {missing['effect']}@{missing['location']} or {row['rival']}: "
        f"{row['chosen']} chosen, {np.mean(row['random']):.1f} at random"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the command."""
    command(Config, run, __doc__, argv)


if __name__ == "__main__":
    main()
