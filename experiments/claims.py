"""Every claim of the paper with its number: `uv run python experiments/claims.py --preset paper`.

Runs what is missing of the figures' experiments (each in its own folder, continued where a run was interrupted) and
writes claims.json, claims.md and claims.png.

A row has a statistic and its 95 % bootstrap interval over seeds. A claim says on which side of a bound the statistic
lies. The verdict follows from the interval alone:

    holds       both ends of the interval are on the claimed side
    does not    neither end is
    undecided   one end is, or there is no interval (a single seed)

"Grows with m" and "grows with p_m" are paired: differences, or trends, are formed within a seed, and the interval is
that of their mean over seeds; their p-values are Wilcoxon's signed-rank test. They are taken over the parameter's range
of influence, where behaviours feel it at least a quarter as much as where they feel it most: plateaus are left out.
Intervals from few seeds are too narrow, see `btr_mjx.metrics.bootstrap_interval`.
"""

import dataclasses
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import fig2_scans
import fig3_behaviours
import fig4_identification
import fig5_metrics
import numpy as np
import tyro
from common import Config, estimate, missing
from curves import interval
from drawing import figure_of, save
from fig3_behaviours import paired, sizes_of
from matplotlib.axes import Axes

from btr_mjx import metrics
from btr_mjx.errors import InputError, cli_errors
from btr_mjx.files import atomic_write, read_json, write_json
from btr_mjx.progress import note
from btr_mjx.runs import is_unused

FIGURES: dict[str, Any] = {
    "fig2_scans": fig2_scans,
    "fig3_behaviours": fig3_behaviours,
    "fig4_identification": fig4_identification,
    "fig5_metrics": fig5_metrics,
}
"""The experiments, in the order in which they run."""

SENSES: dict[str, Callable[[float, float], bool]] = {
    "at most": operator.le,
    "at least": operator.ge,
    "less than": operator.lt,
    "more than": operator.gt,
}
"""What a claim may say about its statistic."""

Sense = Literal["at most", "at least", "less than", "more than"]


@dataclass(frozen=True)
class ClaimsConfig:
    """Settings; every field is a flag."""

    preset: Literal["quick", "paper", "tiny"] = "quick"
    """Sizes of all experiments: quick takes minutes, paper up to an hour; tiny is for tests."""
    seeds: int | None = None
    """Seeds of every experiment; by default each its preset's own."""
    out: Path | None = None
    """Folder of the experiments' run folders; by default runs/experiments-<preset>."""
    engine: Literal["auto", "lanes", "mjx", "native"] | None = None
    """How simulations are computed; by default the preset's own."""
    progress: bool = True
    """Show progress bars."""
    resume: bool = False
    """Accepted for uniformity: what is there is always kept, and what is missing is computed."""
    draw_only: bool = False
    """Write the tables and figures from the saved files and simulate nothing."""


@dataclass(frozen=True)
class Claim:
    """A claim and what was measured about it.

    Attributes:
      claim: in words.
      measure: what the statistic is, with its unit.
      sense: how the statistic lies to the bound if the claim holds.
      bound: the bound.
      statistic: over seeds.
      low: lower end of its interval.
      high: upper end.
      seeds: number of seeds that gave a number.
      p: p-value of the paired test, None where there is none.
    """

    claim: str
    measure: str
    sense: Sense
    bound: float
    statistic: float
    low: float
    high: float
    seeds: int
    p: float | None = None

    @property
    def verdict(self) -> str:
        """See the module's docstring."""
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            return "undecided"
        ends = [SENSES[self.sense](end, self.bound) for end in (self.low, self.high)]
        return "holds" if all(ends) else "undecided" if any(ends) else "does not"

    @property
    def row(self) -> dict[str, Any]:
        """For claims.json."""
        first = {name: getattr(self, name) for name in ("claim", "statistic", "low", "high", "verdict")}
        return first | {name: getattr(self, name) for name in ("measure", "sense", "bound", "seeds", "p")}


