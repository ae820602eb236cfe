"""Robots of Gymnasium from a robot.toml: whole co-evolutions of MJCF that others wrote."""

import json
from pathlib import Path

import pytest

from btr_mjx import coevolve

gymnasium = pytest.importorskip("gymnasium")
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"

ROBOTS = {
    "half_cheetah": ('point = "torso"', "joint:bthigh/damping", [1.0, 12.0], "body:torso/mass"),
    "hopper": ('point = "torso"', "joint:leg_joint/damping", [0.2, 3.0], "body:torso/mass"),
    "ant": ('base_body = "torso"', "joint:hip_1/armature", [0.1, 3.0], "body:torso/mass"),
}


@pytest.mark.filterwarnings("ignore:compiler attribute:UserWarning")
@pytest.mark.parametrize("name", ROBOTS)
def test_a_public_model_is_co_evolved(name: str, tmp_path: Path) -> None:
    what, path, bounds, mass = ROBOTS[name]
    lines = [
        f'model = "{ASSETS / name}.xml"',
        what,
        "duration = 0.4",
        "[[parameter]]",
        'name = "joint"',
        f'path = "{path}"',
        f"bounds = {bounds}",
        "[[parameter]]",
        'name = "load"',
        f'path = "{mass}"',
        "bounds = [0.5, 2.0]",
        "relative = true",
        "[controller]",
        'signal = "sinusoid"',
        "frequency = 2.0",
    ]
    assert len(lines) <= 20
    (tmp_path / "robot.toml").write_text("\n".join(lines) + "\n")
    small = ("--engine=native", "--trials=4", "--controllers=8", "--controller-generations=2", "--simulations=12")
    more = ("--simulation-generations=10", "--iterations=1", "--optimiser=cma", "--no-progress", "--no-figures")
    coevolve.main(["--robot", str(tmp_path / "robot.toml"), "--out", str(tmp_path / "run"), *small, *more])
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert result["delta_fitness_last"] < 0.5 * result["delta_fitness_first"]
