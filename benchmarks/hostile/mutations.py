"""Mutations of valid inputs: of bytes, of structured values, of MJCF and of templates."""

import json
import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

VALUES: Sequence[Any] = (
    *(-1, 0, 1, 2**31, 2**63, -(2**63), 10**400, 16**5000, 0.0, -0.0, -1.0, 1e-300, 1e308, -1e308, 1e200, 5e-324),
    *(float("nan"), float("inf"), float("-inf"), True, False, "", "false", "1", "nan", "x" * 5000, "\x00", "\x1b[2J"),
    *("../x", "/dev/zero", "/etc/passwd", ".", "é", "joint:servo/damping", "body:arm/mass", "jnt_type[0]", "qpos0[0]"),
    *([], {}, [[]], [{}], [1, "x"], [0.0, 1e308], [1.0, 0.5], ["a", "a"], {"a": 1}, {"": {}}, None),
)
"""Values that take the place of others."""

WORDS: Sequence[str] = (
    *(
        "nan",
        "inf",
        "-1",
        "0",
        "1e300",
        "-1e300",
        "1e-300",
        "1000000",
        "99999999999999999999",
        "",
        " ",
        "1 2 3 4 5 6 7",
    ),
    *(
        "true",
        "false",
        "auto",
        "x",
        "é",
        "servo",
        "arm",
        "world",
        "free",
        "ball",
        "slide",
        "mesh",
        "hfield",
        "cylinder",
    ),
    *("0 0 0", "1 0 0 0", "0 0 0 0", "1e200 0 0", "/dev/zero", "../model.xml", "model.xml", "implicit", "RK4", "0.5"),
)
"""Values of attributes of MJCF."""

SNIPPETS: Sequence[str] = (
    '<replicate count="100000"><geom size="0.1"/></replicate>',
    '<replicate count="30"><replicate count="50"><body><joint/><geom size="0.1"/></body></replicate></replicate>',
    '<include file="model.xml"/>',
    '<include file="/dev/zero"/>',
    '<body><freejoint/><geom size="0.1"/></body>',
    '<body><joint type="ball"/><geom size="0.1" mass="-1"/></body>',
    '<geom type="plane" size="1 1 1"/>',
    '<composite type="cable" count="100000 1 1" size="1" prefix="c"><geom size="0.1"/></composite>',
    '<composite type="cable" count="9 1 1" size="1" curve="s"><geom type="capsule" size="0.01"/></composite>',
    '<flexcomp type="grid" count="300 300 300" spacing="0.1 0.1 0.1" name="f"/>',
    '<flexcomp type="grid" count="3 3 3" spacing="0.1 0.1 0.1" name="f" dim="3"/>',
    '<size memory="1000T"/>',
    '<size nuserdata="1000000000"/>',
    '<size nkey="5"/>',
    '<asset><texture name="t" type="2d" builtin="flat" width="1000000" height="1000000"/></asset>',
    '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
    '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>',
    '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>',
    '<geom type="hfield" hfield="h"/><geom type="mesh" mesh="m"/>',
    '<asset><mesh name="m" file="/dev/zero.stl"/></asset>',
    '<equality><connect body1="arm" anchor="0 0 0"/></equality>',
    '<equality><weld body1="arm"/><joint joint1="servo"/></equality>',
    '<tendon><fixed><joint joint="servo" coef="1e300"/></fixed></tendon>',
    '<tendon><spatial><site site="s"/></spatial></tendon>',
    '<keyframe><key qpos="nan"/></keyframe>',
    '<contact><pair geom1="rod" geom2="rod"/><exclude body1="arm" body2="world"/></contact>',
    '<option timestep="1e-12"/>',
    '<option iterations="2000000000" tolerance="0"/>',
    '<actuator><general name="g" joint="servo" dyntype="filter" delay="5" nsample="100000000"/></actuator>',
    '<actuator><position name="p" joint="servo" kp="1" dampratio="1e300"/></actuator>',
    '<sensor><jointpos joint="servo"/></sensor>',
    '<default><default class="a"><default class="a"/></default></default>',
    '<custom><numeric name="n" size="100000000" data="1"/></custom>',
    '<!DOCTYPE a [<!ENTITY b "x"><!ENTITY c "&b;&b;&b;">]>',
)
"""Elements of MJCF that ask for much, or name what is not there."""