def claimed(
    claim: str, measure: str, sense: Sense, bound: float, values: Sequence[float], statistic: Any = np.mean
) -> Claim:
    """A claim about a number per seed."""
    found = interval(values, statistic)
    return Claim(claim, measure, sense, bound, found["estimate"], found["low"], found["high"], int(found["seeds"]))


def tested(claim: str, measure: str, sense: Sense, bound: float, differences: Sequence[float]) -> Claim:
    """A claim about paired differences, or trends, within each seed."""
    found = paired(differences)
    numbers = (found["estimate"], found["low"], found["high"], int(found["seeds"]))
    return Claim(claim, measure, sense, bound, *numbers, p=None if np.isnan(found["p"]) else found["p"])


def claims_of_fig2(summary: dict[str, Any], at_other_truths: Sequence[float]) -> list[Claim]:
    """The gap, Theorems 1 and 2 (also in the other figures' experiments), and the shape of the two scans."""
    rows = {parameter: summary[parameter]["seeds"] for parameter in ("bl_14", "bl_5")}
    both = [row for values in rows.values() for row in values]
    get = lambda parameter, name: [float(row[name]) for row in rows[parameter]]  # noqa: E731
    median = partial(claimed, statistic=np.median)
    found = [
        claimed(
            "Theorem 1: s = s_r makes every delta_k 0",
            "largest delta_k at the truth, all experiments [m/s]",
            "at most",
            0.0,
            [float(row["at_truth"]) for row in both] + list(at_other_truths),
            np.max,
        ),
        claimed(
            "Theorem 2: s = s_r makes Delta_fitness 0",
            "largest Delta_fitness at the truth, all scans [m/s]",
            "at most",
            0.0,
            [float(row["mean_at_truth"]) for row in both],
            np.max,
        ),
        claimed(
            "Delta_fitness is above 0 wherever s differs from s_r",
            "least Delta_fitness beside the truth [m/s]",
            "more than",
            0.0,
            [float(row["elsewhere"]) for row in both],
            np.min,
        ),
        claimed(
            "Fig. 2a: fitness rises over the generations",
            "best of the last minus best of the first [m/s]",
            "more than",
            0.0,
            get("bl_14", "gained"),
        ),
        claimed(
            "Fig. 2a: transferred controllers lose fitness in reality",
            "mean of f_s - f_r [m/s]",
            "more than",
            0.0,
            get("bl_14", "lost"),
        ),
    ]
    for parameter, bound in (("bl_14", 0.9), ("bl_5", 0.85)):
        name = "Fig. 2b" if parameter == "bl_14" else "Fig. 2c"
        rho = f"{name}: Delta_fitness over {parameter} grows with the error"
        found.append(median(rho, "median Spearman's rho", "at least", bound, get(parameter, "rho")))
        if parameter == "bl_5":
            sides = f"{name}: Delta_fitness over {parameter} grows with the error on either side of the truth"
            values = get(parameter, "rho_sides")
            found.append(median(sides, "median of Spearman's rho by side", "at least", bound, values))
    for parameter, words in (("bl_14", "<= 1.1"), ("bl_5", ">= 1.3")):
        claim = f"Plateau: {parameter} {words} hardly matters, the foot stays clear of the ground"
        measure = "Delta_fitness per 0.1 m there / elsewhere"
        found.append(claimed(claim, measure, "at most", 0.25, get(parameter, "felt")))
    return found


