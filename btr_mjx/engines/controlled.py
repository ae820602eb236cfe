"""Rollouts from given states under given controls, as a compiled program for the engines that run inside JAX.

The program advances a block of worlds by a segment of steps and returns their states after every step; a rollout calls
it for one segment after another, so that one compilation serves every number of steps.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from btr_mjx.engines.base import Leaves, Stepper
from btr_mjx.engines.program import Layout, on_all_devices, run_chunks

_BAD = 1e10
"""Values above it count as invalid (mjMAXVAL)."""


class ControlledProgram:
    """Compiled segments of rollouts, built once per engine and layout."""

    def __init__(self, stepper: Stepper, layout: Layout, devices: list[jax.Device], segment: int) -> None:
        """Prepare segments of `segment` steps for blocks that are sharded over the devices."""
        self.stepper, self.layout, self.segment = stepper, layout, segment

        def begin(qpos: jax.Array, qvel: jax.Array, act: jax.Array, active: jax.Array) -> Any:
            return run_chunks(stepper.state, (qpos, qvel, act), active)

        def advance(params: Any, state: Any, controls: jax.Array, count: jax.Array, active: jax.Array) -> Any:
            return run_chunks(lambda p, s, u: self._segment(p, s, u, count), (params, state, controls), active)

        self._begin, self._advance = on_all_devices(devices, begin, 3, 1), on_all_devices(devices, advance, 3, 2)

    def _segment(self, params: Any, state: Any, controls: jax.Array, count: jax.Array) -> tuple:
        """State of a chunk after `count` steps, states on the way (chunk, segment, n), marks of worlds as below."""
        read = lambda s: jnp.concatenate([self.stepper.qpos(s), self.stepper.qvel(s), self.stepper.act(s)])  # noqa: E731
        first = jax.eval_shape(read, state)
        rows, valid = jnp.zeros((self.segment, *first.shape), first.dtype), jnp.ones(first.shape[-1], bool)
        by_step = jnp.moveaxis(controls, 0, -1)

        def step(k: jax.Array, carry: tuple) -> tuple:
            state, rows, valid = carry
            state = self.stepper.step(params, state, lax.dynamic_index_in_dim(by_step, k, keepdims=False))
            row = read(state)
            return state, lax.dynamic_update_index_in_dim(rows, row, k, 0), valid & (jnp.abs(row) < _BAD).all(0)

        state, rows, valid = lax.fori_loop(0, count, step, (state, rows, valid))
        return state, jnp.moveaxis(rows, -1, 0), self.stepper.tripped(state) | ~valid

    def __call__(
        self, leaves: Leaves, start: tuple[np.ndarray, np.ndarray, np.ndarray], controls: np.ndarray, out: np.ndarray
    ) -> np.ndarray:
        """Roll out up to `layout.pairs` worlds, whose states after each step are written to `out`.

        Model fields are (B, *field shape), the start qpos (B, nq), qvel (B, nv) and act (B, na), controls (B, T, nu)
        and `out` (B, T, nq + nv + na). The result (B,) says whether a contact that the engine does not compute may have
        taken part, or a state is invalid.
        """
        layout, dtype = self.layout, jnp.result_type(float)
        count, steps = controls.shape[:2]
        index, active = layout.places(count)
        padded = lambda x: layout.padded(x, active)  # noqa: E731
        params = jax.tree.map(padded, self.stepper.pack({name: values[index] for name, values in leaves.items()}))
        state = self._begin(*(padded(np.moveaxis(x[index], 1, -1).astype(dtype)) for x in start), np.int32(active))
        marked = np.zeros(count, bool)
        for first in range(0, steps, self.segment):
            last = min(first + self.segment, steps)
            block = np.zeros((layout.devices * layout.capacity, layout.chunk, self.segment, controls.shape[2]), dtype)
            for i, worlds in enumerate(index):
                block[i // active * layout.capacity + i % active, :, : last - first] = controls[worlds, first:last]
            state, rows, marks = self._advance(params, state, block, np.int32(last - first), np.int32(active))
            # Copied from each device straight to their place: for small models copying takes as long as computing.
            on_host = [[np.asarray(shard.data) for shard in x.addressable_shards] for x in (rows, marks)]
            for device, place, worlds in layout.chunks(count):
                own = slice(worlds.stop - worlds.start)
                out[worlds, first:last] = on_host[0][device][place, own, : last - first]
                marked[worlds] |= on_host[1][device][place, own]
        return marked
