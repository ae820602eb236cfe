"""Functions that say how their forward-mode derivative is to be compiled."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.custom_derivatives import SymbolicZero


def with_derivative(
    function: Callable[..., Any], transform: Callable[[Callable[..., Any]], Callable[..., Any]]
) -> Callable[..., Any]:
    """A function whose `jax.jvp` goes through a transformation of its own derivative.

    Args:
      function: maps pytrees of arrays to a pytree of arrays.
      transform: called with the function (values of all inputs, tangents of those that move) -> (results, tangents of
        the floating-point results); returns what is traced in its place.

    Returns:
      The function. JAX's own derivative of it would be that of its finished program, equation by equation; this one is
      taken first and transformed afterwards. It costs nothing for inputs that do not move.
    """
    differentiable = jax.custom_jvp(function)

    def derivative(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
        values, tree = jax.tree.flatten(primals)
        slopes = jax.tree.leaves(tangents)
        moves = [not isinstance(slope, SymbolicZero) for slope in slopes]

        def both(values: list, slopes: list) -> tuple[list, list]:
            def of_moving(*moving: jax.Array) -> list:
                given = iter(moving)
                mixed = [next(given) if one else x for one, x in zip(moves, values, strict=True)]
                return jax.tree.leaves(function(*jax.tree.unflatten(tree, mixed)))

            moving = [x for one, x in zip(moves, values, strict=True) if one]
            results, derivatives = jax.jvp(of_moving, moving, slopes)
            return results, [x for x in derivatives if x.dtype != jax.dtypes.float0]

        results, found = transform(both)(values, [x for one, x in zip(moves, slopes, strict=True) if one])
        given = iter(found)
        smooth = [np.issubdtype(x.dtype, np.floating) for x in results]
        derivatives = [
            next(given) if one else np.zeros(x.shape, jax.dtypes.float0) for one, x in zip(smooth, results, strict=True)
        ]
        out = jax.tree.structure(jax.eval_shape(function, *primals))
        return jax.tree.unflatten(out, results), jax.tree.unflatten(out, derivatives)

    differentiable.defjvp(derivative, symbolic_zeros=True)
    return differentiable
