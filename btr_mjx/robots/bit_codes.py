"""Bit-string code of grid points: plain binary or the reflected Gray code.

Each parameter has a uniform grid that includes both bounds of its range:

    value = low + (high - low) * k / (2**bits - 1),   k = 0 .. 2**bits - 1

The index k is written with the most significant bit first, either in plain binary or in the reflected Gray code,
k ^ (k >> 1). In the Gray code neighbouring grid points differ in exactly one bit, so that one mutation can always make
the smallest step. In plain binary 0111 and 1000 are neighbours but differ in four bits (a Hamming cliff).

A genome is the concatenation of the bits of all parameters.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Code = Literal["binary", "gray"]
"""How a grid index is written as bits."""

MAX_BITS = 32
"""Largest number of bits of a parameter. Below the 53 bits of a float64, so that encoding a decoded genome is exact."""


def bits_to_index(bits: NDArray[np.bool_], code: Code) -> NDArray[np.int64]:
    """Grid indices (...) of bit strings (..., b), most significant first, b <= 62."""
    if code == "gray":
        bits = np.logical_xor.accumulate(bits, axis=-1)
    weights = np.int64(1) << np.arange(bits.shape[-1] - 1, -1, -1, dtype=np.int64)
    return bits.astype(np.int64) @ weights


def index_to_bits(index: NDArray[np.int64], n_bits: int, code: Code) -> NDArray[np.bool_]:
    """Bit strings (..., n_bits) of grid indices (...); the inverse of `bits_to_index`."""
    if code == "gray":
        index = index ^ (index >> 1)
    shifts = np.arange(n_bits - 1, -1, -1, dtype=np.int64)
    return (index[..., None] >> shifts & 1).astype(bool)


def genome_to_indices(genomes: NDArray[np.bool_], bits: Sequence[int], code: Code) -> NDArray[np.int64]:
    """Grid indices (..., n) of all parameters of genomes (..., sum(bits))."""
    used = _used_bits(bits)
    padded = np.zeros((*genomes.shape[:-1], *used.shape), dtype=bool)
    padded[..., used] = genomes
    return bits_to_index(padded, code)


def indices_to_genome(indices: NDArray[np.int64], bits: Sequence[int], code: Code) -> NDArray[np.bool_]:
    """Genomes (..., sum(bits)) of grid indices (..., n); the inverse of `genome_to_indices`."""
    return index_to_bits(indices, max(bits), code)[..., _used_bits(bits)]


def _used_bits(bits: Sequence[int]) -> NDArray[np.bool_]:
    """Which bits (n, max(bits)) a genome holds where every parameter is padded on the left to the same length.

    Leading zeros change neither a binary nor a Gray number, so that one array operation serves all parameters.
    """
    width = max(bits)
    return np.arange(width) >= width - np.array(bits)[:, None]
