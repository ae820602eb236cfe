"""Digests of values: equal content, equal digest; anything else, another."""

import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property, partial

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.runs import content_digest, load_object


@dataclass(frozen=True)
class Part:
    size: float
    names: tuple[str, ...] = ()
    table: dict = field(default_factory=dict)

    @cached_property
    def area(self) -> float:
        return self.size**2


def scaled(x, factor=2.0):
    return factor * x


def maker(factor):
    return lambda x: factor * x


XML = "<mujoco><worldbody><body><geom size='{}'/></body></worldbody></mujoco>"

DIFFERENT = [
    lambda: 1,
    lambda: 1.0,
    lambda: True,
    lambda: "1",
    lambda: b"1",
    lambda: None,
    lambda: [1, [2]],
    lambda: [[1], 2],
    lambda: (1, [2]),
    lambda: {"a": 1},
    lambda: {"a": 2},
    lambda: np.zeros(2),
    lambda: np.zeros((2, 1)),
    lambda: np.zeros(2, np.float32),
    lambda: np.array([0.0, -0.0]),
    lambda: Part(1.0),
    lambda: Part(2.0),
    lambda: Part(1.0, table={"x": np.ones(1)}),
    lambda: scaled,
    lambda: partial(scaled, factor=3.0),
    lambda: maker(1.0),
    lambda: maker(2.0),
    lambda: mujoco.MjModel.from_xml_string(XML.format(1)),
    lambda: mujoco.MjModel.from_xml_string(XML.format(2)),
]


def test_equal_content_has_equal_digests_and_other_content_others():
    first, again = ([content_digest(make()) for make in DIFFERENT] for _ in range(2))
    assert first == again
    assert len(set(first)) == len(DIFFERENT)


def test_caches_do_not_count():
    part = Part(3.0)
    before = content_digest(part)
    assert part.area == 9.0
    assert content_digest(part) == before


def test_digests_are_the_same_in_every_process():
    text = "from btr_mjx.runs import content_digest; print(content_digest({'a': {3, 1, 2}}, 'b', frozenset('xyz')))"
    found = {subprocess.run([sys.executable, "-c", text], capture_output=True, text=True).stdout for _ in range(2)}
    assert found == {content_digest({"a": {3, 1, 2}}, "b", frozenset("xyz")) + "\n"}


def test_unknown_content():
    class Slot:
        __slots__ = ("x",)

    with pytest.raises(InputError, match="use a dataclass"):
        content_digest(Slot())
    numbers = iter(range(9))
    assert len({content_digest(Slot(), unknown=lambda _: bytes([next(numbers)])) for _ in range(2)}) == 2
    loop: list = []
    loop.append(loop)
    with pytest.raises(RecursionError):
        content_digest(loop)


def test_functions_count_by_what_they_do(tmp_path):
    """Also through another function or a number of their file; not by lines around them."""
    text = "FACTOR = {factor}\ndef helper(x):\n    return x {sign} 1\n"
    text += "def own(outcome):\n    return FACTOR * helper(outcome)\n"

    def digest(name, text):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "a.py").write_text(text)
        return content_digest(load_object(f"{tmp_path / name / 'a.py'}:own", "fitness"))

    first = digest("first", text.format(factor=1, sign="+"))
    assert digest("again", "UNUSED = 3\n" + text.format(factor=1, sign="+")) == first
    assert digest("factor", text.format(factor=2, sign="+")) != first
    assert digest("sign", text.format(factor=1, sign="-")) != first
    assert content_digest(partial(max, 1)) != content_digest(partial(max, 2))
