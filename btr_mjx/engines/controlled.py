"""Rollouts from given states under given controls, as a compiled program for the engines that run inside JAX.

The program advances a block of worlds by a segment of steps and returns their states after every step; a rollout calls
it for one segment after another, so that one compilation serves every number of steps.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from btr_mjx.engines.base import Leaves, Stepper
from btr_mjx.engines.program import Layout, on_all_devices, run_chunks


class Motions(NamedTuple):
    """States of B worlds after each of T steps.

    Attributes:
      qpos: (B, T, nq).
      qvel: (B, T, nv).
      act: (B, T, na).
      tripped: (B,) whether a contact that the engine does not compute may have taken part, or a state is invalid.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    tripped: np.ndarray


_BAD = 1e10
"""Values above it count as invalid (mjMAXVAL)."""


class ControlledProgram:
    """Compiled segments of rollouts, built once per engine and layout."""

    def __init__(self, stepper: Stepper, layout: Layout, devices: list[jax.Device], segment: int) -> None:
        """Prepare the program.

        Args:
          stepper: the engine.
          layout: shape of a block of worlds.
          devices: over which the block is sharded.
          segment: number of steps of a segment.
        """
        self.stepper, self.layout, self.segment = stepper, layout, segment

        def begin(qpos: jax.Array, qvel: jax.Array, act: jax.Array, active: jax.Array) -> Any:
            return run_chunks(stepper.state, (qpos, qvel, act), active)

        def advance(params: Any, state: Any, controls: jax.Array, count: jax.Array, active: jax.Array) -> Any:
            return run_chunks(lambda p, s, u: self._segment(p, s, u, count), (params, state, controls), active)

        self._begin, self._advance = on_all_devices(devices, begin, 3, 1), on_all_devices(devices, advance, 3, 2)

    def _segment(self, params: Any, state: Any, controls: jax.Array, count: jax.Array) -> tuple:
        """State of a chunk after `count` steps, and the states on the way."""
        read = lambda s: (self.stepper.qpos(s), self.stepper.qvel(s), self.stepper.act(s))  # noqa: E731
        shapes = jax.eval_shape(read, state)
        rows = jax.tree.map(lambda s: jnp.zeros((self.segment, *s.shape), s.dtype), shapes)

        def step(k: jax.Array, carry: tuple) -> tuple:
            state, rows = carry
            state = self.stepper.step(params, state, lax.dynamic_index_in_dim(controls, k, keepdims=False))
            write = lambda x, y: lax.dynamic_update_index_in_dim(x, y, k, 0)  # noqa: E731
            return state, jax.tree.map(write, rows, read(state))

        state, rows = lax.fori_loop(0, count, step, (state, rows))
        return state, rows, self.stepper.tripped(state)

    def __call__(
        self, leaves: Leaves, start: tuple[np.ndarray, np.ndarray, np.ndarray], controls: np.ndarray
    ) -> Motions:
        """Roll out up to `layout.pairs` worlds.

        Args:
          leaves: MjModel fields (B, *field shape).
          start: qpos (B, nq), qvel (B, nv) and act (B, na).
          controls: (B, T, nu).
        """
        layout, dtype = self.layout, jnp.result_type(float)
        count, steps = controls.shape[:2]
        index, active = layout.places(count)
        padded = lambda x: layout.padded(x, active)  # noqa: E731
        params = jax.tree.map(padded, self.stepper.pack({name: values[index] for name, values in leaves.items()}))
        columns = [padded(np.moveaxis(x[index], 1, -1).astype(dtype)) for x in start]
        state = self._begin(*columns, np.int32(active))
        parts = []
        for first in range(0, steps, self.segment):
            mine = controls[:, first : first + self.segment].astype(dtype)
            whole = np.zeros((count, self.segment, controls.shape[2]), dtype)
            whole[:, : mine.shape[1]] = mine
            # (chunks, chunk, steps, nu) -> (chunks, steps, nu, chunk)
            block = padded(np.moveaxis(whole[index], 1, -1))
            state, rows, tripped = self._advance(params, state, block, np.int32(mine.shape[1]), np.int32(active))
            parts.append([layout.in_order(x, count)[:, : mine.shape[1]].astype(np.float64) for x in rows])
        qpos, qvel, act = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        valid = np.all([(np.abs(x) < _BAD).all((1, 2)) for x in (qpos, qvel, act)], axis=0)
        return Motions(qpos, qvel, act, layout.in_order(tripped, count) | ~valid)
