"""Names judged: whether two effects are the same, and whether an answer names what is hidden and nothing else."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.effects import joint_of, link_of
from gates.rows import Row, listed, name_of, row_of

_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


def joints_of(model: mujoco.MjModel, label: str) -> frozenset[str]:
    """Names of the hinges and slides at a place; empty for a body, a geom or the world."""
    kind, _, name = label.removeprefix("each:").partition(":")
    names = [model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] >= _SLIDE]
    if kind == "all":
        return frozenset(names)
    if kind == "joint":
        return frozenset([name])
    if kind == "actuator":
        joint = joint_of(model, model.actuator(name).id)
        return frozenset() if joint is None else frozenset([model.joint(joint).name])
    if kind == "subtree":
        root = model.body(name).id
        return frozenset(j for j in names if _below(model, int(model.joint(j).bodyid[0]), root))
    return frozenset()


def _below(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body > root:
        body = int(model.body_parentid[body])
    return body == root


def same_place(model: mujoco.MjModel, one: str, other: str) -> bool:
    """Whether two labels denote the same place; bodies that are welded together are one."""
    if joints_of(model, one) or joints_of(model, other):
        return joints_of(model, one) == joints_of(model, other)
    bodies = [_body(model, label) for label in (one, other)]
    return bodies[0] == bodies[1]


def _body(model: mujoco.MjModel, label: str) -> int:
    """The body of a place, -1 for the world."""
    kind, _, name = label.partition(":")
    return int(model.body_weldid[model.body(name).id]) if kind == "body" else -1


def same_effect(model: mujoco.MjModel, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether an effect is of the same kind at the same place as another one, which may have numbers for each member.

    Actuators without a joint, such as rotors, have their names alone.
    """
    if one["effect"] != other["effect"]:
        return False
    places = [effect["location"] for effect in (one, other)]
    members = [place.startswith("each:") for place in places]
    if any(_is_rotor(model, place) for place in places) or (_floats_alone(model) and "all" in places):
        return places[0] == places[1]
    # A number for each member says all that one number for the group says.
    return members[0] <= members[1] and same_place(model, *places)


def _is_rotor(model: mujoco.MjModel, place: str) -> bool:
    kind, _, name = place.partition(":")
    return kind == "actuator" and model.actuator_trntype[model.actuator(name).id] != mujoco.mjtTrn.mjTRN_JOINT


def _floats_alone(model: mujoco.MjModel) -> bool:
    """Whether a model is one free body: all of its actuators are no group at the same joints."""
    return model.njnt == 1 and model.nv == 6


def true_values(model: mujoco.MjModel, missing: Mapping[str, Any], names: Sequence[str]) -> list[float]:
    """Hidden parameters in the parametrisation of the library's candidate at that place.

    Args:
      model: the believed model.
      missing: an effect of the truth.
      names: (p,) parameters of the candidate; "along" is the position of a payload along its link [m].

    Returns:
      (p,) values.
    """
    parameters = missing["parameters"]
    values = []
    for name in names:
        if name == "along":
            link = link_of(model, model.body(missing["location"].partition(":")[2]).id)
            assert link is not None
            values.append(float((np.array([parameters[c] for c in "xyz"]) - link.anchor) @ link.direction))
        else:
            values.append(float(parameters[name]))
    return values


def inside_interval(model: mujoco.MjModel, missing: Mapping[str, Any], named: Mapping[str, Any]) -> list[bool]:
    """Whether each true number of a correctly named effect lies within the interval that was reported."""
    if missing["location"] != named["location"]:
        return []  # the same effect by another label, such as one member of a group, has numbers of its own
    parameters = named["parameters"]
    truth = true_values(model, missing, list(parameters))
    return [bool(p["low"] <= v <= p["high"]) for v, p in zip(truth, parameters.values(), strict=True)]


def judged_parts(named: Mapping[str, Any]) -> list[dict[str, Any]]:
    """An effect at single places: of a number for every member of a group, those whose interval excludes nothing."""
    if not named["location"].startswith("each:"):
        return [dict(named)]
    kind = "actuator" if named["effect"].startswith("actuator") else "joint"
    out = []
    for label, number in named["parameters"].items():
        parameter, _, member = label.removesuffix("]").partition("[")
        if not number["low"] <= number["null"] <= number["high"]:
            out.append({**named, "location": f"{kind}:{member}", "parameters": {parameter: number}})
    return out


def judge_names(
    model: mujoco.MjModel,
    hidden: Sequence[Mapping[str, Any]],
    answer: Mapping[str, Any],
    *,
    outside: str = "",
    laws: Sequence[str] = (),
    detectable: bool = True,
) -> Row:
    """Whether every hidden effect is named by kind and place, and nothing else.

    A number for every member of a group is right where those of members that lack nothing may be zero. What is outside
    the library has to be called unexplained; a null, nothing.

    Args:
      model: the believed model.
      hidden: effects of the library that are missing.
      answer: entries of result.json.
      outside: what is missing and outside the library.
      laws: names (effect@place) that are right for what is outside the library.
      detectable: whether what is hidden can be seen in the recordings.
    """
    named = [effect for effect in answer["effects"] if name_of(effect) not in laws]
    parts = [part for one in named for part in judged_parts(one)]
    found = [[n for n in (*parts, *named) if same_effect(model, h, n)] for h in hidden]

    def is_true(effect: Mapping[str, Any]) -> bool:
        return any(same_effect(model, h, effect) for h in hidden)

    false = [name_of(n) for n in named if not is_true(n) and not all(map(is_true, judged_parts(n)))]
    told = answer["verdict"] == "unexplained"
    if outside:
        told = told or bool(answer.get("unexplained")) or len(named) < len(answer["effects"])
    right = not false and all(found) and told == bool(outside)
    inside = [ok for h, f in zip(hidden, found, strict=True) if f for ok in inside_interval(model, h, f[0])]
    missing = [*map(name_of, hidden), *([outside] if outside else [])]
    return row_of(answer, listed(missing), right if detectable else None, false, is_null=not missing, inside=inside)
