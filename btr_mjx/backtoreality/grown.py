"""A problem whose simulator got effects: more parts of the robot, and more dimensions of S."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from btr_mjx.backtoreality.run_state import Problem
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.results import FoundEffect, added_effects
from btr_mjx.models import general_model
from btr_mjx.robots import Box, Robot


def grown(problem: Problem, entries: Sequence[Mapping[str, Any]]) -> Problem:
    """The problem with the effects that were added to it.

    Args:
      problem: as it began.
      entries: of `State.grown`.

    Returns:
      The problem; its unknown parameters are those at the beginning, then the numbers of the effects. Effects that are
      not edits of a model run in native MuJoCo, whatever engine was asked for.
    """
    if not entries:
        return problem
    robot = _grown_robot(problem.robot, json.dumps(list(entries)))
    added = robot.simulation_box.names[problem.robot.simulation_box.n :]
    start = np.concatenate([problem.start, robot.nominal[problem.robot.simulation_box.n :]])
    engine = problem.engine if robot.simulator is None else None
    return replace(problem, robot=robot, unknown=(*problem.unknown, *added), start=start, engine=engine)


def number_name(effect: str, location: str, parameter: str) -> str:
    """Name in S of a number of an effect."""
    return f"{effect} {location} {parameter}"


@lru_cache(maxsize=16)
def _grown_robot(robot: Robot, entries: str) -> Robot:
    model = general_model(robot, robot.nominal_simulation)
    box, nominal = robot.simulation_box, list(robot.nominal)
    names, low, high, units = list(box.names), box.low.tolist(), box.high.tolist(), list(box.units)
    found, parameters = [], []
    for entry in json.loads(entries):
        numbers = entry["numbers"]
        found.append(FoundEffect(entry["effect"], entry["location"], {n: d["value"] for n, d in numbers.items()}))
        parameters.append(tuple(number_name(entry["effect"], entry["location"], name) for name in numbers))
        names += parameters[-1]
        low += [number["low"] for number in numbers.values()]
        high += [number["high"] for number in numbers.values()]
        nominal += [number["null"] for number in numbers.values()]
        units += [number["unit"] for number in numbers.values()]
    edits, simulator = added_effects(model, found, parameters, EFFECTS, robot.simulator)
    bits = [*box.bits, *[max(box.bits)] * (len(names) - box.n)]
    return replace(
        robot,
        simulation_box=Box(names, low, high, bits=bits, code=box.code, units=units),
        nominal=tuple(nominal),
        edits=(*robot.edits, *edits),
        simulator=simulator,
    )
