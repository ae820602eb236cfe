"""Effects of contact with the ground: sliding friction and contact softness, for one geom or all."""

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Effect, Parameter
from btr_mjx.gap.effects.places import WORLD, Place, geom_place, ground_geoms
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import World


def _ground_places(model: mujoco.MjModel) -> list[Place]:
    touching, _ = ground_geoms(model)
    if not touching:
        return []
    return [geom_place(model, g) for g in touching] * (len(touching) > 1) + [WORLD]


def _softness_places(model: mujoco.MjModel) -> list[Place]:
    touching, ground = ground_geoms(model)
    regular = all(model.geom_solref[g, 0] > 0 for g in touching + ground)
    return [WORLD] if touching and regular else []


def believed_friction(model: mujoco.MjModel, place: Place) -> float:
    """Mean sliding coefficient between the geoms of a place, or all that can touch it, and the ground.

    As in MuJoCo: the larger coefficient of both geoms, or that of the geom of higher priority.
    """
    touching, ground = ground_geoms(model)
    chosen = place.geoms or touching
    return float(np.mean([_combined(model, g, ground) for g in chosen]))


def _combined(model: mujoco.MjModel, geom: int, ground: list[int]) -> float:
    own, others = model.geom_friction[geom, 0], model.geom_friction[ground, 0]
    ahead = model.geom_priority[geom] - model.geom_priority[ground]
    values = np.where(ahead > 0, own, np.where(ahead < 0, others, np.maximum(own, others)))
    return float(values.max() if ground else own)


def _friction(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    believed = max(believed_friction(model, place), 1e-3)
    return (
        Parameter("coefficient", "1", 0.05 * believed, 3.0 * believed, -0.1 * believed, 0.03 * believed, null=believed),
    )


def _apply_friction(world: World, place: Place, values: np.ndarray) -> None:
    """|f_t| <= mu f_n with sliding coefficient mu.

    At the place "world" the coefficients of all geoms that can touch the ground are scaled. A single geom gets its
    current contact parameters with the ground, at a higher priority, and the new coefficient.
    """
    model = world.model
    believed = believed_friction(model, place)
    ratio = values[0] / believed if believed > 0 else 1.0
    touching, ground = ground_geoms(model)
    if not place.geoms:
        model.geom_friction[[*touching, *ground], 0] *= ratio
        pairs = [p for p in range(model.npair) if {int(model.pair_geom1[p]), int(model.pair_geom2[p])} & set(ground)]
        model.pair_friction[pairs, :2] *= ratio
        return
    for geom in place.geoms:
        _own_contact(model, geom, ground)
        model.geom_friction[geom, 0] = values[0]
        for p in range(model.npair):
            if geom in (model.pair_geom1[p], model.pair_geom2[p]):
                model.pair_friction[p, :2] *= ratio


def _own_contact(model: mujoco.MjModel, geom: int, ground: list[int]) -> None:
    """Give a geom its combined contact parameters with the ground, at a higher priority than that of the ground."""
    if not ground:
        return
    other = ground[0]
    ours, theirs = int(model.geom_priority[geom]), int(model.geom_priority[other])
    if ours > theirs:
        return
    a, b = float(model.geom_solmix[geom]), float(model.geom_solmix[other])
    share = 0.0 if ours < theirs else a / (a + b) if a + b > 0 else 0.5
    for mixed in (model.geom_solref, model.geom_solimp):
        mixed[geom] = share * mixed[geom] + (1 - share) * mixed[other]
    for largest in (model.geom_friction, model.geom_condim):
        largest[geom] = largest[other] if ours < theirs else np.maximum(largest[geom], largest[other])
    model.geom_priority[geom] = theirs + 1


def _softness(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
    believed = _time_constant(model)
    low = min(max(0.1 * believed, 2 * float(model.opt.timestep)), believed)
    return (Parameter("time_constant", "s", low, 10 * believed, 0.1 * believed, 0.02 * believed, null=believed),)


def _time_constant(model: mujoco.MjModel) -> float:
    touching, ground = ground_geoms(model)
    return float(np.mean(model.geom_solref[touching, 0]) + np.mean(model.geom_solref[ground, 0])) / 2


def _apply_softness(world: World, place: Place, values: np.ndarray) -> None:
    """Time constant of `solref` of contacts with the ground [s]; larger is softer."""
    model = world.model
    touching, ground = ground_geoms(model)
    geoms = [*touching, *ground]
    model.geom_solref[geoms, 0] = np.maximum(
        model.geom_solref[geoms, 0] + values[0] - _time_constant(model), 1e-2 * values[0]
    )


GROUND_FRICTION = Effect(
    "ground_friction",
    _ground_places,
    _friction,
    _apply_friction,
    excited_by="feet that slip",
    equation="|f_t| ≤ μ f_n",
)
CONTACT_SOFTNESS = Effect(
    "contact_softness",
    _softness_places,
    _softness,
    _apply_softness,
    excited_by="touchdowns and stance",
    equation="contacts give way with time constant solref",
)

GROUND_EFFECTS = (GROUND_FRICTION, CONTACT_SOFTNESS)
