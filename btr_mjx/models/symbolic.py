"""Symbolic rendering of a template: its numbers as vectorised functions of the parameters.

A template that only does arithmetic (no decision depends on a parameter) always renders to the same text around
different numbers. It is rendered once with `Number` objects, which record the operations applied to them and print as
marks. Each mark is then a function of the parameters, evaluated for many simulations at a time:

    skeleton = trace(robot)
    values, failed = skeleton.evaluate(simulations)     # (slots, L), (L,)

All operations are elementwise, in double precision and in the template's order: the values equal those that the
template computes, to the bit, and do not depend on the other simulations of the batch.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jinja2
import numpy as np

from btr_mjx.robots import Robot, compiled_template


class Untraceable(Exception):
    """The template uses a parameter in an operation that cannot be recorded; the message names it.

    Neither a ValueError nor a TypeError: Jinja2's filters `float` and `int` would catch these and return zero.
    """


@dataclass(frozen=True)
class _Node:
    """One operation; its operands are indices of earlier nodes (int) or constants (float)."""

    operation: str
    operands: tuple[int | float, ...]


class Graph:
    """All operations of one rendering in order; equal operations are recorded once."""

    def __init__(self, parameters: int) -> None:
        self.nodes = [_Node("parameter", (float(i),)) for i in range(parameters)]
        self._known: dict[tuple, int] = {}

    def apply(self, operation: str, *operands: Any) -> "Number":
        """Record an operation on numbers and constants and return its result."""
        places: list[int | float] = []
        for x in operands:
            if not isinstance(x, Number | int | float):
                raise Untraceable(f"{operation} of a parameter and {type(x).__name__}")
            places.append(x.place if isinstance(x, Number) else float(x))
        # Signed zeros are equal but not the same constant.
        key = (operation, *(x if isinstance(x, int) else x.hex() for x in places))
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(_Node(operation, tuple(places)))
        return Number(self, self._known[key])

    def evaluate(self, parameters: np.ndarray, places: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Values of some nodes.

        Args:
          parameters: (L, n) values of the parameters.
          places: indices of K nodes.

        Returns:
          (K, L) values, and bool (L,): rows at which the template's own arithmetic would raise an error or is not
          finite, whose values are undefined.
        """
        needed = set(places)
        for i in range(len(self.nodes) - 1, -1, -1):
            if i in needed and self.nodes[i].operation != "parameter":
                needed |= {x for x in self.nodes[i].operands if isinstance(x, int)}
        found: dict[int, np.ndarray] = {}
        failed = np.zeros(len(parameters), bool)
        with np.errstate(all="ignore"):
            for i in sorted(needed):
                node = self.nodes[i]
                if node.operation == "parameter":
                    found[i] = np.ascontiguousarray(parameters[:, int(node.operands[0])])
                else:
                    operands = (found[x] if isinstance(x, int) else x for x in node.operands)
                    found[i] = _OPERATIONS[node.operation](*operands)
                failed |= ~np.isfinite(found[i])
        values = np.empty((len(places), len(parameters)))
        for row, place in zip(values, places, strict=True):
            row[:] = found[place]
        return values, failed


class Number:
    """A number that depends on the parameters: arithmetic is recorded, printing writes a mark, all else is an error."""

    def __init__(self, graph: Graph, place: int) -> None:
        self.graph, self.place = graph, place

    def __str__(self) -> str:
        return f"{_OPEN}{self.place}{_CLOSE}"

    def __add__(self, other: Any) -> "Number":
        return self.graph.apply("+", self, other)

    def __radd__(self, other: Any) -> "Number":
        return self.graph.apply("+", other, self)

    def __sub__(self, other: Any) -> "Number":
        return self.graph.apply("-", self, other)

    def __rsub__(self, other: Any) -> "Number":
        return self.graph.apply("-", other, self)

    def __mul__(self, other: Any) -> "Number":
        return self.graph.apply("*", self, other)

    def __rmul__(self, other: Any) -> "Number":
        return self.graph.apply("*", other, self)

    def __truediv__(self, other: Any) -> "Number":
        return self.graph.apply("/", self, other)

    def __rtruediv__(self, other: Any) -> "Number":
        return self.graph.apply("/", other, self)

    def __pow__(self, other: Any) -> "Number":
        return self.graph.apply("**", self, other)

    def __rpow__(self, other: Any) -> "Number":
        return self.graph.apply("**", other, self)

    def __neg__(self) -> "Number":
        return self.graph.apply("neg", self)

    def __pos__(self) -> "Number":
        return self

    def __abs__(self) -> "Number":
        return self.graph.apply("abs", self)

    def _refuse(self, *_: object) -> Any:
        raise Untraceable("a decision, a comparison or a conversion depends on a parameter")

    __bool__ = __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = _refuse  # type: ignore[assignment]
    __float__ = __int__ = __index__ = __round__ = __floor__ = __ceil__ = __trunc__ = _refuse
    __mod__ = __rmod__ = __floordiv__ = __rfloordiv__ = __divmod__ = __len__ = __iter__ = _refuse
    __contains__ = __getitem__ = __format__ = _refuse  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]


