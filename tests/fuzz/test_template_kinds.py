"""Kinds of hostile templates: one clear line, in seconds; and what templates are for."""

import time
from collections.abc import Iterator

import pytest

from btr_mjx.errors import InputError, one_line
from btr_mjx.robots import Box, Robot, Sinusoids


@pytest.fixture(autouse=True)
def quick() -> Iterator[None]:
    """No input takes long, however it ends."""
    begin = time.process_time()
    yield
    assert time.process_time() - begin < 20


def short(value: object) -> str:
    """Name of a case."""
    return (value if isinstance(value, str) else repr(value))[:30]


def template(text: str) -> Robot:
    signal = Sinusoids((0,), (1,), (), -1, 1.0, (0.0,), (1.0,), (0.0,))
    return Robot("r", text, "r.xml.j2", Box(["a", "b"], 0.1, 1.0), Box(["x", "y"], 0.0, 1.0), signal, (0.5, 0.5))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{{ sqrt(a - 5) }}", "domain"),
        ("{{ max([]) }}", "empty"),
        ("{{ '%s %s' % a }}", "format"),
        ("{{ '%9999d' % 1 }}", "width"),
        ("{{ '{:>99999999}'.format(a) }}", "unsafe"),
        ("{{ 9 ** 9 ** 9 ** 9 }}", "integer"),
        ("{{ 'ab' * 10 ** 11 }}", "characters"),
        ("{{ [a] * 10 ** 11 }}", "characters"),
        ("{% for i in range(3000) %}{% for j in 'x' * 9999 %}{% set z = i %}{% endfor %}{% endfor %}", "computes"),
        ("{% for i in [1] * 9999 if [1] * 9999 == [i] * 9999 %}{% endfor %}" * 300, "computes"),
        ("{% macro m(n) %}{{ m(n) }}{% endmacro %}{{ m(1) }}", "deeply"),
        ("{% macro m(n) %}{% set x = n and m(n - 1) ~ m(n - 1) %}1{% endmacro %}{{ m(50) }}", "computes"),
        ("{{ " + "(" * 900 + "a" + ")" * 900 + " }}", "nested"),
        ("{{ " + "-" * 100_000 + "a }}", "words|nested"),
        ("{% for i in range(30) %}" * 30 + "{% endfor %}" * 30, "nested"),
        ("{% set x %}{% for i in range(99999) %}" + "y" * 999 + "{% endfor %}{% endset %}", "writes"),
        ("{% set n = namespace(x='ab') %}{% for i in range(99) %}{% set n.x = n.x + n.x %}{% endfor %}", "characters"),
        ("{% set n = namespace(x=[a]) %}{% for i in range(99) %}{% set n.x = (n.x, n.x) %}{% endfor %}", "characters"),
        ("{{ cycler(1) }}", "undefined"),
        ("{{ joiner() }}", "undefined"),
        ("{{ lipsum(n=9) }}", "undefined"),
        ("{% include 'x' %}", "not part"),
        ("{% import 'x' as y %}", "not part"),
        ("{{ a | pprint }}", "No filter"),
        ("{{ a | center(10 ** 9) }}", "No filter"),
        ("{{ 1 | round(10 ** 9) }}", "digits"),
        ("{{ ''.__class__ }}", "unsafe"),
        ("{{ " + "1" * 5000 + " }}", "digits"),
        ("{{ {}['k'] }}", "no attribute"),
        ("x" * 1_000_001, "read"),
    ],
    ids=short,
)
def test_templates(text: str, named: str) -> None:
    with pytest.raises(InputError) as caught:
        template(text).render([0.5, 0.5])
    assert any(word in one_line(caught.value) for word in named.split("|")), one_line(caught.value)


def test_what_templates_are_for_still_works() -> None:
    text = """{% set legs = [(1, a), (-1, b)] %}{% set n = namespace(top=0) -%}
{% macro part(x, y=2) %}<{{ x }}/{{ y }}>{% endmacro -%}
{% for side, length in legs -%}
{% set n.top = max(n.top, side * length) %}{{ loop.index }}{{ part(side) }} {% endfor -%}
{{ n.top }} {{ '%.3f' % a }}
{{ [1, 2] | join(',') }} {{ a ~ 'm' }} {{ (a * 2) | round(1) }} {{ -7 // 2 }} {{ 2 ** 3 }}"""
    assert template(text).render([0.5, 0.25]) == "1<1/2> 2<-1/2> 0.5 0.500\n1,2 0.5m 1.0 -4 8"
