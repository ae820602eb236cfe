"""Box: a bounded space of named parameters, with a bit-string code for evolution.

The simulation space S and the controller space C of the paper are boxes: every parameter lies within [low, high].
`encode` and `decode` translate between vectors of the box and genomes (bit strings, see `bit_codes`), on which the
genetic operators of the paper work ("probability p_m per bit").
"""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from btr_mjx.errors import InputError
from btr_mjx.robots.bit_codes import MAX_BITS, Code, genome_to_indices, indices_to_genome

Size = int | tuple[int, ...]
"""Leading shape of drawn arrays, as numpy's `size`."""

# A bound that passed through float32 (every JAX array by default) may lie this far outside, relative to its size.
_FLOAT32_SLACK = 2 * float(np.finfo(np.float32).eps)


def _names(names: Iterable[str], what: str) -> tuple[str, ...]:
    if isinstance(names, str):
        raise InputError(f"{what}: got the single string {names!r}, expected a sequence of names; write ({names!r},)")
    result = tuple(names)
    bad = [name for name in result if not isinstance(name, str) or not name]
    if bad or not result:
        raise InputError(f"{what}: got {result!r}, expected one or more non-empty strings")
    twice = sorted({name for name in result if result.count(name) > 1})
    if twice:
        raise InputError(f"{what}: got {', '.join(twice)} more than once, expected distinct names; drop the repetition")
    return result


def _numbers(values: ArrayLike, what: str) -> NDArray[np.float64]:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: got {values!r}, expected an array of real numbers ({error})") from None


