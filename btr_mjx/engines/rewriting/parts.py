"""Long programs as calls of shorter ones, which XLA's CPU backend compiles as functions of their own.

XLA compiles a `while` loop with all that it contains as one LLVM function, so that a step of `lanes` runs without the
dispatch of thousands of small kernels. Several passes of LLVM take time quadratic in the number of loops in a function:
a step of ten thousand equations takes minutes. `cut` divides such a program into calls, each of them one function. The
loop around them is interpreted.

The calls carry two frontend attributes of XLA: `inlineable=false` keeps them apart, `xla_cpu_small_call=true` has each
compiled as one function. Where XLA does not know these attributes, results are the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import xla_metadata_call
from jax.extend import core

from btr_mjx.engines.rewriting.flatten import rename

LONGEST = 8000
"""Equations of a program, those of its loops included, that are compiled as one function."""

PART = 1000
"""Equations of a call, at most. Longer loops have a function of their own, as XLA makes of every loop."""

_CALL = "xla_metadata_call"


def cut(jaxpr: core.Jaxpr) -> core.Jaxpr:
    """A flat program as calls of parts of it, if it is longer than `LONGEST` equations; else itself.

    The bodies of its loops must have been cut already. Cuts are made where few values are alive. A program that has
    been cut stays as it is. No equation may have effects or need XLA's runtime library (sorting, FFT, factorisations of
    matrices, callbacks).
    """
    eqns = jaxpr.eqns
    if sum(map(number_of_equations, eqns)) <= LONGEST or any(eqn.primitive.name in (_CALL, "sort") for eqn in eqns):
        return jaxpr
    last: dict[core.Var, int] = {}  # the last equation that reads a value; the end of the program for its results
    for i, eqn in enumerate(eqns):
        last |= dict.fromkeys(_variables(eqn.invars), i)
    last |= dict.fromkeys(_variables(jaxpr.outvars), len(eqns))
    alive = _alive(eqns, last)
    calls: list[core.JaxprEqn] = []
    start = 0
    for loop in [*(i for i, eqn in enumerate(eqns) if number_of_equations(eqn) > PART or _is_cut(eqn)), len(eqns)]:
        while start < loop:
            end = _end_of_part(start, loop, alive)
            calls += _call(jaxpr, start, end, last)
            start = end
        calls += eqns[loop : loop + 1]  # XLA compiles it as one function by itself, unless it has been cut
        start = loop + 1
    return _interpreted(jaxpr.replace(eqns=calls))


def _variables(atoms: Sequence[Any]) -> list[core.Var]:
    return [v for v in atoms if isinstance(v, core.Var)]


def number_of_equations(eqn: core.JaxprEqn) -> int:
    """Number of equations, those of bodies included."""
    return 1 + sum(number_of_equations(inner) for body in core.jaxprs_in_params(eqn.params) for inner in body.eqns)


def _is_cut(eqn: core.JaxprEqn) -> bool:
    """Whether an equation is a loop whose body has been cut."""
    return any(
        inner.primitive.name == _CALL or _is_cut(inner)
        for body in core.jaxprs_in_params(eqn.params)
        for inner in body.eqns
    )


def _alive(eqns: Sequence[core.JaxprEqn], last: Mapping[core.Var, int]) -> np.ndarray:
    """Before each equation, and at the end: number of results of earlier equations that are still to be read."""
    change = np.zeros(len(eqns) + 2, int)
    for i, eqn in enumerate(eqns):
        for v in eqn.outvars:
            if last.get(v, -1) > i:
                change[i + 1] += 1
                change[last[v] + 1] -= 1
    return np.cumsum(change)


def _end_of_part(start: int, stop: int, alive: np.ndarray) -> int:
    """End of a part that begins at `start`: before `stop`, where the fewest values are alive."""
    if stop - start <= PART:
        return stop
    first, after = start + PART // 2, min(start + PART, stop - PART // 2) + 1
    return first + int(np.argmin(alive[first:after]))


def _call(jaxpr: core.Jaxpr, start: int, end: int, last: Mapping[core.Var, int]) -> list[core.JaxprEqn]:
    """A call of the part of a program from equation `start` to before `end`."""
    part = jaxpr.eqns[start:end]
    made = dict.fromkeys(v for eqn in part for v in eqn.outvars)
    taken = list(dict.fromkeys(v for eqn in part for v in _variables(eqn.invars) if v not in made))
    given = [v for v in made if last.get(v, -1) >= end]

    def call(*values: jax.Array) -> list[jax.Array]:
        body = jaxpr.replace(constvars=[], consts=[], invars=taken, outvars=given + taken, eqns=part)
        results = xla_metadata_call(core.jaxpr_as_fun(body), inlineable="false", xla_cpu_small_call="true")(*values)
        # XLA aborts where it simplifies a function until it does not need an argument, unless that is a result too.
        # The barrier keeps JAX from dropping the results that nobody reads.
        return list(lax.optimization_barrier(results)[: len(given)])

    return _inline(jax.make_jaxpr(call)(*(v.aval for v in taken)), taken, given)


def _inline(jaxpr: core.Jaxpr, inputs: Sequence[core.Var], outputs: Sequence[core.Var]) -> list[core.JaxprEqn]:
    """The equations of a program, with other variables for its inputs and outputs."""
    names: dict[Any, Any] = dict(zip(jaxpr.invars, inputs, strict=True))
    results = dict(zip(jaxpr.outvars, outputs, strict=True))
    eqns = []
    for eqn in jaxpr.eqns:
        new = {v: results.get(v, core.Var(v.aval)) for v in eqn.outvars}
        eqns.append(eqn.replace(invars=rename(names, eqn.invars), outvars=list(new.values())))
        names |= new
    return eqns


def _interpreted(jaxpr: core.Jaxpr) -> core.Jaxpr:
    """The program, such that XLA does not compile a loop around it as one function.

    XLA does so unless the loop contains an operation of its runtime library. A sort of two equal values is one; XLA
    would simplify it away if it had no key, and move it out of the loop if it did not read a result.
    """
    made = {v for eqn in jaxpr.eqns for v in eqn.outvars}
    results: list[Any] = [v for v in _variables(jaxpr.outvars) if v in made]
    value = min(results, key=lambda v: v.aval.size)

    def sort(x: jax.Array) -> jax.Array:
        twice = jnp.broadcast_to(x, (2, *x.shape))
        return lax.sort((lax.broadcasted_iota(jnp.int32, twice.shape, 0), twice), dimension=0, num_keys=1)[1][0]

    result = core.Var(value.aval)
    eqns = [*jaxpr.eqns, *_inline(jax.make_jaxpr(sort)(value.aval), [value], [result])]
    return jaxpr.replace(eqns=eqns, outvars=rename({value: result}, jaxpr.outvars))