PIECES: Sequence[str] = (
    *(
        "a",
        "b",
        "1",
        "0",
        "-1",
        "1e308",
        "10**9",
        "[]",
        "[1, 2]",
        "(a, b)",
        "{}",
        '"x"',
        '"%d"',
        "none",
        "true",
        "loop",
    ),
    *("range(9)", "range(10**9)", "namespace(x=a)", "dict(a=a)", "sqrt(-1)", "min([])", "max(a, b)", "sin", "lipsum()"),
    *("m(a)", "loop.index", "a.b", "a['b']", "[1][5]", "a.__class__", "'x'.format", "caller()", "varargs", "self"),
)
OPERATORS: Sequence[str] = (
    "+",
    "-",
    "*",
    "/",
    "//",
    "%",
    "**",
    "~",
    "==",
    "<",
    " in ",
    " and ",
    " or ",
    " is ",
    "|",
    ".",
)
FILTERS: Sequence[str] = (
    *(
        "abs",
        "int",
        "float",
        "round(2)",
        "round(10**9)",
        "length",
        "first",
        "sum",
        "list",
        "sort",
        "join(b)",
        "format(a)",
    ),
    *("map('abs')", "replace('', 'xx')", "center(10**9)", "indent(10**6)", "default(a)", "upper", "items", "string"),
)
STATEMENTS: Sequence[str] = (
    "{{% for i in {0} %}}{{{{ i }}}}{{% endfor %}}",
    "{{% for i in range(99999) %}}{{% for j in {0} %}}{{% endfor %}}{{% endfor %}}",
    "{{% if {0} %}}x{{% else %}}y{{% endif %}}",
    "{{% set z = {0} %}}{{{{ z }}}}",
    "{{% set ns = namespace(x={0}) %}}{{% for i in range(200) %}}{{% set ns.x = ns.x ~ ns.x %}}{{% endfor %}}",
    "{{% set ns = namespace(x={0}) %}}{{% for i in range(99) %}}{{% set ns.x = [ns.x, ns.x] %}}{{% endfor %}}",
    "{{% macro m(x) %}}{{{{ {0} }}}}{{% endmacro %}}{{{{ m(1) }}}}",
    "{{% macro m(x) %}}{{{{ m(x) ~ m({0}) }}}}{{% endmacro %}}{{{{ m(1) }}}}",
    "{{% call(x) m({0}) %}}x{{% endcall %}}",
    "{{% set z %}}{{{{ {0} }}}}{{% endset %}}",
    "{{% with z = {0} %}}{{{{ z }}}}{{% endwith %}}",
    "{{% include {0} %}}",
    "{{% block b %}}{{{{ {0} }}}}{{% endblock %}}",
    "{{% filter upper %}}{{{{ {0} }}}}{{% endfilter %}}",
    "{{# {0} #}}",
    "{{% raw %}}{0}",
    "{{{{ {0} ",
)


def mutate_bytes(data: bytes, random: Random) -> bytes:
    """Flip, replace, remove, insert or repeat bytes at a few places, with a preference for both ends."""
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 4, 8))):
        if not out:
            break
        place = random.randrange(len(out))
        if random.random() < 0.3:
            place = max(0, len(out) - 1 - random.randrange(min(len(out), 1000)))
        kind = random.randrange(7)
        count = random.choice((1, 1, 2, 4, 16, 200))
        if kind == 0:
            out[place] ^= 1 << random.randrange(8)
        elif kind == 1:
            out[place] = random.randrange(256)
        elif kind == 2:
            del out[place : place + count]
        elif kind == 3:
            out[place:place] = bytes(random.randrange(256) for _ in range(count))
        elif kind == 4:
            out[place:place] = out[place : place + count] * random.choice((1, 2, 50))
        elif kind == 5:
            del out[place:]
        else:
            digits = random.choice((b"9" * 30, b"-1", b"1e308", b"nan", b"0", b"\xff\xff\xff\x7f", b"\x00"))
            out[place : place + len(digits)] = digits
    return bytes(out)


def mutate_value(value: Any, random: Random) -> Any:
    """A copy of nested dicts and lists with one or two places changed."""
    for _ in range(random.choice((1, 1, 2))):
        value = _mutate_once(value, random)
    return value


def _mutate_once(value: Any, random: Random) -> Any:
    if not isinstance(value, dict | list) or not value or random.random() < 0.12:
        return _hostile(random)
    if isinstance(value, list):
        place, copied = random.randrange(len(value)), list(value)
        kind = random.randrange(6)
        if kind == 0:
            del copied[place]
        elif kind == 1:
            copied.insert(place, copied[place])
        else:
            copied[place] = _mutate_once(copied[place], random)
        return copied
    key, fresh = random.choice(list(value)), dict(value)
    kind = random.randrange(8)
    if kind == 0:
        del fresh[key]
    elif kind == 1:
        fresh[random.choice((f"{key}x", key[:-1], "file", "path", "é", ""))] = fresh[key]
    elif kind == 2:
        fresh[random.choice(list(value))] = _hostile(random)
    else:
        fresh[key] = _mutate_once(fresh[key], random)
    return fresh


