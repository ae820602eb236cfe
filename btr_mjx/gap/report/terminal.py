"""Text for the terminal: findings before the search, the verdict after it, and the hidden truth of a demo."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from btr_mjx.gap.preflight import Finding
from btr_mjx.gap.report.content import is_json_number
from btr_mjx.gap.results import (
    as_float,
    effect_title,
    hypotheses_of,
    place_in_words,
    score_in_words,
    together_in_words,
)
from btr_mjx.pages import PAGE


def print_findings(findings: Sequence[Finding], what: str = "", notes: bool = True) -> None:
    """Print the findings of preflight, errors first; nothing where there are none.

    Args:
      findings: to print.
      what: recordings that they are about, where there are several sets.
      notes: print what is neither an error nor a warning, too.
    """
    findings = [finding for finding in findings if notes or finding.level != "note"]
    if not findings:
        return
    print(f"preflight{f' of {what}' if what else ''}")
    for finding in findings:
        mark = "" if finding.level == "note" else f"{finding.level}: "
        print(textwrap.fill(f"{mark}{finding.message}", 110, initial_indent="  - ", subsequent_indent="    "))
        if finding.lines:
            print("\n" + "\n".join(finding.lines) + "\n")
    print(flush=True)


def print_result(result: Mapping[str, Any], folder: Path, page: bool = True) -> None:
    """Print the verdict, the first six candidates of the ranking, and what else there is to say.

    Args:
      result: content of result.json.
      folder: the run folder.
      page: whether its page is there, or drawn next.
    """
    print(textwrap.fill(str(result["sentence"]), 110))
    alone = [row for row in result["ranking"] if not row["beside"]]
    top = max((as_float(row["score"]) or 0.0 for row in alone), default=0.0)
    rows = hypotheses_of(alone)[:6]
    confirmed = any(is_json_number(many[0]["held_out"]) for many in rows)
    names = [textwrap.wrap(together_in_words(many), 80) for many in rows]
    width = max((len(line) for lines in names for line in lines), default=0)
    if rows:
        print(f"\n{'candidate':{width}}{'score [%]':>12}{'held-out gain [%]' if confirmed else '':>20}".rstrip())
        held_out = "; held-out gain: on data that were not used" if confirmed else ""
        print(f"(score: gain over the believed model, in per cent of the best{held_out})")
    for many, lines in zip(rows, names, strict=True):
        held = f"{score_in_words(many[0]['held_out'], top):>20}" if is_json_number(many[0]["held_out"]) else ""
        print(f"{lines[0]:{width}}{score_in_words(many[0]['score'], top):>12}{held}")
        print("".join(f"  {line}\n" for line in lines[1:]), end="")
    if rows and result.get("details"):
        print()
    for line in result.get("details") or []:
        print(textwrap.fill(line, 110, initial_indent="  - ", subsequent_indent="    "))
    ends = (("mended model", "mended.xml"), ("ranges for randomisation", "randomisation.json"))
    there = [f"page {folder / PAGE}"] if page else []
    there += [f"{what} {folder / name}" for what, name in ends if (folder / name).is_file()]
    print(f"\n{'; '.join(there) or f'all files in {folder}'}")


def print_truth(truth: Mapping[str, Any]) -> None:
    """Print the truth of a hidden case.

    Args:
      truth: content of truth.json.
    """
    hidden = [
        f"{effect_title(e['effect'])} at {place_in_words(e['location'])} "
        f"({', '.join(f'{name} {value:.4g}' for name, value in e['parameters'].items())})"
        for e in truth["effects"]
    ]
    print(f"hidden was: {' and '.join(hidden)}")
