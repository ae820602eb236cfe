"""Jinja2 for templates that others wrote: no access to Python, and bounded time, memory and output.

Jinja2's sandbox keeps a template away from Python's internals, but a few words of it still ask for any amount of work:
nested loops, `10 ** 10 ** 10`, `"x" * 10 ** 12`, `"%1000000000d"`, macros that call themselves twice. Here

- calls, operators, loops, filters and comparisons are counted, and stop after `MAX_SECONDS` of computing; arithmetic
  on floats, which is quick and bounded, is not counted;
- every value is at most `MAX_WEIGHT` numbers and characters, and the text at most `MAX_OUTPUT` characters;
- only filters and methods are there whose result is not larger than what goes in;
- blocks, inheritance, includes and imports are not part of the language: a template is one file.
"""

import math
import re
import time
from collections.abc import Callable, Mapping
from typing import Any

import jinja2
from jinja2 import filters, nodes
from jinja2.runtime import Context
from jinja2.sandbox import ImmutableSandboxedEnvironment
from jinja2.visitor import NodeTransformer

MAX_TEMPLATE = 1_000_000
"""Most characters of a template."""

MAX_OUTPUT = 16 << 20
"""Most characters that a template may write, counting those that it keeps in variables and, for every turn of a loop,
all text inside the loop."""

MAX_TOKENS = 50_000
"""Most words of the language in a template, spaces included; compiling so many takes a second."""

MAX_WEIGHT = 200_000
"""Most numbers and characters of one value."""

MAX_INTEGER_BITS = 1024
"""Size of an integer that a float can hold."""

MAX_SECONDS = 1.0
"""Computing time of one rendering [s]; the hexapod's takes half a millisecond."""

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": math.sin,
    "cos": math.cos,
    "radians": math.radians,
    "sqrt": math.sqrt,
    "min": min,
    "max": max,
}
"""Functions of a template, beside Jinja2's range, dict and namespace."""

_ELEMENTARY = frozenset((math.sin, math.cos, math.radians, math.sqrt))
"""Functions that take and return one float, quickly."""

_FILTERS = (
    *("abs", "int", "float", "length", "count", "first", "last", "min", "max", "sum", "list", "sort", "reverse"),
    *("unique", "map", "select", "reject", "selectattr", "rejectattr", "string", "upper", "lower", "trim", "default"),
    *("d", "items", "dictsort"),
)
_METHODS = ("items", "keys", "values", "get", "index", "count", "upper", "lower", "strip", "startswith", "endswith")
_FORBIDDEN = (nodes.Block, nodes.Extends, nodes.Include, nodes.Import, nodes.FromImport, nodes.FilterBlock)
_COUNTED = (float, int, bool)
"""Types whose values the length of what holds them counts."""


class TemplateLimit(jinja2.TemplateError):
    """A template asks for more than a model needs."""


class _Work(Context):
    """The context of one rendering, which counts its work."""

    steps = 0
    written = 0
    begin: float | None = None

    def step(self) -> None:
        self.steps += 1
        if self.steps % 256 == 0:  # reading this clock takes as long as a hundred steps
            now = time.thread_time()
            self.begin = now if self.begin is None else self.begin
            if now - self.begin > MAX_SECONDS:
                raise TemplateLimit(f"it computes for more than {MAX_SECONDS:g} s")

    def write(self, characters: int) -> None:
        self.written += characters
        if self.written > MAX_OUTPUT:
            raise TemplateLimit(f"it writes more than {MAX_OUTPUT} characters")


def weight(value: Any) -> int:
    """Numbers and characters of a value with everything inside it, counted up to a little above `MAX_WEIGHT`."""
    if isinstance(value, str | bytes):
        return len(value)
    if not isinstance(value, list | tuple | dict | range):
        return 1
    total, left = 0, [value]
    while left and total <= MAX_WEIGHT:
        item = left.pop()
        if isinstance(item, str | bytes | range):
            total += len(item)
        elif isinstance(item, list | tuple | dict):
            total += 1 + len(item)
            if total <= MAX_WEIGHT:
                inside = [*item, *item.values()] if isinstance(item, dict) else item
                left += [value for value in inside if type(value) not in _COUNTED]
    return total


