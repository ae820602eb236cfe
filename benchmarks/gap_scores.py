"""Scores of blind cases: answers against truths. Pure arithmetic on the files of `blind_gap.py`."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from btr_mjx.gap.effects import joint_of, link_of

_FREE, _SLIDE = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_SLIDE)
DETECTABLE = 60.0
"""Gain (fall of chi^2) at the true parameters beyond which an effect is detectable; also used as a bound of scores."""
STRONG = 1000.0
"""`Truth.visible` (chi^2) beyond which an effect outside the library is strong."""
BARS: Mapping[str, tuple[str, float]] = {
    "right_kind_and_place": (">=", 0.90),
    "truth_in_equivalence_set": (">=", 0.97),
    "right_limb_or_body": (">=", 0.95),
    "parameter_error_median": ("<=", 0.05),
    "parameter_error_90": ("<=", 0.20),
    "nulls_named": ("<=", 0.02),
    "strong_outside_flagged": (">=", 0.80),
    "false_unexplained": ("<=", 0.03),
    "gap_closed_median": (">=", 0.70),
    "pairs_both_found": (">=", 0.70),
    "steps_largest": ("<=", 1e6),
    "seconds_median": ("<=", 15.0),
}
"""Aims for the numbers."""
Case = Mapping[str, Any]
"""Truth, answer (part of result.json) and oracle (gains and scores at the true parameters) of a case."""


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


def limbs_of(model: mujoco.MjModel, label: str) -> frozenset[str]:
    """Limbs at a place: the branches of the tree at the trunk or base; a trunk or the world is a limb of its own."""
    joints = joints_of(model, label)
    bodies = {int(model.joint(j).bodyid[0]) for j in joints} or {_body(model, label)}
    return frozenset("world" if b < 0 else model.body(_limb(model, b)).name for b in bodies)


def _limb(model: mujoco.MjModel, body: int) -> int:
    floating = model.jnt_type[model.body_jntadr[model.body_rootid[body]]] == _FREE
    trunk = int(model.body_rootid[body]) if floating else 0
    while body not in (trunk, 0) and int(model.body_weldid[int(model.body_parentid[body])]) != trunk:
        body = int(model.body_parentid[body])
    return trunk if int(model.body_weldid[body]) == trunk and trunk else body


def same_effect(model: mujoco.MjModel, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two entries name the same kind at the same place."""
    members = [entry["location"].startswith("each:") for entry in (one, other)]
    # A number for each member says all that one number for the group says.
    alike = members[0] <= members[1]
    return one["effect"] == other["effect"] and alike and same_place(model, one["location"], other["location"])


