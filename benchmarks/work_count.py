"""Operations, bytes and runs of loops of a program that XLA has compiled.

An operation is one per element, a division too, and counts as often as the loop around it is run. Counts are those of
the optimised HLO, so that what XLA computes twice counts twice.
"""

import re
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core

_LINE = re.compile(r"\s*(?:ROOT )?%([\w.\-]+) = (\(.*?\)|\S+) ([\w\-]+)\((.*?)\)(.*)")
_UNTOUCHED = re.compile("parameter|constant|tuple|get-tuple-element|bitcast|iota|while|conditional|call|opt-barrier")
_MOVES = re.compile(
    _UNTOUCHED.pattern + "|broadcast|reshape|slice|concatenate|copy|transpose|fusion|dynamic-slice|"
    "dynamic-update-slice|gather|pad|convert"
)
"""HLO instructions that read and write nothing of their own, and those without arithmetic."""


def work_of(hlo: str, runs: Sequence[float]) -> tuple[float, float]:
    """Operations, and bytes read and written, of a module whose loops, in the order of their beginnings, run so often.

    The runs of an inner loop are those in all runs of the outer ones.
    """
    found: dict[str, dict[str, tuple[str, str, list[str], list[str]]]] = {}
    entry = name = ""
    for line in re.sub(r"/\*.*?\*/", "", hlo).splitlines():
        if line.endswith("{") and "->" in line:
            name = re.sub(r"^(ENTRY )?%?", "", line).split()[0]
            entry, found[name] = name if line.startswith("ENTRY") else entry, {}
        elif match := _LINE.match(line):
            label, shape, opcode, given, rest = match.groups()
            calls = re.findall(r"(?:calls|to_apply|body|condition)=%?([\w.\-]+)", rest)
            found[name][label] = opcode, shape, re.findall(r"%([\w.\-]+)", given), calls
    rest_of_runs = iter(runs)

    def inside(name: str, times: float, fused: bool) -> np.ndarray:
        own, work = found[name], np.zeros(2)
        for opcode, shape, given, calls in own.values():
            if not _MOVES.fullmatch(opcode):
                work[0] += times * _size(own[given[0]][1] if opcode in ("reduce", "reduce-window") else shape)[0]
            if not fused and not _UNTOUCHED.fullmatch(opcode):
                work[1] += times * sum(_size(x)[1] for x in (shape, *(own[label][1] for label in given)))
            inner = next(rest_of_runs) if opcode == "while" else times
            if opcode in ("while", "fusion", "call"):
                work += sum(inside(called, inner, fused or opcode == "fusion") for called in calls)
        return work

    operations, moved = inside(entry, 1.0, False)
    return float(operations), float(moved)


def _size(shape: str) -> tuple[int, int]:
    """Elements and bytes of a type of HLO, of all its parts."""
    parts = re.findall(r"(pred|[suf]\d+)\[([\d,]*)\]", shape)
    counts = [int(np.prod([int(d) for d in dims.split(",") if d])) for _, dims in parts]
    widths = [1 if kind == "pred" else int(kind[1:]) // 8 for kind, _ in parts]
    return sum(counts), sum(count * width for count, width in zip(counts, widths, strict=True))


def loops(jaxpr: core.Jaxpr) -> int:
    """Number of loops in a program."""
    inner = (loops(body) for eqn in jaxpr.eqns for body in core.jaxprs_in_params(eqn.params))
    return sum(inner) + sum(eqn.primitive.name in ("while", "scan") for eqn in jaxpr.eqns)


def counted(jaxpr: core.Jaxpr, consts: Sequence[Any], arguments: Sequence[Any]) -> tuple[list[Any], list[jax.Array]]:
    """Results of a program, and of each loop the number of runs, and that which its lanes need on average.

    These differ for loops that go on as long as any lane does: a lane needs a run if the first vector of bools that
    such a loop carries is true for it. Loops with a fixed number of runs may have no inputs that differ between runs.
    """
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments], strict=True))
    runs: list[jax.Array] = []
    for eqn in jaxpr.eqns:
        given = [x.val if isinstance(x, core.Literal) else values[x] for x in eqn.invars]
        own: list[jax.Array] = []
        if eqn.primitive.name in ("while", "scan"):
            results, own = _counted_loop(eqn, given)
        elif eqn.primitive.name in ("jit", "xla_metadata_call"):
            results, own = counted(eqn.params["jaxpr"].jaxpr, eqn.params["jaxpr"].consts, given)
        else:
            results = eqn.primitive.bind(*given, **eqn.primitive.get_bind_params(eqn.params))
            results = results if eqn.primitive.multiple_results else [results]
        runs += own
        values |= dict(zip(eqn.outvars, results, strict=True))
    return [x.val if isinstance(x, core.Literal) else values[x] for x in jaxpr.outvars], runs


def _counted_loop(eqn: core.JaxprEqn, given: Sequence[Any]) -> tuple[list[Any], list[jax.Array]]:
    """`counted` of a loop and those inside it."""
    fixed = eqn.primitive.name == "scan"
    body = eqn.params["jaxpr" if fixed else "body_jaxpr"]
    first = 0 if fixed else eqn.params["cond_nconsts"]
    second = len(eqn.params["ft_in"][0]) if fixed else first + eqn.params["body_nconsts"]
    condition = None if fixed else eqn.params["cond_jaxpr"]
    waits = condition is not None and any(e.primitive.name == "reduce_or" for e in condition.jaxpr.eqns)
    flags = [i for i, x in enumerate(given[second:]) if waits and jnp.ndim(x) == 1 and x.dtype == bool]

    def step(carry: tuple) -> tuple:
        state, sums = carry
        following, inner = counted(body.jaxpr, body.consts, [*given[first:second], *state])
        more = [jnp.float32(1), state[flags[0]].mean(dtype=jnp.float32) if flags else jnp.float32(1), *inner]
        return following, [x + y for x, y in zip(sums, more, strict=True)]

    begin = [jnp.asarray(x) for x in given[second:]], [jnp.float32(0)] * (2 + 2 * loops(body.jaxpr))
    if condition is None:
        return lax.fori_loop(0, eqn.params["length"], lambda _, carry: step(carry), begin)
    going = lambda carry: core.jaxpr_as_fun(condition)(*given[:first], *carry[0])[0]  # noqa: E731
    return lax.while_loop(going, step, begin)
