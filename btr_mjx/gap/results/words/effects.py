"""Words for effects, places and the members of groups, as sentences, tables and figures have them.

Every function returns text and computes nothing else.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from btr_mjx.gap.effects import EACH_MEMBER, LAWS


@dataclass(frozen=True)
class EffectWords:
    """Words for an effect.

    Attributes:
      title: in a sentence.
      more, less: its first number rises or falls; the title where it cannot.
      grows: what grows or falls, where a change of its first number is one of that.
      moves: what moves, where its numbers have a sign.
    """

    title: str
    more: str = ""
    less: str = ""
    grows: str = ""
    moves: str = ""


def _amount(title: str, of: str) -> EffectWords:
    return EffectWords(title, f"more {of}", f"less {of}", of)


EFFECT_WORDS: Mapping[str, EffectWords] = {
    "viscous_damping": _amount("viscous damping", "viscous damping"),
    "dry_friction": _amount("dry friction", "dry friction"),
    "load_friction": EffectWords("load-dependent gear friction", grows="load-dependent gear friction"),
    "stribeck_friction": EffectWords("Stribeck (breakaway) friction"),
    "armature": _amount("rotor inertia (armature)", "rotor inertia"),
    "joint_stiffness": EffectWords("a spring", grows="the stiffness of a spring"),
    "joint_offset": EffectWords("an encoder offset", moves="the encoder's zero"),
    "backlash": EffectWords("backlash", grows="backlash"),
    "actuator_delay": EffectWords(
        "a delay of the command", "a later command", "an earlier command", "the delay of the command"
    ),
    "actuator_lag": EffectWords("a first-order lag of the command", grows="the lag of the command"),
    "command_rate_limit": EffectWords("a limit of the command's rate"),
    "actuator_gain": EffectWords(
        "a change of the motor's strength", "a stronger motor", "a weaker motor", "the motor's strength"
    ),
    "offset_torque": EffectWords("a constant force of the joint", moves="a constant force"),
    "gravity_compensation": EffectWords("gravity compensation"),
    "torque_limit": EffectWords("a torque limit"),
    "torque_speed": EffectWords("a torque-speed line of the motor"),
    "servo_stiffness": EffectWords(
        "another stiffness of the servo", "a stiffer servo", "a softer servo", "the servo's stiffness"
    ),
    "payload": _amount("a payload", "mass"),
    "link_length": EffectWords(
        "another length of the link", "a longer link", "a shorter link", "the length of the link"
    ),
    "com_shift": EffectWords("a shift of the centre of mass", moves="the centre of mass"),
    "constant_force": EffectWords("a constant force"),
    "air_drag": EffectWords("air drag", "more air drag", "less air drag"),
    "ground_slope": EffectWords("a slope of the ground"),
    "ground_friction": _amount("another friction of the ground", "friction of the ground"),
    "contact_softness": EffectWords("another softness of contact", "softer contacts", "harder contacts"),
    "hardening_spring": EffectWords("a hardening spring"),
    "one_sided_spring": EffectWords("a spring on one side"),
    "fading_motor": EffectWords("a motor that loses force over time"),
    "elastic_cord": EffectWords("an elastic cord"),
    **{law.name: EffectWords(law.title) for law in LAWS},
}
"""Effects of the library as they appear in sentences; other effects appear by their names."""

_SEVERAL_NUMBERS = ("stribeck_friction", "payload", "com_shift", "constant_force", "ground_slope")
"""Effects with several numbers, whose names say which one is meant."""


def effect_title(effect: str) -> str:
    """An effect in words, such as "viscous damping"."""
    return words_of(effect).title


def words_of(effect: str) -> EffectWords:
    """Words for an effect; an effect that is not of the library has its name."""
    return EFFECT_WORDS.get(effect, EffectWords(effect.replace("_", " ")))


def place_in_words(label: str) -> str:
    """A place in words, such as "joint knee" for "joint:knee"."""
    if label.startswith(EACH_MEMBER):
        return f"{place_in_words(label.removeprefix(EACH_MEMBER))}, each with its own number"
    kind, _, name = label.partition(":")
    if kind == "subtree":
        return f"every joint from body {name} down"
    if not name:
        return {"all": "all joints", "world": "the world as a whole"}.get(label, label)
    return f"{kind} {name}"


def effect_at_place(row: Mapping[str, Any]) -> str:
    """Effect and place of an entry of results, in words."""
    return f"{effect_title(str(row['effect']))} at {place_in_words(str(row['location']))}"


def quantity_at_place(row: Mapping[str, Any]) -> str:
    """What an entry of calibration changes, in words, such as "the mass of body hand"."""
    own, place = words_of(str(row["effect"])), place_in_words(str(row["location"]))
    what = own.grows or own.moves or own.title
    return f"{what} of {place}" if own.grows in ("mass", "rotor inertia") else f"{what} at {place}"


def together_in_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """Effects that were tried as one hypothesis, such as "dry friction and backlash at all joints, together"."""
    if len(rows) == 1:
        return effect_at_place(rows[0])
    places = {str(row["location"]) for row in rows}
    if len(places) == 1:
        titles = enumerated([effect_title(str(row["effect"])) for row in rows])
        return f"{titles} at {place_in_words(*places)}, together"
    return f"{enumerated([effect_at_place(row) for row in rows])}, together"


def enumerated(names: Sequence[str]) -> str:
    """Names as people list them, such as "a, b and c"."""
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def hypotheses_of(ranking: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Rows of a ranking by hypothesis: effects that were tried at once, and have one score, are one entry."""
    out: dict[Any, list[Mapping[str, Any]]] = {}
    for i, row in enumerate(ranking):
        together = tuple(row.get("together") or ())
        out.setdefault((together, tuple(row.get("beside") or ())) if together else i, []).append(row)
    return list(out.values())