def _bounded(value: Any) -> Any:
    kind = type(value)
    if kind is float or kind is bool:
        return value
    if kind is int:
        if value.bit_length() > MAX_INTEGER_BITS:
            raise TemplateLimit("an integer is larger than any float")
    elif weight(value) > MAX_WEIGHT:
        raise TemplateLimit(f"a value has more than {MAX_WEIGHT} numbers and characters")
    return value


def _check_format(text: Any) -> None:
    if isinstance(text, str | bytes) and re.search(r"\d{4}|\*", str(text)):
        raise TemplateLimit(f"the format {str(text)[:40]!r} has a width of more than three digits")


@jinja2.pass_context
def _printed(context: _Work, value: Any) -> str:
    """The text of a printed value."""
    text = str(value if isinstance(value, str | float) else _bounded(value))
    context.write(len(text))
    return text


class TemplateEnvironment(ImmutableSandboxedEnvironment):
    """The language of templates; see the module's notes."""

    intercepted_binops = frozenset(("+", "*", "%", "**"))  # the others do not make large values of small ones
    context_class = _Work

    def __init__(self) -> None:
        super().__init__(undefined=jinja2.StrictUndefined, autoescape=False, finalize=_printed)
        self.globals = {name: self.globals[name] for name in ("range", "dict", "namespace")} | dict(FUNCTIONS)
        own = {"format": _format, "join": _join, "replace": _replace, "round": _round}
        self.filters = {name: self.filters[name] for name in _FILTERS} | own

    def template(self, text: str) -> jinja2.Template:
        """The compiled template of a text.

        Raises jinja2.TemplateError where its syntax is wrong, or it is too large or nested too deeply.
        """
        if len(text) > MAX_TEMPLATE:
            raise TemplateLimit(f"it has {len(text)} characters, at most {MAX_TEMPLATE} are read")
        for count, (_, kind, _) in enumerate(self.lex(text)):
            if count > MAX_TOKENS and kind != "data":
                raise TemplateLimit(f"it has more than {MAX_TOKENS} words in its tags")
        try:
            tree = _Counted(self).visit(self.parse(text))
            return self.from_string(tree)
        except (RecursionError, MemoryError, SyntaxError):  # of Python's parser, for what Jinja2 makes of it
            raise TemplateLimit("expressions or loops are nested too deeply") from None
        except (ArithmeticError, TypeError, ValueError) as error:  # constants are computed here
            raise jinja2.TemplateError(str(error)) from None

    def is_safe_attribute(self, obj: Any, attr: str, value: Any) -> bool:
        """Methods of built-in types are those of `_METHODS`."""
        if isinstance(obj, str | bytes | int | float | list | tuple | dict | range) and attr not in _METHODS:
            return False
        return super().is_safe_attribute(obj, attr, value)

    def wrap_str_format(self, value: Any) -> None:
        """No wrapper: `format` is not among `_METHODS`."""

    def call(__self, __context: Any, __obj: Any, *args: Any, **kwargs: Any) -> Any:
        """Call a function or a macro."""
        if type(__obj) is type(math.sin) and __obj in _ELEMENTARY:
            return __obj(*args)  # Jinja2 passes keywords of its own
        __context.step()
        if __obj is __self._iteration:
            return __context.write(*args)
        if __obj is __self._value:
            return _bounded(args[0])
        for value in (*args, *kwargs.values()):
            _bounded(value)
        return _bounded(super().call(__context, __obj, *args, **kwargs))

    def call_binop(self, context: Any, operator: str, left: Any, right: Any) -> Any:
        """Compute an arithmetic operation."""
        if type(left) is float or (type(left) is int and type(right) is float):  # no large value
            return super().call_binop(context, operator, left, right)
        context.step()
        if operator == "%":
            _check_format(left)
        elif operator == "*":
            for times, value in ((left, right), (right, left)):
                if isinstance(times, int) and weight(value) * times > MAX_WEIGHT and not isinstance(value, int | float):
                    raise TemplateLimit(f"a value has more than {MAX_WEIGHT} numbers and characters")
        elif operator == "**" and isinstance(left, int) and isinstance(right, int):
            bits = left.bit_length() * right
            _bounded(1 << min(max(bits, 0), MAX_INTEGER_BITS))
        return _bounded(super().call_binop(context, operator, left, right))

    # What `_Counted` writes into a template; the names begin with an underscore, which templates cannot use.

    @staticmethod
    def _value(value: Any) -> Any:
        return value

    @staticmethod
    def _iteration(characters: int) -> None:
        """Count the characters that one turn of a loop writes at most, beside printed values."""

    @staticmethod
    def _joined(*values: Any) -> str:
        return "".join(map(str, values))