_OPEN, _CLOSE = "\u27e6", "\u27e7"
"""Brackets around a mark, which do not occur in MJCF."""


def _divide(a: Any, b: Any) -> Any:
    return np.where(np.equal(b, 0), np.nan, np.divide(a, b))  # Python raises an error


def elementwise(function: Callable[..., float], *operands: Any) -> np.ndarray:
    """Apply a function of Python's math module to each element; numpy's functions may differ in the last bit.

    Args:
      function: a function of floats that returns a float.
      *operands: arrays or floats of shapes that broadcast.

    Returns:
      float64 array of the common shape; NaN where the function raises an error or returns a complex number.
    """

    def one(*xs: float) -> float:
        try:
            y = function(*xs)
        except (ArithmeticError, ValueError):
            return math.nan
        return y if isinstance(y, float) else math.nan

    arrays = np.broadcast_arrays(*operands)
    columns = [x.ravel().tolist() for x in arrays]
    try:
        values = np.array(list(map(function, *columns)), np.float64)
    except (ArithmeticError, ValueError, TypeError):
        values = np.array(list(map(one, *columns)), np.float64)
    return values.reshape(arrays[0].shape)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": _divide,
    "**": partial(elementwise, lambda x, y: x**y),
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,  # correctly rounded, as math.sqrt; NaN where that raises
    "sin": partial(elementwise, math.sin),
    "cos": partial(elementwise, math.cos),
    "radians": lambda x: np.multiply(x, math.pi / 180),
    # Python's rule for which of two arguments is returned, signed zeros included.
    "min": lambda a, b: np.where(np.less(b, a), b, a),
    "max": lambda a, b: np.where(np.greater(b, a), b, a),
}


def _template_functions(graph: Graph) -> dict[str, Callable[..., Any]]:
    """The functions of templates, extended to `Number` arguments."""

    def function(name: str, plain: Callable[[float], float]) -> Callable[[Any], Any]:
        return lambda x: graph.apply(name, x) if isinstance(x, Number) else plain(x)

    def extreme(name: str, plain: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            items = list(args[0]) if len(args) == 1 else list(args)
            if not any(isinstance(x, Number) for x in items):
                return plain(*args, **options)
            if options:
                raise Untraceable(f"{name} with {', '.join(options)} of a parameter")
            result = items[0]
            for x in items[1:]:
                result = graph.apply(name, result, x)
            return result

        return call

    single = {"sin": math.sin, "cos": math.cos, "radians": math.radians, "sqrt": math.sqrt}
    return {name: function(name, plain) for name, plain in single.items()} | {
        "min": extreme("min", min),
        "max": extreme("max", max),
    }


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A rendered template with slots for the numbers that depend on the parameters.

    Attributes:
      pieces: the text before, between and after the marks (one more than marks).
      marks: the slot of each mark.
      places: the node of each slot.
      graph: how the nodes are computed.
    """

    pieces: tuple[str, ...]
    marks: tuple[int, ...]
    places: tuple[int, ...]
    graph: Graph

    def evaluate(self, simulations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of the slots (slots, L), and bool (L,): rows that cannot be computed; see `Graph.evaluate`."""
        return self.graph.evaluate(simulations, self.places)

    def fill(self, values: Sequence[float]) -> str:
        """The MJCF with a value in each slot."""
        shown = [repr(float(x)) for x in values]
        between = [shown[i] + piece for i, piece in zip(self.marks, self.pieces[1:], strict=True)]
        return self.pieces[0] + "".join(between)

    def matches(self, text: str, values: Sequence[float]) -> bool:
        """Whether a text equals this one with these values in the slots, to the bit (1 and 1.0 count as equal)."""
        if not text.startswith(self.pieces[0]):
            return False
        at = len(self.pieces[0])
        for slot, piece in zip(self.marks, self.pieces[1:], strict=True):
            number = _NUMBER.match(text, at)
            if number is None or float(number[0]) != values[slot] or not text.startswith(piece, number.end()):
                return False
            at = number.end() + len(piece)
        return at == len(text)


_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")


def trace(robot: Robot) -> Skeleton:
    """Render a robot's template once with symbols for the parameters.

    Args:
      robot: the robot.

    Returns:
      The skeleton; a template that does not depend on any parameter has no slots.

    Raises:
      Untraceable: the template cannot be recorded.
    """
    names = robot.simulation_box.names
    graph = Graph(len(names))
    symbols = {name: Number(graph, i) for i, name in enumerate(names)}
    try:
        # Arguments of a template hide globals of the same name: the functions are replaced by those on symbols.
        text = compiled_template(robot.template).render(_template_functions(graph) | dict(robot.constants) | symbols)
    except (jinja2.TemplateError, ArithmeticError, TypeError, ValueError) as error:
        raise Untraceable(str(error)) from None
    parts = re.split(f"{_OPEN}(\\d+){_CLOSE}", text)
    places = [int(place) for place in parts[1::2]]
    slots = {place: i for i, place in enumerate(dict.fromkeys(places))}
    return Skeleton(tuple(parts[::2]), tuple(slots[p] for p in places), tuple(slots), graph)