def hypothesis_in_words(name: str) -> str:
    """Effects of a hypothesis in words, such as "dry friction at joint knee" for "dry_friction@joint:knee"."""
    parts = [part.partition("@") for part in name.split(" + ")]
    return " and ".join(
        effect_at_place({"effect": effect, "location": location}) if location else effect
        for effect, _, location in parts
    )


def confound_sentence(effect: str, location: str, change: float, correlation: float) -> str:
    """A sentence on a change that would leave almost the same traces as a named effect.

    Args:
      effect: name of the other effect, or of a believed parameter.
      location: its place; "" for a believed parameter.
      change: change of its first parameter; only the sign counts.
      correlation: correlation of the two signatures, in [0, 1].

    Returns:
      The sentence.
    """
    if not location:
        what = f"a {'larger' if change > 0 else 'smaller'} {effect}"
    else:
        own = words_of(effect)
        what = f"{(own.more if change > 0 else own.less) or own.title} at {place_in_words(location)}"
    how = "almost the same" if correlation >= 0.95 else "similar"
    return f"{what[0].upper()}{what[1:]} would leave {how} traces ({correlation:.2f})."


def member_of(name: str) -> tuple[str, str]:
    """Kind and member of a number, such as ("armature", "knee") of "armature[knee]"."""
    kind, _, member = name.partition("[")
    return kind.replace("_", " "), member.removesuffix("]")


def number_in_words(name: str) -> str:
    """A number of a simulator that grew in words: "dry friction at joint knee" for "dry_friction joint:knee torque".

    Args:
      name: effect, place and parameter; any other name is returned as it is.
    """
    effect, _, rest = name.partition(" ")
    location, _, parameter = rest.rpartition(" ")
    if effect not in EFFECT_WORDS or not location:
        return name
    kind, member = member_of(parameter)
    if location.startswith(EACH_MEMBER) and member:
        return f"{effect_title(effect)} at {member}"
    words = effect_at_place({"effect": effect, "location": location})
    return f"{words}, {kind}" if effect in _SEVERAL_NUMBERS else words