def _hostile(random: Random) -> Any:
    if random.random() < 0.05:
        nested: Any = 1
        for _ in range(random.choice((10, 80, 3000))):
            nested = [nested]
        return nested
    return random.choice(VALUES)


def mutate_mjcf(text: str, random: Random) -> str:
    """MJCF with attributes replaced, elements moved, repeated or removed, or a snippet inserted."""
    for _ in range(random.choice((1, 1, 2, 3))):
        quotes = [i for i, letter in enumerate(text) if letter == '"']
        ends = [i + 1 for i, letter in enumerate(text) if letter == ">"]
        kind = random.randrange(5)
        if kind <= 1 and len(quotes) > 1:
            first = 2 * random.randrange(len(quotes) // 2)
            text = text[: quotes[first] + 1] + random.choice(WORDS) + text[quotes[first + 1] :]
        elif kind == 2 and ends:
            place = random.choice(ends)
            text = text[:place] + random.choice(SNIPPETS) + text[place:]
        elif whole := re.findall(r"<[^<>]*/>", text):  # elements without children
            piece = random.choice(whole)
            if kind == 3:
                text = text.replace(piece, "", 1)
            else:
                place = random.choice(ends)
                text = text[:place] + piece * random.choice((1, 2, 300)) + text[place:]
    return text


def random_expression(random: Random, depth: int = 3) -> str:
    """An expression of the template language, valid or not."""
    if depth == 0 or random.random() < 0.3:
        return random.choice(PIECES)
    kind = random.randrange(5)
    inner = random_expression(random, depth - 1)
    if kind == 0:
        return f"{inner}|{random.choice(FILTERS)}"
    if kind == 1:
        return f"({inner}{random.choice(OPERATORS)}{random_expression(random, depth - 1)})"
    if kind == 2:
        return f"[{inner}, {random_expression(random, depth - 1)}]"
    if kind == 3:
        count = random.choice((1, 30, 300, 3000))
        return "(" * count + inner + ")" * count
    return f"{random.choice(PIECES)}({inner})"


def mutate_template(text: str, random: Random) -> str:
    """A template with statements and expressions inserted."""
    for _ in range(random.choice((1, 1, 2))):
        place = random.choice([0, *(i + 1 for i, letter in enumerate(text) if letter == ">"), len(text)])
        piece = random.choice((*STATEMENTS, "{{{{ {0} }}}}", "{{{{ {0} }}}}")).format(random_expression(random))
        text = text[:place] + piece * random.choice((1, 1, 1, 2, 200)) + text[place:]
    return text


def to_toml(table: dict[str, Any]) -> str:
    """TOML of nested values; what TOML cannot say is written as it looks in JSON."""
    lines = []
    later: list[str] = []
    for key, value in table.items():
        name = json.dumps(key)
        if isinstance(value, dict) and value:
            lines_of = [f"{json.dumps(k)} = {_toml_value(v)}" for k, v in value.items()]
            later += ["", f"[{name}]", *lines_of]
        elif isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
            for row in value:
                later += ["", f"[[{name}]]", *(f"{json.dumps(k)} = {_toml_value(v)}" for k, v in row.items())]
        else:
            lines.append(f"{name} = {_toml_value(value)}")
    return "\n".join([*lines, *later]) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return _nested(value, _toml_value)
    return _number(value) if isinstance(value, int | float) and not isinstance(value, bool) else json.dumps(value)


def to_json(value: Any) -> str:
    """JSON of nested values, integers of any length included."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)}: {to_json(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return _nested(value, to_json)
    if isinstance(value, float):
        return json.dumps(value)
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 10_000:
        return "9" * 5000
    return _number(value) if isinstance(value, int) and not isinstance(value, bool) else json.dumps(value)


def _number(value: float) -> str:
    if isinstance(value, float):
        return repr(value)
    return f"{value:d}" if value.bit_length() <= 10_000 else hex(value)


def _nested(value: list[Any], write: Callable[[Any], str]) -> str:
    depth = 0
    while len(value) == 1 and isinstance(value[0], list):  # thousands deep: no recursion
        value, depth = value[0], depth + 1
    return "[" * (depth + 1) + ", ".join(map(write, value)) + "]" * (depth + 1)