def claims_of_fig3(summary: dict[str, Any], sizes: Sequence[int]) -> list[Claim]:
    """Hypotheses 3 and 4, single behaviours, noise."""
    crossing = summary["crosses_elsewhere"]
    most = str(sizes[-1])
    found = [
        Claim(
            "A single delta_k may be 0 away from the truth",
            "share of behaviours whose f_s - f_r changes sign more than 0.1 m away",
            "more than",
            0.0,
            float(crossing["estimate"]),
            float(crossing["low"]),
            float(crossing["high"]),
            int(crossing["seeds"]),
        ),
        claimed(
            "A single delta_k is not monotonic in the error",
            "mean Spearman's rho by side of one behaviour",
            "less than",
            0.9,
            numbers(summary["by_m"]["1"]["rho_sides"]["values"]),
        ),
    ]
    directions: tuple[tuple[str, str, Sense], ...] = (
        ("rho_sides", "monotonicity grows", "more than"),
        ("roughness_sides", "roughness falls", "less than"),
    )
    for name, words, sense in directions:
        measure = {
            "rho_sides": "difference of Spearman's rho by side",
            "roughness_sides": "difference of variation / range by side",
        }
        for less, more in pairwise(sizes):
            values = numbers(summary["steps"][f"{name} {less} to {more}"]["values"])
            found.append(tested(f"Hypothesis 3: {words} from m = {less} to {more}", measure[name], sense, 0.0, values))
        trend = numbers(summary["trend"][name]["values"])
        found.append(tested(f"Hypothesis 4: {words} with p_m", "Spearman's rho with p_m", sense, 0.0, trend))
    for level in ("0.05", "0.1"):
        by_m = summary["noise"][level]
        pairs = zip(numbers(by_m["1"]["values"]), numbers(by_m[most]["values"]), strict=True)
        found.append(
            tested(
                f"Noise of {float(level):.0%} on f_r is averaged out from m = 1 to {most}",
                "difference of |argmin - truth| [m]",
                "less than",
                0.0,
                [many - one for one, many in pairs],
            )
        )
    return found


def claims_of_fig4(summary: dict[str, Any]) -> list[Claim]:
    """Hypotheses 1 and 2, the searches and the distances."""
    searches = summary["searches"]
    values = lambda name, key: numbers(searches[name][key]["values"])  # noqa: E731
    median = partial(claimed, statistic=np.median)
    error = "median of the mean error [m]"
    fallen = [
        last / first for first, last in zip(values("ga", "distance_first"), values("ga", "distance"), strict=True)
    ]
    # Both may hit the truth to the last bit of a length's genome; a micrometre is as good as 0.
    gain = [float(np.log10(max(a, 1e-6) / max(b, 1e-6))) for a, b in summary["equal_cost"]]
    felt = np.array([row["estimate"] for row in summary["felt"]["delta"]])
    errors = np.array([values("delta-12", f"error_{i}") for i in range(len(felt))])
    order = [float(metrics.spearman(column, felt)) for column in errors.T]
    return [
        median(
            "Fig. 4a: Delta_fitness falls over the generations",
            "least of the search / least of the first generation",
            "less than",
            0.5,
            fallen,
        ),
        median(
            "Hypothesis 1, Fig. 4b: four felt lengths converge to the truth (genetic algorithm)",
            error,
            "at most",
            0.02,
            values("ga", "error"),
        ),
        median(
            "Hypothesis 1: a stronger search of the same distance comes closer (CMA-ES)",
            error,
            "at most",
            0.005,
            values("cma", "error"),
        ),
        tested(
            "CMA-ES ends nearer to the truth than the genetic algorithm at as many trials",
            "log10 of the ratio of errors",
            "less than",
            0.0,
            gain,
        ),
        claimed(
            "Hypothesis 1: the less a length is felt, the less well it is found (twelve unknown, Delta_fitness)",
            "Spearman's rho between felt and error over twelve lengths",
            "less than",
            0.0,
            order,
        ),
        median(
            "Twelve unknown lengths are too many for Delta_fitness",
            error,
            "at least",
            0.1,
            values("delta-12", "error"),
        ),
        median(
            "Hypothesis 2: where behaviours feel all lengths, all are found (twelve unknown, multiscale)",
            error,
            "at most",
            0.01,
            values("multiscale-12", "error"),
        ),
        median("The same with 5 % noise on every measurement", error, "at most", 0.015, values("noisy-12", "error")),
        median(
            "The same where reality has another integrator and time step",
            error,
            "at most",
            0.03,
            values("native-12", "error"),
        ),
    ]


