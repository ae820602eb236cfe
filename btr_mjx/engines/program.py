"""The rollout as one compiled program, for the engines that run inside JAX.

Pairs (s, c) are passed in a block of fixed shape, (devices x capacity) chunks of C worlds. The block is sharded over
the devices. Each device runs its chunks one after the other, so that memory does not grow with the number of pairs, and
stops at the last chunk in use, so that a small batch costs little. The number of steps is an argument of the program,
so that one compilation serves every duration.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import AxisType, Mesh, PartitionSpec

from btr_mjx.engines.base import Leaves, Start, Stepper
from btr_mjx.engines.record import Record
from btr_mjx.robots import Signal


@dataclass(frozen=True)
class Layout:
    """Shape of a block of pairs.

    Attributes:
      devices: number of devices it is sharded over.
      capacity: chunks per device.
      chunk: worlds per chunk.
    """

    devices: int
    capacity: int
    chunk: int

    @property
    def pairs(self) -> int:
        """Pairs that one block holds."""
        return self.devices * self.capacity * self.chunk

    def places(self, count: int) -> tuple[np.ndarray, int]:
        """Where `count` pairs go: index of a pair for each lane, (devices x active, chunk), and active chunks a device.

        Lanes without a pair of their own repeat the last one.
        """
        used = -(-count // self.chunk)
        active = -(-used // self.devices)
        # Chunk i of the batch is the (i // devices)-th of device i % devices, so that few chunks still use every
        # device.
        place = np.arange(self.devices * active * self.chunk).reshape(active, self.devices, self.chunk)
        return np.minimum(place.transpose(1, 0, 2), count - 1).reshape(-1, self.chunk), active

    def chunks(self, count: int) -> Iterator[tuple[int, int, slice]]:
        """Device, place on it and pairs of every chunk that holds some of `count` pairs."""
        for i, first in enumerate(range(0, count, self.chunk)):
            yield i % self.devices, i // self.devices, slice(first, min(first + self.chunk, count))

    def padded(self, x: np.ndarray, active: int) -> np.ndarray:
        """The chunks in use (devices x active, ...), padded with zeros to the shape of a block."""
        whole = np.zeros((self.devices, self.capacity, *x.shape[1:]), x.dtype)
        whole[:, :active] = x.reshape(self.devices, active, *x.shape[1:])
        return whole.reshape(self.devices * self.capacity, *x.shape[1:])

    def in_order(self, x: jax.Array, count: int) -> np.ndarray:
        """A result of a block (chunks, ..., chunk) for its first `count` pairs, batch first: (count, ...)."""
        blocks = np.asarray(x).reshape(self.devices, self.capacity, *x.shape[1:]).swapaxes(0, 1)
        batch_first = np.moveaxis(blocks, -1, 2)
        return batch_first.reshape(self.pairs, *batch_first.shape[3:])[:count]


def rollout_chunk(
    stepper: Stepper,
    signal: Signal,
    base_address: tuple[int, int] | None,
    record_states: bool,
    params: Any,
    controllers: jax.Array,
    samples: jax.Array,
    at: Start | None = None,
) -> Record:
    """Simulate one chunk (traced by JAX).

    Controllers are (n_c, C), samples (K,) ascending step counts at which to record, the last one of which ends the
    rollout. Addresses are those of the base's position in qpos and of its velocity in qvel, None for a fixed base; `at`
    is the state in which the rollout starts, None for the model's qpos0 at rest.
    """
    chunk = controllers.shape[1]
    if at is None:
        state = stepper.initial(params, chunk)
    else:
        state = stepper.state(*(jnp.broadcast_to(jnp.asarray(x)[:, None], (len(x), chunk)) for x in at))
    dtype = stepper.qpos(state).dtype
    zeros = jnp.zeros(chunk, dtype)

    def base(state: Any) -> jax.Array:
        if base_address is None:
            return jnp.zeros((3, chunk), dtype)
        return stepper.qpos(state)[base_address[0] : base_address[0] + 3]

    def speed(state: Any) -> jax.Array:
        if base_address is None:
            return zeros
        velocity = stepper.qvel(state)[base_address[1] : base_address[1] + 3]
        return jnp.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)

    def step(k: jax.Array, carry: tuple) -> tuple:
        state, energy, peak, capped = carry
        time = k.astype(dtype) * jnp.asarray(stepper.timestep, dtype)
        state = stepper.step(params, state, signal(controllers, time, jnp))
        energy = energy + stepper.power(state) * jnp.asarray(stepper.timestep, dtype)
        return state, energy, jnp.maximum(peak, speed(state)), capped + stepper.capped(state)

    def segment(carry: tuple, bounds: jax.Array) -> tuple:
        carry = lax.fori_loop(bounds[0], bounds[1], step, carry)
        state, energy = carry[:2]
        nothing = jnp.zeros((0, chunk), dtype)
        states = (stepper.qpos(state), stepper.qvel(state), stepper.act(state)) if record_states else (nothing,) * 3
        return carry, (base(state), energy, *states)

    start = base(state)
    bounds = jnp.stack([jnp.concatenate([jnp.zeros(1, samples.dtype), samples[:-1]]), samples], axis=1)
    carry = (state, zeros, zeros, jnp.zeros(chunk, jnp.int32))
    ended: tuple
    sampled: tuple
    ended, sampled = lax.scan(segment, carry, bounds)
    position, energy, *states = sampled
    peak, capped = ended[2:]
    return Record(start, position, energy, peak, capped, stepper.tripped(ended[0]), *states)


def run_chunks(one: Callable[..., Any], chunked: tuple, active: Any) -> Any:
    """Chunks 0 .. active - 1 of one device in turn; the results of the others stay zero.

    `one` computes a chunk from slices of the arguments `chunked`, whose leading axis counts chunks.
    """
    one = jax.jit(one)  # traced once, for its shapes and for the loop
    shapes = jax.eval_shape(one, *jax.tree.map(lambda x: x[0], chunked))
    chunks = jax.tree.leaves(chunked)[0].shape[0]
    out = jax.tree.map(lambda s: jnp.zeros((chunks, *s.shape), s.dtype), shapes)

    def body(i: jax.Array, out: Any) -> Any:
        take = lambda x: lax.dynamic_index_in_dim(x, i, keepdims=False)  # noqa: E731
        result = one(*jax.tree.map(take, chunked))
        return jax.tree.map(lambda x, y: lax.dynamic_update_index_in_dim(x, y, i, 0), out, result)

    return lax.fori_loop(0, active, body, out)


def on_all_devices(
    devices: list[jax.Device], function: Callable[..., Any], chunked: int, shared: int
) -> jax.stages.Wrapped:
    """Compile a function for blocks of chunks that are sharded over devices.

    Its first `chunked` arguments and its results have the chunks as leading axis; the `shared` ones that follow are
    copied to every device.
    """
    mesh = Mesh(np.array(devices), ("chunks",), axis_types=(AxisType.Auto,))
    sharded, copied = PartitionSpec("chunks"), PartitionSpec()
    specs = (sharded,) * chunked + (copied,) * shared
    mapped = jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=sharded, check_vma=False)
    wide = {"xla_cpu_prefer_vector_width": "512"} if devices[0].platform == "cpu" else {}
    return jax.jit(mapped, compiler_options=wide)


class Program:
    """A compiled block rollout, built once per (robot, engine, layout, number of samples) and called for any pairs."""

    def __init__(
        self,
        stepper: Stepper,
        signal: Signal,
        base_address: tuple[int, int] | None,
        layout: Layout,
        record_states: bool,
        devices: list[jax.Device],
        at: Start | None = None,
    ) -> None:
        self.stepper, self.layout = stepper, layout

        def one(params: Any, controllers: jax.Array, samples: jax.Array) -> Record:
            return rollout_chunk(stepper, signal, base_address, record_states, params, controllers, samples, at)

        def block(params: Any, controllers: jax.Array, samples: jax.Array, active: jax.Array) -> Record:
            return run_chunks(lambda p, c: one(p, c, samples), (params, controllers), active)

        self.function = on_all_devices(devices, block, 2, 2)

    def arguments(self, leaves: Leaves, controllers: np.ndarray, samples: np.ndarray) -> tuple:
        """Arguments of `function` for up to `layout.pairs` pairs: parameters, controllers, samples, chunks per device.

        Model fields are (B, *field shape), controllers (B, n_c), samples (K,) step counts.
        """
        index, active = self.layout.places(len(controllers))
        packed = self.stepper.pack({name: values[index] for name, values in leaves.items()})
        controls = np.moveaxis(controllers[index], 2, 1).astype(jnp.result_type(float))
        packed, controls = jax.tree.map(lambda x: self.layout.padded(x, active), (packed, controls))
        return packed, controls, np.asarray(samples, np.int32), np.int32(active)

    def unpack(self, record: Record, count: int) -> Record:
        """The record of the first `count` pairs as batch-first numpy arrays."""
        return Record(*(self.layout.in_order(x, count) for x in record))

    def __call__(self, leaves: Leaves, controllers: np.ndarray, samples: np.ndarray) -> Record:
        """The record of up to `layout.pairs` pairs, batch first: (B, ...), (B, K, ...); arguments as of `arguments`."""
        return self.unpack(self.function(*self.arguments(leaves, controllers, samples)), len(controllers))
