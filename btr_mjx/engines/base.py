"""Interface of the engines inside JAX: step a chunk of worlds of fixed size in lockstep.

The rollout (`btr_mjx.engines.program`) is written once against `Stepper`; the engines that run inside JAX differ only
in the memory layout of a chunk and in how they compute one step. Native MuJoCo needs no stepper: it runs whole rollouts
on its own threads.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np

from btr_mjx.errors import InputError

if TYPE_CHECKING:
    import jax

MUJOCO_4 = int(mujoco.__version__.split(".")[0]) >= 4
"""Whether MuJoCo computes as from 4.0 on: `RK4` is of fourth order in orientations, too, and actuators at the force
limit of a joint have no part in implicit integration."""

Leaves = Mapping[str, np.ndarray]
"""MjModel field name -> (..., *field shape): the fields in which the models of a batch differ."""


Start = tuple[np.ndarray, np.ndarray, np.ndarray]
"""qpos (nq,), qvel (nv,) and act (na,) in which rollouts start."""


class UnsupportedModel(InputError):
    """The model uses a feature that an engine does not compute; the message names it and an engine that does."""


class Stepper(Protocol):
    """One MuJoCo step for a chunk of C worlds. Every method but `pack` is traced by JAX.

    The state is a pytree in the engine's own layout. All other arrays have the batch as their last axis, so that an
    engine that keeps its batch in the SIMD lanes need not transpose.
    """

    nq: int
    nv: int
    nu: int
    timestep: float

    def pack(self, leaves: Leaves) -> Any:
        """Convert per-world model fields to the engine's layout (numpy, on the host).

        Args:
          leaves: MjModel fields of shape (N, C, *field shape), N chunks of C worlds; absent fields
            have the base model's values in all worlds.

        Returns:
          A pytree of numpy arrays with leading axis N; `initial` and `step` take one slice of it.
        """
        ...

    def initial(self, params: Any, chunk: int) -> Any:
        """State of `chunk` worlds at rest in the model's qpos0, with actuator activations zero."""
        ...

    def state(self, qpos: Any, qvel: Any, act: Any = None) -> Any:
        """State of a chunk from MuJoCo's arrays (nq, C), (nv, C) and (na, C); activations are zero if None."""
        ...

    def step(self, params: Any, state: Any, ctrl: "jax.Array") -> Any:
        """State after one time step under controls of shape (nu, C)."""
        ...

    def qpos(self, state: Any) -> "jax.Array":
        """Generalised positions (nq, C), MuJoCo's order and conventions."""
        ...

    def qvel(self, state: Any) -> "jax.Array":
        """Generalised velocities (nv, C), MuJoCo's order and conventions."""
        ...

    def act(self, state: Any) -> "jax.Array":
        """Activations of the actuators (na, C), MuJoCo's order."""
        ...

    def power(self, state: Any) -> "jax.Array":
        """Sum over actuators of |force x velocity| in the last step [W], shape (C,)."""
        ...

    def capped(self, state: Any) -> "jax.Array":
        """Whether the constraint solver reached its iteration limit in the last step, bool (C,)."""
        ...

    def tripped(self, state: Any) -> "jax.Array":
        """Whether a contact that the engine does not compute may have taken part so far, bool (C,)."""
        ...
