"""Contact points that stand side by side: which of them are visited, and with what numbers."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from btr_mjx.engines.lanes_engine.constraints.cones import Frictionless
from btr_mjx.engines.lanes_engine.constraints.points import Contact, side_by_side
from btr_mjx.engines.scalars import UNIT

LANES = 5


@pytest.mark.parametrize("size", [1, 3])
def test_points_that_touch_in_some_world_are_visited_in_order(size: int, rng: np.random.Generator) -> None:
    """Of forty points, more than one loop holds, those with a weight in some world and member, and no others."""
    shape = (LANES,) if size == 1 else (size, LANES)
    link: Any = SimpleNamespace(size=size)
    touching = rng.random(40) < 0.4
    weights = rng.uniform(1, 2, (40, *shape)) * (rng.random((40, *shape)) < 0.3)
    weights[..., 0] = np.where(touching.reshape(-1, *[1] * (size > 1)), 1.0, 0.0)
    weights[~touching] = 0.0
    places = rng.normal(size=(40, 3, *shape))
    contacts = [
        Contact(link, list(map(jnp.asarray, place)), Frictionless(UNIT, [], jnp.asarray(weight), [float(n), 0.0, 0.0]))
        for n, (place, weight) in enumerate(zip(places, weights, strict=True))
    ]

    def visit(p: jax.Array, point: Contact, so_far: tuple) -> tuple:
        order, count, total = so_far
        number = point.cone.reference[0].reshape(-1)[0].astype(int)
        return order.at[count].set(number), count + 1, total + point.x[1] * point.cone.weight

    groups = side_by_side(contacts, LANES, jnp.result_type(float))
    order, count, total = jnp.full(40, -1), jnp.int32(0), jnp.zeros(shape)
    for group in groups:
        order, count, total = jax.jit(group.visit, static_argnums=0)(visit, (order, count, total))
    assert len(groups) == 2
    assert order[: int(count)].tolist() == np.flatnonzero(touching).tolist()
    np.testing.assert_allclose(total, (places[:, 1] * weights).sum(0), rtol=1e-5)
