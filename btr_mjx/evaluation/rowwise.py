"""Row functions: a kernel for chunks of rows as a function of one row that supports JAX's transformations.

A SIMD kernel computes a fixed number of independent rows at once. `rowwise(kernel, chunk)` is the same function for one
row:

- `jax.vmap`, nested to any depth, inside or outside `jax.jit`, flattens all mapped axes into one batch, pads it to
  whole chunks and runs the kernel chunk by chunk, so that memory does not grow with the batch. Arguments that are not
  mapped along an axis are not copied along it: rows are gathered for one chunk at a time.
- `jax.jvp` runs the kernel's own forward-mode derivative on chunks, only for the arguments that are differentiated;
  directions of `jax.jacfwd` count as rows.
- Chunks are distributed over devices.

A row's result does not depend on its position in the batch or on the size of the batch.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jax.sharding import AxisType, Mesh, PartitionSpec

from btr_mjx.evaluation.traced import jvp_of_moving

Kernel = Callable[..., Any]
"""kernel(*arguments) -> results: pytrees of arrays whose first axis counts the chunk's rows."""


def rowwise(kernel: Kernel, chunk: int, devices: Sequence[jax.Device] | None = None) -> Kernel:
    """The function of one row of a kernel that computes `chunk` rows.

    The kernel maps pytrees of arrays (chunk, ...) to a pytree of floating-point arrays (chunk, ...); row i of the
    results depends on row i of the arguments only, and has the same bits at any position. Chunks of a batch are
    distributed over the devices; within a `shard_map` of the caller they stay on their device.

    The function supports `jit`, `vmap`, `jvp`, `jacfwd` and their compositions. Reverse mode (`grad`, `vjp`) and
    `linearize` raise JAX's ValueError.
    """
    traced_once = jax.jit(kernel)  # traced once: every level of vmap would trace a long kernel again

    @jax.jit  # so that calls outside of `jit` are compiled once too
    @functools.wraps(kernel)
    def function(*arguments: Any) -> Any:
        arrays, tree = jax.tree.flatten(arguments)
        repeated = lambda *xs: [jnp.broadcast_to(x, (chunk, *x.shape)) for x in xs]  # noqa: E731
        results = jax.eval_shape(lambda *xs: traced_once(*jax.tree.unflatten(tree, repeated(*xs))), *arrays)

        @jax.jit
        def flat(*chunks: jax.Array) -> tuple[jax.Array, ...]:
            return tuple(jax.tree.leaves(traced_once(*jax.tree.unflatten(tree, chunks))))

        found = tuple(devices) if devices is not None else tuple(jax.devices())
        everything = (frozenset(range(len(arrays))),) * len(jax.tree.leaves(results))
        batch = _Batch(flat, chunk, found, (), ((),) * len(arrays), everything)
        return jax.tree.unflatten(jax.tree.structure(results), _apply(batch, *arrays))

    return function


@dataclass(frozen=True, eq=False)
class _Batch:
    """A batch of rows with several batch axes.

    Attributes:
      kernel: maps arrays (chunk, ...) to a tuple of such arrays.
      chunk: rows per call of the kernel.
      devices: over which the chunks are distributed.
      sizes: sizes of the batch axes.
      axes: for each argument, the batch axes that it has; they are its leading axes, in this order.
      sources: for each result, the arguments that it depends on.
    """

    kernel: Callable[..., tuple[jax.Array, ...]]
    chunk: int
    devices: tuple[jax.Device, ...]
    sizes: tuple[int, ...]
    axes: tuple[tuple[int, ...], ...]
    sources: tuple[frozenset[int], ...]

    def mapped(self, size: int, batched: Sequence[bool]) -> "_Batch":
        """The batch with another leading batch axis, which the `batched` arguments have."""
        axes = tuple((0,) * one + tuple(i + 1 for i in old) for one, old in zip(batched, self.axes, strict=True))
        return replace(self, sizes=(size, *self.sizes), axes=axes)

    def differentiated(self, active: Sequence[bool]) -> "_Batch":
        """The batch of results and their tangents, from all arguments and the tangents of the active ones."""

        @jax.jit
        def kernel(*arguments: jax.Array) -> tuple[jax.Array, ...]:
            primals, tangents = arguments[: len(active)], arguments[len(active) :]
            results, derivatives = jvp_of_moving(self.kernel, active, primals, tangents)
            return (*results, *derivatives)

        axes = self.axes + tuple(a for one, a in zip(active, self.axes, strict=True) if one)
        everything = (frozenset(range(len(axes))),) * len(self.sources)
        return replace(self, kernel=kernel, axes=axes, sources=self.sources + everything)

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Results of all rows, (*sizes, ...)."""
        count = math.prod(self.sizes)
        # Within a `shard_map` of the caller the batch is already distributed.
        inside = jax.sharding.get_abstract_mesh().manual_axes
        chunks = -(-count // self.chunk)
        workers = 1 if inside else min(len(self.devices), max(chunks, 1))
        turns = -(-chunks // workers)

        def one(turn: jax.Array, arguments: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            row = jnp.minimum(turn * self.chunk + jnp.arange(self.chunk), count - 1)
            position = jnp.unravel_index(row, self.sizes) if self.sizes else ()
            return self.kernel(*(self._rows(x, a, position) for x, a in zip(arguments, self.axes, strict=True)))

        def some(turn: jax.Array, *arguments: jax.Array) -> tuple[jax.Array, ...]:
            return lax.map(lambda i: one(i, arguments), turn)

        order = jnp.arange(workers * turns)
        if workers > 1:
            mesh = Mesh(np.array(self.devices[:workers]), ("chunks",), axis_types=(AxisType.Auto,))
            sharded, copied = PartitionSpec("chunks"), PartitionSpec()
            specs = (sharded, *(copied for _ in arguments))
            some = jax.shard_map(some, mesh=mesh, in_specs=specs, out_specs=sharded, check_vma=False)
        results = some(order, *arguments)
        return tuple(x.reshape(-1, *x.shape[2:])[:count].reshape(*self.sizes, *x.shape[2:]) for x in results)

    def _rows(self, x: jax.Array, axes: tuple[int, ...], position: Sequence[jax.Array]) -> jax.Array:
        if not axes:
            return jnp.broadcast_to(x, (self.chunk, *x.shape))
        return x[tuple(position[i] for i in axes)]


def _apply(batch: _Batch, *arguments: jax.Array) -> tuple[jax.Array, ...]:
    """`batch.run`, with rules for JAX's transformations."""

    @jax.custom_batching.custom_vmap
    def run(*arguments: jax.Array) -> tuple[jax.Array, ...]:
        return batch.run(*arguments)

    @run.def_vmap
    def mapped(size: int, batched: list[bool], *arguments: jax.Array) -> tuple[Any, Any]:
        results = _apply(batch.mapped(size, batched), *arguments)
        # Results that do not depend on a mapped argument must be marked as not mapped.
        differs = tuple(any(batched[i] for i in sources) for sources in batch.sources)
        return tuple(x if one else x[0] for one, x in zip(differs, results, strict=True)), differs

    # custom_vmap alone would differentiate all arguments and map the loop over chunks if only tangents are mapped.
    differentiable = jax.custom_jvp(run)

    def derivative(primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
        active = [not isinstance(t, SymbolicZero) for t in tangents]
        moving = [t for one, t in zip(active, tangents, strict=True) if one]
        both = _apply(batch.differentiated(active), *primals, *moving)
        return both[: len(both) // 2], both[len(both) // 2 :]

    differentiable.defjvp(derivative, symbolic_zeros=True)
    return differentiable(*arguments)
