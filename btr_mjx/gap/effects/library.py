"""The library of effects that a model may lack. One list, one entry an effect.

An effect of one's own takes a few lines; drag that grows with the square of a joint's speed, for instance:

    from btr_mjx.gap.effects import EFFECTS, Effect, Parameter, joint_places

    def ranges(model, scales, place):
        size = scales.torque[place.dofs(model)].mean() / scales.speed[place.dofs(model)].mean() ** 2
        return (Parameter("coefficient", "N m s^2/rad^2", 0.0, 3 * size, 0.05 * size),)

    def edit(world, place, values):
        world.model.dof_dampingpoly[place.dofs(world.model), 0] += values[0]

    mine = Effect("quadratic_damping", joint_places, ranges, edit, summable=True)
    identify(dataset, effects=(*EFFECTS, mine))

What an effect writes into the model's fields is mended natively without further ado. Whatever depends on the state is
a law (`btr_mjx.gap.simulate.laws.Law`), whatever concerns the command an edit of it (`World.command_edits`).
"""

from btr_mjx.gap.effects.actuators import ACTUATOR_EFFECTS
from btr_mjx.gap.effects.bodies import BODY_EFFECTS
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.friction import FRICTION_EFFECTS
from btr_mjx.gap.effects.ground import GROUND_EFFECTS
from btr_mjx.gap.effects.joints import JOINT_EFFECTS
from btr_mjx.gap.effects.similar import AKIN_EFFECTS

EFFECTS: tuple[Effect, ...] = (*FRICTION_EFFECTS, *JOINT_EFFECTS, *ACTUATOR_EFFECTS, *BODY_EFFECTS, *GROUND_EFFECTS)
"""Every effect that is tried unless others are given."""

KNOWN: tuple[Effect, ...] = (*EFFECTS, *AKIN_EFFECTS)
"""Every effect that can be asked for by name: also those that are only beside a name unless they are asked for."""
