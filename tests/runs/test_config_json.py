import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import tyro
from run_configs import Config, Mutation

from btr_mjx.errors import InputError
from btr_mjx.runs import RunFolder, config_to_json, differences
from btr_mjx.runs.config_json import config_from_json, read_config


def test_config_round_trip(tmp_path):
    config = Config(stop=-math.inf, engine="mjx", out=Path("data/x"), mutation=Mutation(1.0, "binary"))
    with RunFolder.create(tmp_path / "run", config):
        pass
    assert read_config(tmp_path / "run", Config) == config
    assert config_from_json(Config, config_to_json(Config())) == Config()
    text = (tmp_path / "run" / "config.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["stop"] == "-Infinity"


def test_config_from_the_command_line_is_the_config_of_the_file():
    config = tyro.cli(Config, args=["--seed", "3", "--mutation.rate", "0.5", "--unknown", "bl_3", "--engine", "native"])
    assert config_from_json(Config, json.loads(json.dumps(config_to_json(config)))) == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sead": 1}, r"sead: no such field; Config has out, resume, seed"),
        ({"seed": 1.5}, r"seed: expected int, got 1\.5"),
        ({"seed": True}, r"seed: expected int, got True"),
        ({"box": [1.0]}, r"box: expected tuple\[float, float\], got \[1\.0\]"),
        ({"unknown": [1]}, r"unknown: expected tuple\[str, \.\.\.\], got \[1\]"),
        ({"unknown": "bl_5"}, r"unknown: expected tuple\[str, \.\.\.\], got 'bl_5'"),
        ({"engine": "warp"}, r"engine: expected .*Literal\['lanes', 'mjx', 'native'\].*, got 'warp'"),
        ({"mutation": {"coding": "hex"}}, r"mutation: expected Mutation, got \{'coding': 'hex'\}"),
        ({"stop": "many"}, r"stop: expected float, got 'many'"),
        ({"out": 3}, r"out: expected Path, got 3"),
    ],
)
def test_config_refuses(change, message):
    with pytest.raises(InputError, match=message):
        config_from_json(Config, config_to_json(Config()) | change)


@dataclass(frozen=True)
class Unsavable:
    thing: Any


def test_config_that_json_cannot_hold_is_a_bug_reported_before_anything_is_written(tmp_path):
    for config in (Unsavable(object()), Config(seed="3"), Config, 3):  # type: ignore[arg-type]
        with pytest.raises(TypeError):
            RunFolder.create(tmp_path / "run", config)
    assert list(tmp_path.iterdir()) == []


def test_differences_name_every_field():
    new = dataclasses.replace(Config(), seed=2, mutation=Mutation(0.2), box=(0.5, 1.6), out=Path("elsewhere"))
    found = differences(config_to_json(Config()), config_to_json(new), ignore=("out",))
    assert found == [
        "seed: saved 0, now 2",
        "box: saved [0.4, 1.6], now [0.5, 1.6]",
        "mutation: saved {'rate': 0.02, 'coding': 'gray'}, now {'rate': 0.2, 'coding': 'gray'}",
    ]
    assert differences({"a": 1}, {"c": True}) == ["a: saved 1, now (absent)", "c: saved (absent), now True"]
    assert differences({"a": 1}, {"a": 1.0}) == []
    assert differences({"a": 1}, {"a": True}) == ["a: saved 1, now True"]
    assert differences({"a": None}, {}) == ["a: saved None, now (absent)"]
