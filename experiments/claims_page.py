"""The page of the paper's claims."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.pages import Section, Table, embedded, with_interval, write_page
from btr_mjx.runs import read_json


def claims_sentence(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many claims hold."""
    counts = {word: sum(row["verdict"] == word for row in rows) for word in ("holds", "does not", "undecided")}
    hold = f"{counts['holds']} of {len(rows)} claims hold"
    others = [f"{counts['does not']} {'does' if counts['does not'] == 1 else 'do'} not"] * (counts["does not"] > 0)
    others += [f"{counts['undecided']} {'is' if counts['undecided'] == 1 else 'are'} undecided"] * (
        counts["undecided"] > 0
    )
    return ", ".join([hold, *others]) + "."


def draw_claims_page(folder: Path) -> Path:
    """Draw the page from claims.json and the PNG files in the folder and beside the experiments."""
    rows = read_json(folder / "claims.json")
    table = Table(
        ["claim", "verdict", "statistic [95 %]", "claimed", "p", "seeds", "measured"],
        [
            [
                row["claim"],
                row["verdict"],
                with_interval(*(float(row[key]) for key in ("statistic", "low", "high"))),
                f"{row['sense']} {row['bound']:g}",
                None if row["p"] is None else float(row["p"]),
                row["seeds"],
                row["measure"],
            ]
            for row in rows
        ],
        "In brackets: 95 % bootstrap interval over seeds; the verdict follows from it alone. p: Wilcoxon's signed-rank "
        "test.",
    )
    pictures = [*sorted(folder.glob("fig*.png")), *sorted(folder.glob("fig*_*/fig*.png"))]
    sections = [
        Section("Claims", tables=[table]),
        Section("Why not", [f"{row['claim']}. {row['why']}" for row in rows if row.get("why")]),
        Section("Figures", figures=[embedded(path, path.stem, path.name) for path in pictures]),
    ]
    if (folder / "claims.png").is_file():
        caption = "Intervals relative to the bound, scaled by their size; the claimed side is to the right."
        sections.insert(1, Section("Intervals", figures=[embedded(folder / "claims.png", "Intervals", caption)]))
    variables = {
        "heading": "Claims of the paper",
        "name": folder.resolve().name,
        "sentence": claims_sentence(rows),
        "numbers": [],
        "sections": sections,
        "footer": ["Numbers: claims.json. Table: claims.md."],
    }
    return write_page(folder, variables)
