"""Genetic operators on bit strings: mutation and crossover."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from btr_mjx.errors import InputError

Crossover = Literal["uniform", "one_point", "two_point"]
"""uniform: each bit from either parent; one_point: head and tail; two_point: a segment of the circular genome."""


def mutate(genomes: NDArray[np.bool_], p_m: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Genomes (..., n_bits) with every bit flipped independently with probability p_m.

    Raises:
      InputError: p_m outside [0, 1].
    """
    check_probability("p_m", p_m)
    return genomes ^ (rng.random(genomes.shape) < p_m)


def crossover(
    first: NDArray[np.bool_],
    second: NDArray[np.bool_],
    p_c: float,
    kind: Crossover,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Make one child (..., n_bits) of each pair of parents of this shape.

    With probability p_c a pair is crossed, see `Crossover`; otherwise the child is a copy of `first`.
    """
    check_probability("p_c", p_c)
    if first.shape != second.shape:
        raise InputError(f"crossover: got parents of shapes {first.shape} and {second.shape}, expected equal shapes")
    n, pairs = first.shape[-1], (*first.shape[:-1], 1)
    # Cuts leave at least one bit to either parent, if the genome has two or more bits.
    if kind == "uniform":
        from_second = rng.random(first.shape) < 0.5
    elif kind == "one_point":
        from_second = np.arange(n) >= rng.integers(1, max(n, 2), pairs)
    elif kind == "two_point":
        from_second = (np.arange(n) - rng.integers(0, n, pairs)) % n < rng.integers(1, max(n, 2), pairs)
    else:
        raise InputError(f"crossover: got {kind!r}, expected one of {', '.join(map(repr, get_args(Crossover)))}")
    return np.where(from_second & (rng.random(pairs) < p_c), second, first)


def check_probability(name: str, value: float) -> None:
    """InputError where a number is NaN or outside [0, 1]."""
    if not 0 <= value <= 1:  # catches NaN too
        raise InputError(f"{name}: got {value!r}, expected a probability within [0, 1]")