class _Counted(NodeTransformer):
    """Rewrites a template so that its loops, filters, comparisons and lists pass through the environment."""

    def __init__(self, environment: TemplateEnvironment) -> None:
        self.environment = environment

    def generic_visit(self, node: nodes.Node, *args: Any, **kwargs: Any) -> nodes.Node:
        if isinstance(node, _FORBIDDEN):
            what = type(node).__name__.lower()
            raise jinja2.TemplateSyntaxError(f"{what} is not part of this language", node.lineno)
        return super().generic_visit(node, *args, **kwargs)

    def _call(self, name: str, *values: nodes.Expr, line: int) -> nodes.Call:
        call = nodes.Call(nodes.EnvironmentAttribute(name), list(values), [], None, None)
        call.set_environment(self.environment).set_lineno(line)
        return call

    def visit_For(self, node: nodes.For) -> nodes.Node:
        characters = sum(len(part.data) for part in node.find_all(nodes.TemplateData))
        self.generic_visit(node)
        if node.test is not None:
            count = self._call("_value", nodes.Const(True), line=node.lineno)
            node.test = nodes.And(count, node.test).set_environment(self.environment).set_lineno(node.lineno)
        turn = self._call("_iteration", nodes.Const(characters), line=node.lineno)
        node.body.insert(0, nodes.ExprStmt(turn).set_lineno(node.lineno))
        return node

    def visit_Concat(self, node: nodes.Concat) -> nodes.Node:
        self.generic_visit(node)
        return self._call("_joined", *node.nodes, line=node.lineno)

    def visit_Filter(self, node: nodes.Filter) -> nodes.Node:
        self.generic_visit(node)
        if node.node is not None:  # None: the filter of a {% set %} block
            node.node = self._call("_value", node.node, line=node.lineno)
        return node

    def visit_Test(self, node: nodes.Test) -> nodes.Node:
        self.generic_visit(node)
        node.node = self._call("_value", node.node, line=node.lineno)
        return node

    def visit_Compare(self, node: nodes.Compare) -> nodes.Node:
        self.generic_visit(node)
        node.expr = self._call("_value", node.expr, line=node.lineno)
        for operand in node.ops:
            operand.expr = self._call("_value", operand.expr, line=node.lineno)
        return node

    def _container(self, node: nodes.Expr) -> nodes.Node:
        self.generic_visit(node)
        if getattr(node, "ctx", "load") != "load":  # the target of an assignment
            return node
        return self._call("_value", node, line=node.lineno)

    visit_List = visit_Tuple = visit_Dict = _container


def _format(value: Any, *args: Any, **kwargs: Any) -> str:
    _check_format(value)
    return filters.do_format(value, *args, **kwargs)


def _join(value: Any, d: str = "", attribute: None = None) -> str:
    items = [str(_bounded(item)) for item in value]
    if sum(map(len, items)) + len(str(d)) * len(items) > MAX_WEIGHT:
        raise TemplateLimit(f"a value has more than {MAX_WEIGHT} numbers and characters")
    return str(d).join(items)


def _replace(value: Any, old: str, new: str) -> str:
    text = str(value)
    if len(text) + text.count(str(old)) * len(str(new)) > MAX_WEIGHT:
        raise TemplateLimit(f"a value has more than {MAX_WEIGHT} numbers and characters")
    return text.replace(str(old), str(new))


def _round(value: Any, precision: int = 0, method: Any = "common") -> float:
    if not -300 <= precision <= 300:
        raise TemplateLimit(f"round to {precision} digits: expected -300 to 300")
    return filters.do_round(value, precision, method)
