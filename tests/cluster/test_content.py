"""Digests of content: equal in another process, different for whatever changes a behaviour."""

import dataclasses
import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_robots import hopper

from btr_mjx.cluster.content import digest_of, files_digest, robot_digest
from btr_mjx.errors import InputError
from btr_mjx.robots import hexapod
from btr_mjx.runs import load_object

CODE = """
import sys
sys.path.insert(0, sys.argv[1])
from small_robots import hopper
from btr_mjx.cluster.content import digest_of, robot_digest
print(robot_digest(hopper()), digest_of({"b": {3, "x", None}, "a": frozenset("abcdef")}))
"""


def test_digest_is_the_same_in_another_process() -> None:
    """Sets and hashes are ordered differently there."""
    support = Path(sys.modules["small_robots"].__file__ or "").parent
    done = subprocess.run([sys.executable, "-c", CODE, str(support)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [robot_digest(hopper()), digest_of({"a": frozenset("abcdef"), "b": {None, "x", 3}})]


def test_every_part_of_a_robot_counts() -> None:
    robot = hopper()
    box = robot.simulation_box
    slower = lambda c, time, xp: c[0:1] * xp.sin(10.0 * time + c[1:2])  # noqa: E731
    changes = {
        "template": robot.template + " ",
        "simulation_box": dataclasses.replace(robot, nominal=robot.nominal).simulation_box.with_bits(9),
        "controller_box": robot.controller_box.with_bits(9),
        "signal": slower,
        "nominal": (0.3, 0.1, 801.0),
        "constants": (("g", 9.8),),
        "duration": 0.041,
        "speed_limit": 49.0,
        "base_body": None,
    }
    digests = [robot_digest(robot)] + [robot_digest(dataclasses.replace(robot, **{k: v})) for k, v in changes.items()]
    assert len(set(digests)) == len(digests)
    assert robot_digest(dataclasses.replace(robot, name="other")) == digests[0]
    assert box == robot.simulation_box


def test_functions_count_by_what_they_do(tmp_path: Path) -> None:
    """Also through another function or a number of their file; not by lines around them."""
    text = "FACTOR = {factor}\ndef helper(x):\n    return x {sign} 1\n"
    text += "def own(outcome):\n    return FACTOR * helper(outcome)\n"

    def digest(name: str, text: str) -> str:
        (tmp_path / name).write_text(text)
        return digest_of(load_object(f"{tmp_path / name}:own", "fitness"))

    first = digest("a.py", text.format(factor=1, sign="+"))
    (tmp_path / "again").mkdir()
    assert digest("again/a.py", "UNUSED = 3\n" + text.format(factor=1, sign="+")) == first
    (tmp_path / "more").mkdir()
    assert digest("more/a.py", text.format(factor=2, sign="+")) != first
    (tmp_path / "most").mkdir()
    assert digest("most/a.py", text.format(factor=1, sign="-")) != first
    assert digest_of(functools.partial(max, 1)) != digest_of(functools.partial(max, 2))


def test_arrays_and_lists_count_by_value_type_and_shape() -> None:
    zeros = np.zeros((2, 3))
    others = [zeros.T, zeros.astype(np.float32), zeros + 1e-300, zeros.tolist(), -zeros]
    assert len({digest_of(x) for x in [zeros, *others]}) == 6
    assert digest_of(zeros) == digest_of(zeros.copy())
    assert digest_of("ab", "c") != digest_of("a", "bc")
    with pytest.raises(InputError, match="dataclass"):
        digest_of(x for x in ())


def test_files_of_the_model_count(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "box.stl").write_bytes(b"mesh")
    (tmp_path / "more.xml").write_text('<mujoco><asset><mesh file="box.stl"/></asset></mujoco>')
    text = '<mujoco><compiler meshdir="parts"/><include file="more.xml"/><worldbody/></mujoco>'
    robot = dataclasses.replace(hexapod(), template=text, plain=True, folder=str(tmp_path))
    before = files_digest(robot)
    assert before == files_digest(robot)
    (tmp_path / "parts" / "box.stl").write_bytes(b"MESH")
    assert files_digest(robot) != before
