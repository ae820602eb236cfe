"""What a message says to write into dataset.toml."""

from pathlib import Path

from btr_mjx.gap.data import Answer


def test_lines_of_a_table_that_is_there_already_go_below_it(tmp_path: Path) -> None:
    """TOML has every table once."""
    file = tmp_path / "dataset.toml"
    file.write_text('[model]\nfile = "arm.xml"\n[units]\n"q_knee" = "deg"\n')
    told = Answer(file).lines(["[columns]", '"a" = "qpos/hip"', "[units]", '"q_hip" = "turn"'])
    assert told[0] == f"Add this to {file}:"
    assert any(line.startswith("([units] is there already") for line in told)
    assert not any("there already" in line for line in Answer(file).lines(["[columns]", '"a" = "qpos/hip"']))
    assert not any("there already" in line for line in Answer(file, "[model]").lines(["[units]", '"q_hip" = "turn"']))
