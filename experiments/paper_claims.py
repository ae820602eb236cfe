"""Claims of the paper, figure by figure, as statistics of the figures' summaries."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import fig5_metrics
import numpy as np
from verdicts import Claim, Sense, claimed, tested

from btr_mjx.evaluation import metrics

REASONS: dict[str, str] = {
    "Plateau: bl_5 >= 1.3": (
        "A longer femur lifts the foot, but not out of reach: in native simulations of random controllers the"
        " foot is in contact for 36, 19, 16, 15 and 13 % of the steps at bl_5 = 0.6, 0.88, 1.1, 1.3 and 1.5 "
        "m. The paper's robot had another posture. For bl_14 it is 0 % up to 1.0 m and 44 % at 1.6 m: there "
        "the plateau is as in the paper."
    ),
    "Hypothesis 1: the less a length is felt": (
        "The search of twelve by Delta_fitness ends far from the truth in all lengths, felt or not, so that "
        "there is no order to see."
    ),
    "Fig. 2c: Delta_fitness over bl_5 grows": (
        "The median is above the bound, the interval reaches below it: some seeds have valleys whose two "
        "sides differ in steepness. By side it holds, in the next row."
    ),
    "Fig. 5: Delta_fitness keeps its monotonicity": (
        "The mean rolling metric of the whole trial puts only 2 % fewer neighbouring grid points in order "
        "than the shortest header: 1.7 s of a strongly damped robot are not chaotic enough to spoil a mean "
        "over 15 behaviours, and one number per trial orders fewer neighbours than all sensor series "
        "together. What Delta_fitness keeps is in the row on its use at the full T_e."
    ),
    "The multiscale distance keeps it better": ("As for Delta_fitness."),
}
"""First words of a claim -> known reasons why it does not hold."""


def explained(claims: Sequence[Claim]) -> list[Claim]:
    """Claims that do not hold, or are undecided, get their reasons."""
    found = []
    for claim in claims:
        reasons = [why for words, why in REASONS.items() if claim.claim.startswith(words)]
        found.append(replace(claim, why=reasons[0]) if reasons and claim.verdict != "holds" else claim)
    return found


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
    # Both may find the truth to the resolution of the genome; a micrometre counts as 0.
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
        claimed(
            "Fig. 5: Delta_fitness stays usable at the full T_e",
            "Spearman's rho with the error, by side",
            "at least",
            0.85,
            numbers(summary["distances"]["delta_fitness"]["rho_sides"]["values"]),
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
