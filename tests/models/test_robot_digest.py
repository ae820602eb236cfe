"""Digests of robots: every part of them counts, and the files that their MJCF names."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import pytest
from small_robots import hopper

from btr_mjx.models import robot_digest
from btr_mjx.models.compilation import base_model

CODE = """
import sys
sys.path.insert(0, sys.argv[1])
from small_robots import hopper
from btr_mjx.models import robot_digest
print(robot_digest(hopper()))
"""


def test_a_digest_is_the_same_in_another_process() -> None:
    support = Path(sys.modules["small_robots"].__file__ or "").parent
    done = subprocess.run([sys.executable, "-c", CODE, str(support)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [robot_digest(hopper())]


def test_every_part_of_a_robot_counts() -> None:
    robot = hopper()
    changes = {
        "template": robot.template + " ",
        "simulation_box": robot.simulation_box.with_bits(9),
        "controller_box": robot.controller_box.with_bits(9),
        "signal": lambda c, time, xp: c[0:1] * xp.sin(10.0 * time + c[1:2]),
        "nominal": (0.3, 0.1, 801.0),
        "constants": (("g", 9.8),),
        "duration": 0.041,
        "speed_limit": 49.0,
        "base_body": None,
    }
    digests = [robot_digest(robot)] + [robot_digest(dataclasses.replace(robot, **{k: v})) for k, v in changes.items()]
    assert len(set(digests)) == len(digests)
    elsewhere = dataclasses.replace(robot, name="other", template_path="/elsewhere.xml")
    assert robot_digest(elsewhere) == digests[0]


@pytest.mark.parametrize("name", ["body.xml", "box.obj"])
def test_files_of_the_model_count(tmp_path: Path, name: str) -> None:
    def digest() -> str:
        base_model.cache_clear()
        return robot_digest(robot)

    corners = [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    (tmp_path / "box.obj").write_text("\n".join([*corners, "f 1 2 3", "f 2 3 4", "f 1 2 5", "f 5 6 7"]))
    (tmp_path / "body.xml").write_text(
        '<mujoco><asset><mesh name="box" file="box.obj" scale="1 1 1"/></asset></mujoco>'
    )
    text = """<mujoco><include file="body.xml"/><worldbody><body name="base"><freejoint/>
    <geom type="mesh" mesh="box"/></body></worldbody></mujoco>"""
    robot = dataclasses.replace(hopper(), template=text, plain=True, folder=str(tmp_path), edits=())
    before = digest()
    assert digest() == before
    path = tmp_path / name
    path.write_text(path.read_text().replace('scale="1 1 1"', 'scale="2 1 1"').replace("v 1 1 1", "v 1 1 2"))
    os.utime(path, (0, 0))  # MuJoCo caches meshes by their time, to the second
    assert digest() != before
