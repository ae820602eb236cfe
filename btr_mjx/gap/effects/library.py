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
from importlib.metadata import entry_points
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.gap.effects.actuators import ACTUATOR_EFFECTS
from btr_mjx.gap.effects.bodies import BODY_EFFECTS
from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.friction import FRICTION_EFFECTS
from btr_mjx.gap.effects.ground import GROUND_EFFECTS
from btr_mjx.gap.effects.joints import JOINT_EFFECTS
from btr_mjx.gap.effects.law_dictionary import LAW_EFFECTS
from btr_mjx.gap.effects.motors import MOTOR_EFFECTS
from btr_mjx.gap.effects.similar import SIMILAR_EFFECTS
from btr_mjx.models import nearest_names
from btr_mjx.runs import installed_objects, load_object

EFFECTS: tuple[Effect, ...] = (*FRICTION_EFFECTS, *JOINT_EFFECTS, *ACTUATOR_EFFECTS, *BODY_EFFECTS, *GROUND_EFFECTS)
"""Effects that are searched by default."""

KNOWN_EFFECTS: tuple[Effect, ...] = (*EFFECTS, *MOTOR_EFFECTS, *SIMILAR_EFFECTS, *LAW_EFFECTS)
"""All effects that can be selected by name: with those of motors, some that are easily mistaken for them, and laws."""

TIMING = "actuator_delay"
"""Effect that is calibration where all commands share it: the time within a sample at which they act."""

OF_LOG = (TIMING, "torque_constant")
"""Effects that belong to a log where they are calibration, and not to the robot."""

TIME_IN_SAMPLE = 0.29
"""1 sigma of the time at which a command acts, in intervals of commands: anywhere within one."""

_FIELD = 5.0
"""Tolerances outside a laboratory, in units of those of the library. With those of the library five of eight walking
robots that lacked nothing, with faults of data, were said to lack damping, gains or a lag, with these none
(`benchmarks/gate.py --suites field_legged_nulls --cases 8 --seed 2`)."""

_FACTORS = {"viscous_damping": 10.0, "armature": 10.0, "ground_slope": 1.0, "torque_constant": 1.0}
"""The same of what nobody measures (damping, rotor inertia), and of what a spirit level tells."""


def field_tolerance(effect: str, tolerance: float) -> float:
    """1 sigma of a number outside a laboratory.

    Args:
      effect: name of the effect that the number belongs to.
      tolerance: 1 sigma that the library has for it; 0 for none.
    """
    return _FACTORS.get(effect, _FIELD) * tolerance


def known_effects() -> dict[str, Effect]:
    """Effects that can be selected, by name: `KNOWN_EFFECTS`, and those of installed packages.

    A package adds effects in the entry point group `btr_mjx.effects`; each entry point names an `Effect`.

    Raises:
      InputError: an entry point that cannot be loaded, or whose effect has a name of the library.
    """
    known = {effect.name: effect for effect in KNOWN_EFFECTS}
    for entry, effect in installed_objects("btr_mjx.effects", Effect).items():
        if effect.name in known:
            raise InputError(f"entry point {entry}: the effect {effect.name!r} is there already; give it another name")
        known[effect.name] = effect
    return known


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


def selected_effects(names: Sequence[str]) -> tuple[Effect, ...]:
    """Effects by name.

    Args:
      names: "all", names of the library or of effects of installed packages, or FILE.py:NAME.

    Returns:
      The effects, each once.

    Raises:
      InputError: an unknown name, or a file without such an effect.
    """
    known = known_effects()
    chosen: dict[str, Effect] = {}
    for name in names:
        if name == "all":
            chosen |= {effect.name: effect for effect in EFFECTS}
        elif ".py:" in name:
            own = _own_effect(name)
            chosen[own.name] = own
        elif name in known:
            chosen[name] = known[name]
        else:
            raise InputError(f"effect {name!r} is not in the library; nearest: {nearest_names(name, list(known), 5)}")
    if not chosen:
        raise InputError("effects: got none, expected names of the library or all")
    return tuple(chosen.values())


def custom_effect_code(names: Sequence[str]) -> bytes:
    """Files of user-defined effects and versions of installed ones, part of the key of `simulate.Journal`."""
    own = [Path(name.rpartition(":")[0]).read_bytes() for name in names if ".py:" in name]
    entries = sorted(entry_points(group="btr_mjx.effects"))
    return b"".join([*own, *(f"{entry.value} {entry.dist and entry.dist.version}".encode() for entry in entries)])


def _own_effect(name: str) -> Effect:
    effect = load_object(name, "effect")
    if not isinstance(effect, Effect):
        raise InputError(f"effect {name!r}: got {type(effect).__name__}, expected an Effect")
    return effect