def claims_of_fig5(summary: dict[str, Any]) -> list[Claim]:
    """The paper's statements on sensor metrics, for means over m behaviours, for single ones and for longer trials."""
    short, whole = "1.25 %", "100 %"
    alike = {name: numbers(summary["like_euclidean"][name]["values"]) for name in (short, whole)}

    def minus(source: dict[str, Any], kind: str, first: str, second: str) -> list[float]:
        pairs = (numbers(source[kind][name]["monotonicity"]["values"]) for name in (first, second))
        return [a - b for a, b in zip(*pairs, strict=True)]

    share = "difference of the share of neighbours in order"
    lose = partial(tested, measure=f"{share}: 100 % - 1.25 %", sense="less than", bound=0.0)
    keep = partial(tested, measure=f"{share}: by fitness - rolling mean 100 %", sense="more than", bound=0.0)
    longer = f"trials of {fig5_metrics.LONGER} T_e"
    return [
        claimed(
            "Fig. 5: the shortest header is near linear",
            "Pearson's r with the error, mean of both sides",
            "at least",
            0.95,
            numbers(summary["distances"][short]["linearity"]["values"]),
        ),
        tested(
            "Fig. 5: the whole header behaves like the Euclidean metric",
            "difference of Pearson's r with it: 100 % - 1.25 %",
            "more than",
            0.0,
            [a - b for a, b in zip(alike[whole], alike[short], strict=True)],
        ),
        lose("Fig. 5: long headers lose monotonicity", differences=minus(summary, "distances", whole, short)),
        lose(
            "Fig. 5: long headers lose monotonicity, single behaviours",
            differences=minus(summary, "single", whole, short),
        ),
        lose(
            f"Fig. 5: long headers lose monotonicity, single behaviours, {longer}",
            differences=minus(summary["long"], "single", whole, short),
        ),
        keep(
            "Fig. 5: Delta_fitness keeps its monotonicity at the full T_e, where the rolling mean lost it",
            differences=minus(summary, "distances", "delta_fitness", whole),
        ),
        keep(
            "The multiscale distance keeps it better than the rolling mean of whole trials",
            differences=minus(summary, "distances", "multiscale", whole),
        ),
    ]


def numbers(values: Sequence[Any]) -> list[float]:
    """Numbers read from JSON, where what is not finite is a string."""
    return [float(value) for value in values]


def collect(folder: Path, sizes: Sequence[int]) -> list[Claim]:
    """All claims, from the figures' JSON files."""
    read = lambda name: read_json(folder / name / f"{name.partition('_')[0]}.json")  # noqa: E731
    third, fourth = read("fig3_behaviours"), read("fig4_identification")
    return [
        *claims_of_fig2(read("fig2_scans"), [float(third["at_truth"]), float(fourth["at_truth"])]),
        *claims_of_fig3(third, sizes),
        *claims_of_fig4(fourth),
        *claims_of_fig5(read("fig5_metrics")),
    ]


def table(claims: Sequence[Claim]) -> str:
    """claims.md."""
    head = "| claim | measured | says | statistic | 95 % interval | p | seeds | verdict |"
    lines = ["# Claims", "", head, "|" + "---|" * 8]
    for claim in claims:
        p = "" if claim.p is None else f"{claim.p:.2g}"
        lines.append(
            f"| {claim.claim} | {claim.measure} | {claim.sense} {claim.bound:g} | {claim.statistic:.3g} | "
            f"{claim.low:.3g} .. {claim.high:.3g} | {p} | {claim.seeds} | **{claim.verdict}** |"
        )
    counts = {word: sum(claim.verdict == word for claim in claims) for word in ("holds", "does not", "undecided")}
    lines += ["", ", ".join(f"{count} {word}" for word, count in counts.items()) + f" of {len(claims)}.", ""]
    rule = (__doc__ or "").partition("\n\n")[2].partition("\n\n")[2]
    return "\n".join(lines) + "\n" + rule


