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

from btr_mjx.gap.effects.actuators import ACTUATOR_EFFECTS
from btr_mjx.gap.effects.bodies import BODY_EFFECTS
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.friction import FRICTION_EFFECTS
from btr_mjx.gap.effects.ground import GROUND_EFFECTS
from btr_mjx.gap.effects.joints import JOINT_EFFECTS
from btr_mjx.gap.effects.similar import SIMILAR_EFFECTS

EFFECTS: tuple[Effect, ...] = (*FRICTION_EFFECTS, *JOINT_EFFECTS, *ACTUATOR_EFFECTS, *BODY_EFFECTS, *GROUND_EFFECTS)
"""Effects that are searched by default."""

KNOWN_EFFECTS: tuple[Effect, ...] = (*EFFECTS, *SIMILAR_EFFECTS)
"""All effects that can be selected by name: those and the four that are easily mistaken for them."""
