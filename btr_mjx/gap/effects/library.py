"""The library of effects that a model may lack.

Example of a user-defined effect, joint drag that is quadratic in the speed:

    from btr_mjx.gap.effects import EFFECTS, Effect, Parameter, joint_places

    def ranges(model, scales, place):
        size = scales.torque[place.dofs(model)].mean() / scales.speed[place.dofs(model)].mean() ** 2
        return (Parameter("coefficient", "N m s^2/rad^2", 0.0, 3 * size, 0.05 * size),)

    def edit(world, place, values):
        world.model.dof_dampingpoly[place.dofs(world.model), 0] += values[0]

    mine = Effect("quadratic_damping", joint_places, ranges, edit, summable=True)
    identify(dataset, effects=(*EFFECTS, mine))

Changes of model fields are also written into the mended model. Terms that depend on the state are laws
(`btr_mjx.gap.simulate.laws.Law`); changes of the command are functions in `World.command_edits`.
"""

from collections.abc import Sequence

from btr_mjx.gap.effects.actuators import ACTUATOR_EFFECTS
from btr_mjx.gap.effects.bodies import BODY_EFFECTS
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.friction import FRICTION_EFFECTS
from btr_mjx.gap.effects.ground import GROUND_EFFECTS
from btr_mjx.gap.effects.joints import JOINT_EFFECTS
from btr_mjx.gap.effects.law_dictionary import LAW_EFFECTS
from btr_mjx.gap.effects.motors import MOTOR_EFFECTS
from btr_mjx.gap.effects.similar import SIMILAR_EFFECTS

EFFECTS: tuple[Effect, ...] = (*FRICTION_EFFECTS, *JOINT_EFFECTS, *ACTUATOR_EFFECTS, *BODY_EFFECTS, *GROUND_EFFECTS)
"""Effects that are searched by default."""

KNOWN_EFFECTS: tuple[Effect, ...] = (*EFFECTS, *MOTOR_EFFECTS, *SIMILAR_EFFECTS, *LAW_EFFECTS)
"""All effects that can be selected by name: with those of motors, some that are easily mistaken for them, and laws."""


def of_forces(effects: Sequence[Effect]) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Effects to search where a robot touches nothing: those of motors and laws belong to the whole library there.

    Args:
      effects: that were selected.

    Returns:
      Effects of the library, and laws.
    """
    chosen = {effect.name for effect in effects}
    if chosen.issuperset(effect.name for effect in EFFECTS):
        effects = (*effects, *(effect for effect in (*MOTOR_EFFECTS, *LAW_EFFECTS) if effect.name not in chosen))
    return tuple(e for e in effects if e.law is None), tuple(e for e in effects if e.law is not None)
