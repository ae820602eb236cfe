"""Evaluation of guards in a step: which worlds of a chunk have a guarded pair that may touch."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from btr_mjx.engines.guards import bounds
from btr_mjx.engines.guards.hulls import HullPair, near_hulls
from btr_mjx.engines.guards.pairs import PairGroup
from btr_mjx.engines.guards.placed_geoms import PlacedGeoms, fold_rows


def crossed(
    groups: Sequence[PairGroup], meshes: Sequence[HullPair], geoms: PlacedGeoms, marked: jax.Array, dtype: Any
) -> jax.Array:
    """Worlds, bool (C,), that are marked or in which the bound of some guarded pair is crossed or a pose not finite.

    No other world has a contact of these pairs.
    """
    for group in groups:
        a, b = geoms.shapes(group.kinds[0], group.first), geoms.shapes(group.kinds[1], group.second)
        margin = geoms.stacked("margin", group.first) + geoms.stacked("margin", group.second)
        limit = jnp.maximum(margin, jnp.asarray(group.explicit, dtype)) + bounds.rounding(a, b)
        # A bound that is not a number is not larger than the limit either.
        marked = marked | fold_rows(jnp.logical_or, ~(bounds.lower_bound(a, b) > limit))
    for pair in meshes:
        marked = near_hulls(pair, geoms, marked, dtype)
    return marked
