"""Every claim of the paper with its number: `uv run python experiments/claims.py --preset paper`.

Computes the missing units of the figures' experiments (each in its own folder; interrupted runs are continued) and
writes claims.json, claims.md, claims.png and report.html.

A row has a statistic and its 95 % bootstrap interval over seeds. A claim says on which side of a bound the statistic
lies. The verdict follows from the interval alone:

    holds       both ends of the interval are on the claimed side
    does not    neither end is
    undecided   one end is, or there is no interval (a single seed)

A preset of fewer seeds and shorter searches than the paper's can confirm a claim and not refute it: where neither end
is on the claimed side it says "undecided at this size", and how long the whole takes.

"Grows with m" and "grows with p_m" are paired: differences, or trends, are formed within a seed, and the interval is
that of their mean over seeds; their p-values are Wilcoxon's signed-rank test. They are taken over the parameter's range
of influence, where the sensitivity of behaviours is at least a quarter of its maximum: plateaus are left out.
Intervals from few seeds are too narrow, see `btr_mjx.evaluation.metrics.bootstrap_interval`.
"""

import dataclasses
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import fig2_scans
import fig3_behaviours
import fig4_identification
import fig5_metrics
import numpy as np
import tyro
from claims_page import draw_claims_page
from common import Config
from drawing import figure_of, save
from fig3_behaviours import sizes_of
from matplotlib.axes import Axes
from paper_claims import claims_of_fig2, claims_of_fig3, claims_of_fig4, claims_of_fig5, explained
from units import estimate, missing
from verdicts import Claim

from btr_mjx.errors import InputError, cli_errors
from btr_mjx.runs import atomic_write, is_unused, note, read_json, write_json

FIGURES: dict[str, Any] = {
    "fig2_scans": fig2_scans,
    "fig3_behaviours": fig3_behaviours,
    "fig4_identification": fig4_identification,
    "fig5_metrics": fig5_metrics,
}
"""The experiments, in the order in which they run."""


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
    gallery: Path | None = None
    """Copy the figures, claims.json and claims.md here too, such as docs/gallery."""


def collect(folder: Path, sizes: Sequence[int]) -> list[Claim]:
    """All claims, from the figures' JSON files."""
    read = lambda name: read_json(folder / name / f"{name.partition('_')[0]}.json")  # noqa: E731
    third, fourth = read("fig3_behaviours"), read("fig4_identification")
    return explained(
        [
            *claims_of_fig2(read("fig2_scans"), [float(third["at_truth"]), float(fourth["at_truth"])]),
            *claims_of_fig3(third, sizes),
            *claims_of_fig4(fourth),
            *claims_of_fig5(read("fig5_metrics")),
        ]
    )


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
    words = dict.fromkeys(["holds", "does not", "undecided", *(claim.verdict for claim in claims)])
    counts = {word: sum(claim.verdict == word for claim in claims) for word in words}
    lines += ["", ", ".join(f"{count} {word}" for word, count in counts.items()) + f" of {len(claims)}.", ""]
    reasons = [claim for claim in claims if claim.why]
    if reasons:
        lines += [
            "## What does not hold or is undecided, and why",
            "",
            *(f"- **{claim.claim}.** {claim.why}" for claim in reasons),
            "",
        ]
    rule = (__doc__ or "").partition("\n\n")[2].partition("\n\n")[2]
    return "\n".join(lines) + "\n" + rule


def draw_claims(path: Path, claims: Sequence[Claim]) -> Path:
    """Figure of all claims: intervals relative to the bound, scaled by their size; the claimed side is to the right."""
    with figure_of(8.6, 0.6 + 0.21 * len(claims)) as figure:
        axes: Axes = figure.subplots()
        for place, claim in enumerate(claims):
            sign = 1.0 if claim.sense in ("at least", "more than") else -1.0
            ends = sign * (np.array([claim.low, claim.statistic, claim.high]) - claim.bound)
            size = np.nanmax(np.abs(ends), initial=0.0) or 1.0
            low, middle, high = ends / size
            marker = {"holds": "o", "does not": "X"}.get(claim.verdict, "D")
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
    made = [path for name, module in FIGURES.items() for path in module.draw(folder / name)]
    for path in made:
        print(path)
    third: Any = settings["fig3_behaviours"]
    claims = [
        # A theorem is exact, however few behaviours there are.
        dataclasses.replace(claim, whole=config.preset == "paper" or claim.claim.startswith("Theorem"))
        for claim in collect(folder, sizes_of(third.mutants))
    ]
    write_json(folder / "claims.json", [claim.row for claim in claims])
    with atomic_write(folder / "claims.md") as file:
        file.write(table(claims).encode())
    draw_claims(folder / "claims.png", claims)
    draw_claims_page(folder)
    if config.gallery is not None:
        config.gallery.mkdir(parents=True, exist_ok=True)
        pictures = [path for path in made if path.suffix == ".png"]
        for path in (*pictures, *(folder / f"claims.{suffix}" for suffix in ("json", "md", "png"))):
            shutil.copyfile(path, config.gallery / path.name)
    return claims


def whole_size() -> str:
    """Number of trials and time that the preset "paper" needs, in words."""
    units = [unit for module in FIGURES.values() for unit in module.units(module.PRESETS["paper"])]
    return estimate(sum(unit.trials for unit in units))


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point."""
    config = tyro.cli(ClaimsConfig, args=argv, description=__doc__, prog="claims")
    with cli_errors("the same command: what is done is kept"):
        claims = run(config)
        for claim in claims:
            print(f"{claim.verdict:22} {claim.statistic:10.3g} [{claim.low:.3g}, {claim.high:.3g}]  {claim.claim}")
        if any(not claim.whole and claim.verdict != "holds" for claim in claims):
            print(f"undecided at this size: --preset paper needs {whole_size()}")


if __name__ == "__main__":
    main()
