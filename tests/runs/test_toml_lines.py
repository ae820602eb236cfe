"""Errors of TOML files name the line."""

import re
from pathlib import Path

import pytest

from btr_mjx.errors import InputError
from btr_mjx.gap.data import open_dataset
from btr_mjx.models import load_robot
from btr_mjx.runs.toml_lines import line_of

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("right", "wrong", "error"),
    [
        ('keyframe = "stand"', 'keyframe = "stands"', "stands"),
        ('base_body = "trunk"', 'bas_body = "trunk"', "unknown key 'bas_body'"),
        ("duration = 2.0", 'duration = "long"', "duration = 'long'"),
        ("bounds = [3.0, 12.0]", "bounds = [12.0, 3.0]", "bounds"),
        ("relative = true", "relative = 1", "relative = 1"),
        ('path = "body:trunk/mass"', 'path = "body:trnk/mass"', "trnk"),
        ("frequency = [1.0, 3.0]", "freqency = [1.0, 3.0]", "freqency"),
        ('name = "knees"', 'name == "knees"', "not valid TOML"),
    ],
)
def test_robots(right: str, wrong: str, error: str, tmp_path: Path) -> None:
    text = (EXAMPLES / "quadruped" / "robot.toml").read_text()
    (tmp_path / "robot.xml").write_text((EXAMPLES / "quadruped" / "robot.xml").read_text())
    file = tmp_path / "robot.toml"
    file.write_text(text.replace(right, wrong))
    line = next(i for i, row in enumerate(file.read_text().splitlines(), 1) if wrong in row)
    with pytest.raises(InputError) as raised:
        load_robot(tmp_path)
    said = str(raised.value)
    assert error in said
    assert f"line {line}" in said
    assert said.startswith(str(file))


def test_datasets(tmp_path: Path) -> None:
    file = tmp_path / "dataset.toml"
    (tmp_path / "robot.xml").write_text((EXAMPLES / "thrower" / "robot.xml").read_text())
    file.write_text(
        '[model]\nfile = "robot.xml"\n\n[[recording]]\nfile = "a.csv"\n\n[[recording]]\nfile = "../b.csv"\n'
    )
    (tmp_path / "a.csv").write_text("time\n0\n")
    with pytest.raises(InputError, match=re.escape(f"{file}, line 8: [[recording]] 2")):
        open_dataset(tmp_path)
    file.write_text('[model]\nfile = "robot.xml"\nunmeasured = ["knee"]\n\n[[recording]]\nfile = "a.csv"\n')
    with pytest.raises(InputError, match=re.escape(f"{file}, line 3: [model] unmeasured")):
        open_dataset(tmp_path)


def test_servos(tmp_path: Path) -> None:
    file = tmp_path / "servo.toml"
    file.write_text("[servo]\nkt = 1.0\nresistance = -2.0\nerror_gain = 1.0\n")
    with pytest.raises(InputError, match=re.escape(f"{file}, line 3: ")):
        open_dataset(tmp_path)
    file.write_text("# a servo\n[servo]\nkt = 1.0\nerror_gain = 1.0\n")
    with pytest.raises(InputError, match=re.escape(f"{file}, line 2: [servo] has no resistance")):
        open_dataset(tmp_path)


def test_a_line_is_that_of_the_key() -> None:
    toml = 'name = "a"\n[[row]]\nname = "b"\n[[row]]\n"name" = "c"\n[row.part]\nname = 1\n[other]\n'
    assert line_of(toml, "name = 'a': expected") == 1
    assert line_of(toml, "[[row]] 2: name = 'c': expected") == 5
    assert line_of(toml, "[[row]] 1: nothing is known") == 2
    assert line_of(toml, "[row.part] name = 1: expected") == 7
    assert line_of(toml, "unknown key 'other'; nearest") == 8
    # A word of a sentence that happens to be a key is none.
    assert line_of(toml, "there is no [[part]]; name at least one") is None
    assert line_of(toml, "[[row]] 3: name = 'c'") is None
