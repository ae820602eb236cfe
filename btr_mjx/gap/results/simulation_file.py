"""One simulation of a robot as plain MJCF, for programs that know nothing of templates, edits and effects."""

from numpy.typing import ArrayLike

from btr_mjx.gap.results.effect_simulator import EffectEdit
from btr_mjx.gap.results.mended_model import MendedModel, parameter_names, written
from btr_mjx.gap.results.records import FoundEffect
from btr_mjx.gap.results.transcribe import normalised
from btr_mjx.gap.simulate import World
from btr_mjx.models import mjcf_spec
from btr_mjx.robots import Robot


def simulation_mjcf(robot: Robot, simulation: ArrayLike) -> MendedModel:
    """One simulation of a robot as plain MJCF: edits are numbers in it, files that it includes are inside.

    Args:
      robot: the robot; its model is not a template any more.
      simulation: (n_s,) parameters.

    Returns:
      The model; effects of an `EffectSimulator` that MJCF cannot express are its terms. Its numbers have the six digits
      of MuJoCo's XML, its meshes and textures absolute paths.

    Raises:
      InputError: parameters outside the box, or a model that MuJoCo rejects.
    """
    values = robot.simulation_box.validate(simulation, "simulation")
    number = lambda name: float(values[robot.simulation_box.index(name)])  # noqa: E731
    spec = normalised(mjcf_spec(robot, robot.render(values)))
    base = spec.compile()
    world = World.of(base)
    for edit in robot.edits:
        edit(world.model, [number(name) for name in edit.parameters])
    edits = [edit for edit in robot.edits if isinstance(edit, EffectEdit)]
    others = list[EffectEdit](getattr(robot.simulator, "effects", ()))

    def found(one: EffectEdit) -> FoundEffect:
        names = parameter_names(base, one.effect, one.place)
        return FoundEffect(one.effect.name, one.place.label, dict(zip(names, map(number, one.parameters), strict=True)))

    library = [one.effect for one in (*edits, *others)]
    return written(spec, base, world, [*map(found, others)], library, [*map(found, edits)])
