"""What is printed at the end of a diagnosis."""

from pathlib import Path
from typing import Any

import pytest

from btr_mjx.gap.report import print_result


@pytest.mark.parametrize("held_out", [None, 99.5])
def test_columns_of_candidates_stand_below_their_heads(
    held_out: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = ("joint:knee", "each:all")
    ranking = [
        {"effect": "armature", "location": place, "score": score, "held_out": held_out, "beside": ""}
        for place, score in zip(places, (12429.84, 7.0), strict=True)
    ]
    result: dict[str, Any] = {"sentence": "Something.", "ranking": ranking}
    print_result(result, tmp_path)
    lines = capsys.readouterr().out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("candidate"))
    below = lines[head + 2 : head + 4]
    assert "each with its own number" in below[1]
    for line, score in zip(below, ("100", "0.0563"), strict=True):
        assert line.index(score) + len(score) == lines[head].index("score [%]") + len("score [%]")
    assert ("held-out" in lines[head]) == (held_out is not None)
    assert len({len(line) for line in (lines[head], *below)}) == 1
