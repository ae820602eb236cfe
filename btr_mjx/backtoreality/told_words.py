"""What trials tell of the unknown numbers, in their units and in words."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from btr_mjx.backtoreality.run_state import Problem
from btr_mjx.backtoreality.trial_information import LEVEL, PLANNED_SCATTER, Told, told_by
from btr_mjx.gap.results import format_number
from btr_mjx.robots import Box

MOST_NAMED = 3
"""Parameters that a verdict names one by one."""


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


def identified_words(result: Mapping[str, Any]) -> str:
    """What became of the unknown parameters, by the content of result.json; a value that is not told is not given.

    Of a few parameters it gives the values, of many the mean error in percent of their ranges where it is known.
    """
    told = list(result["told"]["told"])
    rest = [name for name in result["simulation"] if name not in told]
    left = _listed(rest) if 0 < len(rest) <= MOST_NAMED else f"{len(rest)} parameters"
    if not told:
        return f"these trials do not tell {left}"
    if len(told) <= MOST_NAMED:
        text = ", ".join(_from_start(result, name) for name in told)
    else:
        known = [name for name in told if name in (result["truth"] or {})]
        text = f"{len(told)} parameters are told" + (f", {_mean_error(result, known)}" if known else "")
    return f"{text}; not told by these trials: {left}" if rest else text


def _from_start(result: Mapping[str, Any], name: str) -> str:
    unit = f" {result['space'][name]['unit']}".rstrip()
    start, end = (format_number(result[key][name]) for key in ("start", "simulation"))
    text = f"{name} goes from {start} to {end}{unit}" if start != end else f"{name} stays at {end}{unit}"
    true = (result["truth"] or {}).get(name)
    return text if true is None else f"{text} (truth: {format_number(true)}{unit})"


def _mean_error(result: Mapping[str, Any], names: Sequence[str]) -> str:
    """Of the parameters whose true values are known."""
    spans = np.array([result["space"][name]["high"] - result["space"][name]["low"] for name in names])
    first, last = (
        format_number(100 * float(np.mean([abs(result[key][n] - result["truth"][n]) for n in names] / spans)), 2)
        for key in ("start", "simulation")
    )
    return f"the mean error of {len(names)} of them goes from {first} % to {last} % of their ranges"


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