def draw_claims(path: Path, claims: Sequence[Claim]) -> Path:
    """Every claim's interval, as its distance from the bound in units of its own size; the claimed side is right."""
    with figure_of(8.6, 0.6 + 0.21 * len(claims)) as figure:
        axes: Axes = figure.subplots()
        for place, claim in enumerate(claims):
            sign = 1.0 if claim.sense in ("at least", "more than") else -1.0
            ends = sign * (np.array([claim.low, claim.statistic, claim.high]) - claim.bound)
            size = np.nanmax(np.abs(ends), initial=0.0) or 1.0
            low, middle, high = ends / size
            marker = {"holds": "o", "does not": "X", "undecided": "D"}[claim.verdict]
            axes.plot([low, high], [place, place], "k-", linewidth=1)
            axes.plot(middle, place, marker, color="black" if claim.verdict == "holds" else "#c8641e", markersize=5)
        axes.axvline(0, color="0.5", linewidth=0.8)
        axes.set_yticks(range(len(claims)), [claim.claim for claim in claims], fontsize=6.5)
        axes.set(ylim=(len(claims) - 0.4, -0.6), xlim=(-1.15, 1.15), xticks=[0])
        axes.set_xticklabels(["bound"])
        axes.set_xlabel("claimed side to the right; circle: holds, diamond: undecided, cross: does not", fontsize=7)
        return save(figure, path)


def configs(config: ClaimsConfig) -> dict[str, Config]:
    """Settings of every figure's experiment."""
    assert config.out is not None
    found = {}
    for name, module in FIGURES.items():
        own = module.PRESETS[config.preset]
        folder = config.out / name
        found[name] = dataclasses.replace(
            own,
            out=folder,
            resume=not is_unused(folder),
            progress=config.progress,
            seeds=own.seeds if config.seeds is None else config.seeds,
            engine=config.engine or own.engine,
        )
    return found


def run(config: ClaimsConfig) -> list[Claim]:
    """Compute what is missing, draw all figures and write the claims.

    Raises:
      InputError: bad settings, or a folder that was computed with others.
    """
    if config.seeds is not None and config.seeds < 1:
        raise InputError(f"seeds: got {config.seeds}, expected at least 1")
    folder = config.out or Path("runs", f"experiments-{config.preset}")
    settings = configs(dataclasses.replace(config, out=folder))
    if not config.draw_only:
        left = {name: missing(folder / name, FIGURES[name].units(each)) for name, each in settings.items()}
        if config.progress:
            note(f"claims: {estimate(sum(unit.trials for units in left.values() for unit in units))}")
        for name, each in settings.items():
            FIGURES[name].compute(each)
    for module, name in zip(FIGURES.values(), settings, strict=True):
        for path in module.draw(folder / name):
            print(path)
    third: Any = settings["fig3_behaviours"]
    claims = collect(folder, sizes_of(third.mutants))
    write_json(folder / "claims.json", [claim.row for claim in claims])
    with atomic_write(folder / "claims.md") as file:
        file.write(table(claims).encode())
    draw_claims(folder / "claims.png", claims)
    return claims


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    config = tyro.cli(ClaimsConfig, args=argv, description=__doc__, prog="claims")
    with cli_errors("the same command: what is done is kept"):
        claims = run(config)
        for claim in claims:
            print(f"{claim.verdict:10} {claim.statistic:10.3g} [{claim.low:.3g}, {claim.high:.3g}]  {claim.claim}")


if __name__ == "__main__":
    main()