def _lag_for_delay(model: mujoco.MjModel, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether one entry is a delay and the other a lag of the same motors: at one frequency these are the same."""
    kinds = {one["effect"], other["effect"]}
    return kinds == {"actuator_delay", "actuator_lag"} and same_place(model, one["location"], other["location"])


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


def parameter_error(missing: Mapping[str, Any], named: Mapping[str, Any]) -> float:
    """Relative error of the size of a correctly named effect.

    The size of a payload is its mass, that of a vector its length. Where an effect is absent at a value other than zero
    (friction, softness), errors are relative to the distance from that value; for a torque limit, to the limit.

    Args:
      missing: an effect of the truth.
      named: the effect of the answer.

    Returns:
      Norm of the error over the norm of the true size.
    """
    true, estimated = missing["parameters"], named["parameters"]
    if "mass" in true:
        names: Sequence[str] = ["mass"]
    elif "x" in true:
        names = [name for name in "xyz" if name in true]
    elif named["location"].startswith("each:"):
        names = list(estimated)
        true = {name: true.get(name, true.get(name.partition("[")[0])) for name in names}
    else:
        names = [next(iter(true))]
    null = [0.0 if name == "limit" else float(estimated[name].get("null", 0.0)) for name in names]
    truth = np.array([float(true[name]) for name in names])
    return float(np.linalg.norm([float(estimated[n]["value"]) - t for n, t in zip(names, truth, strict=True)])) / float(
        np.linalg.norm(truth - np.array(null))
    )


def gap_closed(chi2: Mapping[str, float]) -> float:
    """Share of the held-out chi^2 beyond what noise leaves that is closed."""
    excess = chi2["before"] - min(chi2["nulls"], chi2["after"])
    return (chi2["before"] - chi2["after"]) / excess if excess > 0 else 0.0


def judge(model: mujoco.MjModel, case: Case) -> dict[str, Any]:
    """Row of the table of cases: truth, answer, detectability and correctness of one case."""
    truth, answer, oracle = case["truth"], case["answer"], case["oracle"]
    hidden, named = truth["effects"], answer["effects"]
    row: dict[str, Any] = {
        "robot": truth["robot"],
        "seed": truth["seed"],
        "truth": truth["verdict"],
        "hidden": " + ".join(f"{e['effect']}@{e['location']}" for e in hidden) or truth["outside"] or "-",
        "said": answer["verdict"],
        "named": " + ".join(f"{e['effect']}@{e['location']}" for e in named) or "-",
        "visible": truth["visible"],
        "rate": truth["rate"],
        "noise": truth["noise"],
        "oracle": min(oracle["gains"], default=0.0),
        "detectable": bool(oracle["gains"]) and min(oracle["gains"]) > DETECTABLE,
        "oracle_score": min(oracle["scores"], default=0.0),
        "scoring": bool(oracle["scores"]) and min(oracle["scores"]) > DETECTABLE,
        "strong": truth["verdict"] == "unexplained" and truth["visible"] > STRONG,
        "score": named[0]["score"] if named else answer["best_score"],
        "margin": answer["margin"],
        "gap_before": answer["gap"]["before"],
        "gap_after": answer["gap"]["after"],
        "gap_closed": gap_closed(answer["gap"]),
        "gap_seen": answer["gap"]["before"] > answer["gap"]["nulls"],
        "set_size": len(answer["equivalent"]),
        "steps": answer["steps"],
        "seconds": answer["seconds"],
    }
    if hidden:
        found = [[n for n in named if same_effect(model, h, n)] for h in hidden]
        row["right"] = all(found) if len(hidden) > 1 else bool(named) and same_effect(model, hidden[0], named[0])
        said_first = named if len(hidden) > 1 else named[:1]
        row["right_or_twin"] = all(
            any(same_effect(model, h, n) or _lag_for_delay(model, h, n) for n in said_first) for h in hidden
        )
        close = [*named, *answer["equivalent"]]
        row["listed"] = all(any(same_effect(model, h, c) for c in close) for h in hidden)
        row["in_set"] = answer["verdict"] == "effect" and row["listed"]
        limbs = [limbs_of(model, h["location"]) for h in hidden]
        named_limbs = [limbs_of(model, n["location"]) for n in named]
        row["right_limb"] = all(limb in named_limbs for limb in limbs)
        row["extra"] = len(named) > len(hidden)
        errors = [parameter_error(h, f[0]) for h, f in zip(hidden, found, strict=True) if f]
        row["error"] = max(errors, default=float("nan")) if row["right"] else float("nan")
        inside = [inside_interval(model, h, f[0]) for h, f in zip(hidden, found, strict=True) if f]
        row["numbers"], row["numbers_inside"] = sum(map(len, inside)), sum(map(sum, inside))
    return row


def inside_interval(model: mujoco.MjModel, missing: Mapping[str, Any], named: Mapping[str, Any]) -> list[bool]:
    """Whether each true number of a correctly named effect lies within the interval that was reported."""
    if missing["location"] != named["location"]:
        return []  # the same effect by another label, such as one member of a group, has numbers of its own
    parameters = named["parameters"]
    truth = true_values(model, missing, list(parameters))
    return [bool(p["low"] <= v <= p["high"]) for v, p in zip(truth, parameters.values(), strict=True)]


def _share(rows: Sequence[Mapping[str, Any]], good: Callable[[Mapping[str, Any]], bool]) -> float | None:
    return float(np.mean([bool(good(row)) for row in rows])) if rows else None


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Numbers of the benchmark over the rows of `judge`; None where there are no cases of the kind."""
    effects = [r for r in rows if r["truth"] == "effect" and " + " not in r["hidden"]]
    pairs = [r for r in rows if r["truth"] == "effect" and " + " in r["hidden"]]
    nulls, outside = ([r for r in rows if r["truth"] == t] for t in ("none", "unexplained"))
    seen = [r for r in effects if r["detectable"]]
    scoring = [r for r in effects if r["scoring"]]
    right = [r for r in seen if r["right"]]
    errors = np.array([r["error"] for r in right])
    explained = [r for r in rows if r["truth"] != "unexplained"]
    count, inside = (sum(r[key] for r in (*effects, *pairs)) for key in ("numbers", "numbers_inside"))
    seen_gaps = [r["gap_closed"] for r in right if r["gap_seen"]]
    numbers: dict[str, Any] = {
        "cases": len(rows),
        "effects": len(effects),
        "pairs": len(pairs),
        "nulls": len(nulls),
        "outside": len(outside),
        "detectable": len(seen),
        "undetectable_share": _share(effects, lambda r: not r["detectable"]),
        "right_kind_and_place": _share(seen, lambda r: r["right"]),
        "right_or_lag_for_delay": _share(seen, lambda r: r["right_or_twin"]),
        "scoring": len(scoring),
        "right_of_scoring": _share(scoring, lambda r: r["right"]),
        "in_set_of_scoring": _share(scoring, lambda r: r["in_set"]),
        "right_of_all_effects": _share(effects, lambda r: r["right"]),
        "truth_in_equivalence_set": _share(seen, lambda r: r["in_set"]),
        "truth_named_or_not_ruled_out": _share(seen, lambda r: r["listed"]),
        "nulls_with_something_listed": _share(nulls, lambda r: r["set_size"] > 0),
        "set_size_mean": float(np.mean([r["set_size"] for r in seen])) if seen else None,
        "right_limb_or_body": _share(seen, lambda r: r["right_limb"]),
        "named_beside_the_truth": _share(seen, lambda r: r["extra"]),
        "parameter_error_median": float(np.median(errors)) if len(errors) else None,
        "parameter_error_90": float(np.percentile(errors, 90)) if len(errors) else None,
        "numbers": count,
        "within_intervals": inside / count if count else None,
        "nulls_named": _share(nulls, lambda r: r["said"] == "effect"),
        "strong_outside": sum(r["strong"] for r in outside),
        "strong_outside_flagged": _share([r for r in outside if r["strong"]], lambda r: r["said"] == "unexplained"),
        "outside_flagged": _share(outside, lambda r: r["said"] == "unexplained"),
        "outside_named": _share(outside, lambda r: r["said"] == "effect"),
        "false_unexplained": _share(explained, lambda r: r["said"] == "unexplained"),
        "false_names": _share(rows, lambda r: r["said"] == "effect" and not r.get("right", False)),
        "gap_closed_median": float(np.median([r["gap_closed"] for r in right])) if right else None,
        "gap_seen_share": _share(right, lambda r: r["gap_seen"]),
        "gap_closed_where_seen": float(np.median(seen_gaps)) if seen_gaps else None,
        "pairs_detectable": sum(r["detectable"] for r in pairs),
        "pairs_both_found": _share([r for r in pairs if r["detectable"]], lambda r: r["right"]),
        "pairs_or_lag_for_delay": _share([r for r in pairs if r["detectable"]], lambda r: r["right_or_twin"]),
        "steps_median": float(np.median([r["steps"] for r in rows])) if rows else None,
        "steps_largest": max((r["steps"] for r in rows), default=None),
        "seconds_median": float(np.median([r["seconds"] for r in rows])) if rows else None,
        "seconds_largest": max((r["seconds"] for r in rows), default=None),
    }
    return numbers


def bars(numbers: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Every aim with the measured value and whether it is met; None where nothing was measured."""
    out = {}
    for name, (sign, bar) in BARS.items():
        value = numbers[name]
        met = None if value is None else bool(value >= bar if sign == ">=" else value <= bar)
        out[name] = {"measured": value, "bar": f"{sign} {bar:g}", "met": met}
    return out


def confusion(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Counts of reported by hidden: effects, none, unexplained."""
    counts: dict[tuple[str, str], int] = {}
    for row in rows:
        hidden = (
            row["hidden"].split("@")[0] if row["truth"] == "effect" and " + " not in row["hidden"] else row["truth"]
        )
        hidden = "two effects" if " + " in row["hidden"] else hidden
        reported = row["named"].split("@")[0] if row["said"] == "effect" else row["said"]
        counts[hidden, reported] = counts.get((hidden, reported), 0) + 1
    return [{"hidden": h, "said": s, "cases": n} for (h, s), n in sorted(counts.items())]


MARGINS = (0.0, 10.0, 25.0, 50.0, 100.0, 400.0, np.inf)
"""Edges of the bins of `calibration`: differences of scores."""


def calibration(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Share of correct names by their margin over the next candidate."""
    named = [r for r in rows if r["said"] == "effect" and r["margin"] is not None]
    out = []
    for low, high in itertools.pairwise(MARGINS):
        inside = [r for r in named if low <= r["margin"] < high]
        out.append(
            {"from": low, "to": high, "names": len(inside), "right": _share(inside, lambda r: r.get("right", False))}
        )
    return out