@dataclass(frozen=True, eq=False, init=False)
class Box:
    """Named parameters inside [low, high], with a bit-string code.

    An immutable value: the arrays are private read-only copies, and two boxes are equal (and hash alike) when every
    field is.

    Attributes:
      names: n distinct names.
      low: (n,) lower bounds, in the parameters' own units.
      high: (n,) upper bounds, above `low`.
      bits: n counts of bits, 1 .. 32: the grid has 2**bits points.
      code: "gray" (default) or "binary", see `bit_codes`.
      units: n unit strings such as "m" or "rad", "" where none was given; used in messages, tables and plots only.
    """

    names: tuple[str, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    bits: tuple[int, ...]
    code: Code
    units: tuple[str, ...]

    def __init__(
        self,
        names: Iterable[str],
        low: ArrayLike,
        high: ArrayLike,
        *,
        bits: int | Sequence[int] = 8,
        code: Code = "gray",
        units: str | Sequence[str] = "",
    ):
        """Check and copy the fields; one bound, count of bits or unit may stand for all parameters.

        Raises:
          InputError: repeated or empty names; bounds that are not finite or not low < high; counts of bits outside 1 ..
            32, or so many that neighbouring grid points would coincide in float64; an unknown code.
        """
        names = _names(names, "Box names")
        n = len(names)
        bounds = []
        for what, given in (("low", low), ("high", high)):
            bound = _numbers(given, f"Box {what}")
            if bound.shape not in ((), (n,)):
                raise InputError(f"Box {what}: got shape {bound.shape}, expected ({n},), one per name, or one number")
            bound = np.broadcast_to(bound, (n,)).copy()
            bound.flags.writeable = False
            bounds.append(bound)
        bits = tuple(bits) if isinstance(bits, Iterable) else (bits,) * n
        units = (units,) * n if isinstance(units, str) else tuple(units)
        for what, given, kind in (("bits", bits, (int, np.integer)), ("units", units, str)):
            if len(given) != n or not all(isinstance(item, kind) and not isinstance(item, bool) for item in given):
                raise InputError(f"Box {what}: got {given!r}, expected one value for all or {n}, one per name")
        if code not in get_args(Code):
            raise InputError(f"Box code: got {code!r}, expected one of {', '.join(map(repr, get_args(Code)))}")
        for name, lo, hi, b in zip(names, bounds[0].tolist(), bounds[1].tolist(), bits, strict=True):
            if not (np.isfinite(lo) and np.isfinite(hi) and lo < hi and np.isfinite(hi - lo)):
                raise InputError(
                    f"Box bounds of {name!r}: got [{lo}, {hi}], expected finite low < high; "
                    "a parameter that is known does not belong in the box of unknowns"
                )
            if not 1 <= b <= MAX_BITS:
                raise InputError(f"Box bits of {name!r}: got {b}, expected 1 .. {MAX_BITS}")
            if (hi - lo) / (2**b - 1) < 8 * np.spacing(max(abs(lo), abs(hi))):
                raise InputError(
                    f"Box bits of {name!r}: {b} bits over [{lo}, {hi}] are finer than float64 resolves; "
                    "use fewer bits, or measure the parameter from the middle of its range"
                )
        whole = tuple(int(b) for b in bits)
        for name, value in zip(Box.__dataclass_fields__, (names, *bounds, whole, code, units), strict=True):
            object.__setattr__(self, name, value)

    def _key(self) -> tuple:
        return self.names, tuple(self.low.tolist()), tuple(self.high.tolist()), self.bits, self.code, self.units

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Box) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.names)

    @property
    def n_bits(self) -> int:
        """Length of a genome: the bits of all parameters, in the order of `names`."""
        return sum(self.bits)

    @property
    def span(self) -> NDArray[np.float64]:
        """(n,) high - low."""
        return self.high - self.low

    @property
    def step(self) -> NDArray[np.float64]:
        """(n,) distance between neighbouring grid points."""
        return self.span / self._last

    @property
    def _last(self) -> NDArray[np.int64]:
        """(n,) index of the last grid point."""
        return (np.int64(1) << np.array(self.bits, dtype=np.int64)) - 1

    def index(self, name: str) -> int:
        """Position of a parameter.

        Raises:
          InputError: unknown name; the message lists the valid ones and the nearest match.
        """
        try:
            return self.names.index(name)
        except ValueError:
            near = difflib.get_close_matches(str(name), self.names, n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"unknown parameter {name!r}{hint} (valid: {', '.join(self.names)})") from None

    def indices(self, names: Iterable[str]) -> NDArray[np.int64]:
        """(k,) positions of k distinct parameters, in the order given; errors as `index`."""
        return np.array([self.index(name) for name in _names(names, "names")], dtype=np.int64)

    def validate(self, values: ArrayLike, what: str = "values") -> NDArray[np.float64]:
        """Check vectors of the box.

        A value outside by no more than the rounding of float32 counts as inside and is moved back onto the bound.

        Args:
          values: (..., n), in the parameters' units.
          what: what error messages call them.

        Returns:
          (..., n) a float64 copy.

        Raises:
          InputError: wrong length, NaN or outside the bounds; the message names the first such value, its parameter,
            its row (when there are leading axes), the range and a remedy.
        """
        array = _numbers(values, what)
        if array.ndim == 0 or array.shape[-1] != self.n:
            raise InputError(
                f"{what}: got shape {array.shape}, expected (..., {self.n}): one value for each of "
                f"{', '.join(self.names)}"
            )
        slack = _FLOAT32_SLACK * np.maximum(np.abs(self.low), np.abs(self.high))
        # Written so that NaN, which compares false with everything, is found too.
        bad = ~((array >= self.low - slack) & (array <= self.high + slack))
        if bad.any():
            *row, i = (int(j) for j in np.argwhere(bad)[0])
            where = f" in row {row[0] if len(row) == 1 else tuple(row)}" if row else ""
            more = f" ({int(bad.sum())} such values)" if bad.sum() > 1 else ""
            value, unit = float(array[(*row, i)]), f" {self.units[i]}" if self.units[i] else ""
            remedy = "look for the computation that made it NaN" if np.isnan(value) else "correct or clip it"
            raise InputError(
                f"{what}: got {value!r} for {self.names[i]!r}{where}, expected a value within "
                f"[{self.low[i]:.12g}, {self.high[i]:.12g}]{unit}{more}; {remedy}"
            )
        return self.clip(array)

    def clip(self, values: ArrayLike) -> NDArray[np.float64]:
        """(..., n) values moved onto the nearest bound where they lie outside; NaN stays NaN."""
        return np.clip(np.asarray(values, dtype=np.float64), self.low, self.high)

    def decode(self, genomes: ArrayLike) -> NDArray[np.float64]:
        """Translate genomes (..., n_bits), bool, or 0 and 1, into vectors of the box.

        Returns:
          (..., n) points of the grid; all zeros (in binary) decode to `low` exactly, the last grid point to `high`.

        Raises:
          InputError: as `validate_genomes`.
        """
        index = genome_to_indices(self.validate_genomes(genomes), self.bits, self.code)
        return np.where(index == self._last, self.high, self.low + self.span * (index / self._last))

    def encode(self, values: ArrayLike) -> NDArray[np.bool_]:
        """Translate vectors (..., n) of the box into genomes, by the nearest grid point.

        Returns:
          (..., n_bits) bool. `decode(encode(x))` is within half a `step` of x; `encode(decode(g))` is g.

        Raises:
          InputError: as `validate`.
        """
        array = self.validate(values, "values to encode")
        index = np.rint((array - self.low) / self.span * self._last).astype(np.int64)
        return indices_to_genome(index, self.bits, self.code)

    def validate_genomes(self, genomes: ArrayLike, what: str = "genomes") -> NDArray[np.bool_]:
        """Genomes (..., n_bits), bool, or 0 and 1, as bool; `what` is what error messages call them.

        Raises:
          InputError: wrong length, or entries other than 0 and 1.
        """
        array = np.asarray(genomes)
        if array.ndim == 0 or array.shape[-1] != self.n_bits:
            raise InputError(
                f"{what}: got shape {array.shape}, expected (..., {self.n_bits}): the bits of {self.n} parameters"
            )
        if array.dtype == bool:
            return array
        bits = array.astype(bool)
        if not np.array_equal(bits, array):
            raise InputError(f"{what}: got dtype {array.dtype} with entries other than 0 and 1, expected bool")
        return bits

    def sample(self, rng: np.random.Generator, size: Size = ()) -> NDArray[np.float64]:
        """Draw vectors uniformly from the box (not from its grid), (*size, n)."""
        return rng.uniform(self.low, self.high, (*np.ravel(size).astype(int), self.n))

    def random_genomes(self, rng: np.random.Generator, size: Size = ()) -> NDArray[np.bool_]:
        """Draw genomes with independent fair bits, (*size, n_bits): uniform over the grid, in either code."""
        return rng.integers(0, 2, size=(*np.ravel(size).astype(int), self.n_bits), dtype=np.uint8).astype(bool)

    def subspace(self, names: Iterable[str]) -> "Box":
        """The box of some of the parameters, in the order given; errors as `index`."""
        i = self.indices(names)
        return Box(
            [self.names[j] for j in i],
            self.low[i],
            self.high[i],
            bits=[self.bits[j] for j in i],
            code=self.code,
            units=[self.units[j] for j in i],
        )

    def embed(self, base: ArrayLike, names: Iterable[str], values: ArrayLike) -> NDArray[np.float64]:
        """Insert values of some parameters into full vectors, such as unknown parameters into a known simulation.

        Args:
          base: (..., n) full vectors; leading axes broadcast against those of `values`.
          names: k parameters.
          values: (..., k) their values.

        Returns:
          (..., n) a new array; `base` is not changed.

        Raises:
          InputError: as `index` and `validate`.
        """
        names = _names(names, "names")
        i = self.indices(names)
        inner = self.subspace(names).validate(values)
        outer = self.validate(base, "base")
        leading = np.broadcast_shapes(inner.shape[:-1], outer.shape[:-1])
        full = np.broadcast_to(outer, (*leading, self.n)).copy()
        full[..., i] = inner
        return full

    def with_bits(self, bits: int | Sequence[int]) -> "Box":
        """The same parameters on another grid."""
        return Box(self.names, self.low, self.high, bits=bits, code=self.code, units=self.units)
