"""Tracing of NumPy code by JAX: an array class that dispatches NumPy functions to `jax.numpy`.

The derivation of engine parameters from model fields and the fitness functions are NumPy code that runs on the host in
double precision. `TracedArray` makes the same code traceable: it implements `__array_function__` and `__array_ufunc__`,
NumPy's dispatch protocols. `in_double` runs such code in double precision inside a program of any precision.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from numpy.lib.mixins import NDArrayOperatorsMixin


class TracedArray(NDArrayOperatorsMixin):
    """A JAX array that NumPy's functions and operators accept; their results are `TracedArray`s too.

    It has the attributes and methods of a `jax.Array`, and `jax.numpy` accepts it. NumPy functions that `jax.numpy`
    does not have, in-place changes, and decisions on values raise TypeError.
    """

    def __init__(self, value: jax.Array):
        self._value = value

    def __jax_array__(self) -> jax.Array:
        return self._value

    def __getitem__(self, index: Any) -> "TracedArray":
        return _wrapped(self._value[_plain(index)])

    def __len__(self) -> int:
        return len(self._value)

    def __iter__(self) -> Iterator["TracedArray"]:
        return (self[i] for i in range(len(self)))

    def __bool__(self) -> bool:
        raise TypeError("a decision depends on a value of a rollout that is being compiled; use np.where instead")

    def __getattr__(self, name: str) -> Any:
        # Protocols such as `__array__` are not forwarded: they would pass the traced value to NumPy itself.
        if name.startswith("_"):
            raise AttributeError(name)
        found = getattr(self._value, name)
        if not callable(found):
            return _wrapped(found)
        return lambda *args, **kwargs: _wrapped(found(*_plain(args), **_plain(kwargs)))

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or not hasattr(jnp, ufunc.__name__):
            return NotImplemented
        return _wrapped(getattr(jnp, ufunc.__name__)(*_plain(inputs), **kwargs))

    def __array_function__(self, function: Callable, types: Any, args: tuple, kwargs: dict) -> Any:
        namespace = jnp.linalg if function.__module__ == "numpy.linalg" else jnp
        if not hasattr(namespace, function.__name__):
            return NotImplemented
        return _wrapped(getattr(namespace, function.__name__)(*_plain(args), **_plain(kwargs)))


def in_double(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that computes in double precision, derivatives included, whatever the precision mode of JAX.

    It may use float64 arrays; it must convert its arguments to double precision and its results to the wanted precision
    itself. Derivatives are those of forward mode.
    """

    def run(*arguments: Any) -> Any:
        with jax.enable_x64(True):
            return function(*arguments)

    def derivative(primals: tuple, tangents: tuple) -> Any:
        values, tree = jax.tree.flatten(primals)
        slopes = jax.tree.leaves(tangents)
        moves = [not isinstance(slope, SymbolicZero) for slope in slopes]

        def both(values: list, slopes: list) -> Any:
            return jvp_of_moving(lambda *mixed: function(*jax.tree.unflatten(tree, mixed)), moves, values, slopes)

        # Without this rule JAX would differentiate the traced function outside of the double precision mode.
        return in_double(both)(values, [slope for one, slope in zip(moves, slopes, strict=True) if one])

    differentiable = jax.custom_jvp(run)
    differentiable.defjvp(derivative, symbolic_zeros=True)
    return differentiable


def jvp_of_moving(
    function: Callable[..., Any], moves: Sequence[bool], values: Sequence[Any], slopes: Sequence[Any]
) -> Any:
    """`jax.jvp` of a function by the arguments that move, which have slopes."""

    def of_moving(*moving: jax.Array) -> Any:
        given = iter(moving)
        return function(*(next(given) if one else x for one, x in zip(moves, values, strict=True)))

    return jax.jvp(of_moving, [x for one, x in zip(moves, values, strict=True) if one], list(slopes))


def _plain(tree: Any) -> Any:
    """Arguments for `jax.numpy`, which does not accept lists of numbers as arrays."""
    if isinstance(tree, TracedArray):
        return tree.__jax_array__()
    if isinstance(tree, dict):
        return {key: _plain(value) for key, value in tree.items()}
    if isinstance(tree, list) and all(isinstance(x, int | float) for x in tree):
        return np.asarray(tree)
    if isinstance(tree, list | tuple):
        return type(tree)(map(_plain, tree))
    return tree


def _wrapped(tree: Any) -> Any:
    if isinstance(tree, list | tuple):
        return type(tree)(map(_wrapped, tree))
    return TracedArray(tree) if isinstance(tree, jax.Array) else tree
