"""What trials tell of the unknown numbers, in their units and in words."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from btr_mjx.backtoreality.run_state import Problem
from btr_mjx.backtoreality.trial_information import LEVEL, PLANNED_SCATTER, Told, told_by
from btr_mjx.gap.results import format_number
from btr_mjx.robots import Box


def told_record(told: Told, box: Box) -> dict[str, Any]:
    """What trials tell of the numbers of a box, JSON-able.

    Returns:
      `intervals`, unknown number -> [low, high] in its unit, which holds the simulation's value; `told`, names of those
      that are told, while the interval of the others is their range; `combinations`, sentences on others of which only
      a combination is told.
    """
    ends = (told.interval * box.span + box.low).tolist()
    return {
        "intervals": {name: [a, b] for name, a, b in zip(box.names, *ends, strict=True)},
        "told": _names(box, told.told),
        "combinations": _sentences(box, told),
    }


def told_by_plan(problem: Problem, simulation: np.ndarray, controllers: np.ndarray) -> str:
    """Which unknown numbers trials of controllers (M, n_c) will tell, by a simulation (n_s,), as a sentence."""
    box = problem.simulation_box
    told = told_by(problem, simulation, controllers)
    known, rest = _names(box, told.told), _names(box, ~told.told)
    text = f"the {len(controllers)} planned trials, if they scatter by {100 * PLANNED_SCATTER:g} % of the fitness, "
    text += f"can tell {_listed(known)}" if known else "can tell no unknown number"
    text += f", not {_listed(rest)}" if known and rest else ""
    return "; ".join([text, *_sentences(box, told)])


def told_sentence(told: Mapping[str, Any], box: Box) -> str:
    """What trials tell, by `told_record` and the box of the unknown numbers."""
    parts = []
    for name in told["told"]:
        low, high = (format_number(value) for value in told["intervals"][name])
        parts.append(f"{name} {low} to {high} {box.units[box.index(name)]}".rstrip())
    rest = [name for name in told["intervals"] if name not in told["told"]]
    text = f"told by the trials ({100 * LEVEL:g} %): {', '.join(parts) or 'nothing'}"
    return "; ".join([text, *([f"not told: {', '.join(rest)}"] if rest else []), *told["combinations"]])


def _names(box: Box, chosen: np.ndarray) -> list[str]:
    return [name for name, own in zip(box.names, chosen, strict=True) if own]


def _sentences(box: Box, told: Told) -> list[str]:
    out = []
    for own, directions in told.combinations().items():
        names = [box.names[i] for i in own]
        if len(own) == 2 and len(directions) == 1:
            first, second = directions[0] / box.span[list(own)]
            sign = "+" if first * second > 0 else "-"
            out.append(f"only {names[0]} {sign} {abs(second / first):.2g} × {names[1]} is told")
        else:
            count = "one combination" if len(directions) == 1 else f"{len(directions)} combinations"
            verb = "is" if len(directions) == 1 else "are"
            out.append(f"only {count} of {_listed(names)} {verb} told")
    return out


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
