"""A JAX transformation that rewrites a function so that XLA computes each expensive value once.

XLA's CPU backend fuses an elementwise producer into *every* consumer and computes it again in each of them. In a long
straight-line program (thousands of operations on arrays of lanes) this recomputation multiplies along chains and
dominates both the run time and the compile time. `retrace` traces the function to a jaxpr and

1. inlines nested calls (`jit`, `closed_call`, `custom_jvp`), with fresh variables for every inlined equation;
2. merges common subexpressions, in the same walk;
3. drops equations whose results are not used;
4. puts a `lax.optimization_barrier` after each value that several equations use and that is expensive to recompute;
5. with `in_parts`, makes calls of the parts of long programs (`parts.py`), so that they compile in less time.

The bodies of `while`, `scan` and `cond` are rewritten in the same way.

Guarantees: The rewritten function performs the same operations on the same operands as the original, each at most as
often; op by op (outside `jit`) its results have the same bits. Under `jit` the compiler may fuse differently, so
results agree to rounding. Derivatives are those of the original function, custom rules included. Equations with side
effects keep their order and are never merged, dropped or rewritten inside; callbacks and random primitives are never
merged. `retrace(retrace(f))` equals `retrace(f)`. All passes take time linear in the size of the jaxpr.

Limits: As under `jax.jit`, the wrapped function receives tracers, not values. Nothing is cached: each call traces
again, so call it inside `jit`. Existing barriers are kept. Shardings and compiler options attached
to a nested `jit` keep it from being inlined; its body is rewritten all the same.
"""

import functools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core

from btr_mjx.engines.rewriting.flatten import Flattener, is_pure, rename
from btr_mjx.engines.rewriting.parts import cut

_P = core.primitives


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_COSTS: Mapping[str, float] = (
    # XLA folds data movement into the indexing of the loop that reads the elements.
    dict.fromkeys(_words("broadcast_in_dim convert_element_type copy reshape rev slice squeeze transpose"), 0.0)
    | dict.fromkeys(_words("cbrt div rem rsqrt sqrt"), 8.0)
    | dict.fromkeys(_words("acos acosh asin asinh atan atan2 atanh cos cosh digamma erf erf_inv erfc exp exp2"), 30.0)
    | dict.fromkeys(_words("expm1 lgamma log log1p logistic pow sin sinh tan tanh argmax argmin"), 30.0)
    | dict.fromkeys(_words("reduce_and reduce_max reduce_min reduce_or reduce_prod reduce_sum reduce_xor"), 30.0)
)
"""Cost of one equation per element, in simple arithmetic operations. Primitives that are not listed cost 1."""

# XLA always writes the results of these primitives to memory and never recomputes them.
_OPAQUE = _words(
    "cholesky conv_general_dilated cumsum cumprod cummax cummin cumlogsumexp dot_general fft gather "
    "optimization_barrier scatter scatter_add scatter_max scatter_min scatter_mul sort triangular_solve threefry2x32"
)

# The parameters that hold the bodies of control flow.
_BODIES = {
    _P.while_p: ("cond_jaxpr", "body_jaxpr"),
    _P.scan_p: ("jaxpr",),
    _P.cond_p: ("branches",),
    _P.jit_p: ("jaxpr",),
}


def retrace[**A, R](fn: Callable[A, R], *, threshold: float = 8.0, in_parts: bool = False) -> Callable[A, R]:
    """Returns `fn` with common subexpressions merged and expensive shared values computed once.

    The cost of a value is the cost of its own operation plus the costs of its operands, counted back to the nearest
    arguments or values that are in memory already (barriers, loop results, matrix products). A value with `n >= 2`
    users gets a barrier if recomputing it `n - 1` times costs more than `threshold`; a result of the function counts as
    one more user.

    Args:
        fn: A function of pytrees of arrays and numbers, as `jax.jit` takes. It may be used under any JAX
            transformation, and inside the bodies of loops.
        threshold: Cost below which recomputation is cheaper than a store and a load, in simple operations per element.
            Zero puts a barrier on every shared value of positive cost, infinity none (subexpressions are still merged).
        in_parts: Whether long programs, and long bodies of loops, become calls of shorter ones; for programs that
            `parts.cut` allows.

    Returns:
        A function with the signature, the results and the derivatives of `fn`.
    """

    @functools.wraps(fn)
    def retraced(*args: A.args, **kwargs: A.kwargs) -> R:
        jaxpr, consts, tree = _trace(fn, args, kwargs)
        result = _Rewriter(threshold, in_parts, inline_custom=is_pure(jaxpr)).rewrite(jaxpr)
        run = core.jaxpr_as_fun(result.jaxpr)
        if result.custom:
            # Inlining loses custom derivative rules, so derivatives are those of the program as it was traced.
            original = core.jaxpr_as_fun(jaxpr)
            run = jax.custom_jvp(run)
            run.defjvp(lambda primals, tangents: jax.jvp(original, primals, tangents))
        return jax.tree.unflatten(tree, run(*consts, *map(_as_array, jax.tree.leaves((args, kwargs)))))

    return retraced


class _Result(NamedTuple):
    jaxpr: core.Jaxpr
    custom: bool  # a call with a custom derivative rule was inlined somewhere in it


def _trace(fn: Callable[..., Any], args: Any, kwargs: Any) -> tuple[core.Jaxpr, Sequence[Any], Any]:
    """Traces `fn`; returns its jaxpr, the values of the leading inputs that are constants, and the output's tree."""
    # A new function object each time: JAX caches traces by function, and `fn` may close over tracers that changed.
    jaxpr, shape = jax.make_jaxpr(lambda *a, **k: fn(*a, **k), return_shape=True)(*args, **kwargs)
    # Constants may be tracers of an enclosing transformation too: as inputs they are differentiated like arguments.
    return jaxpr.with_consts(()), jaxpr.consts, jax.tree.structure(shape)


def _as_array(leaf: Any) -> Any:
    # Primitives would keep the 64 bits of numpy arrays, which `jit` converts to the default precision.
    return jnp.asarray(leaf) if isinstance(leaf, (bool, int, float, complex, np.ndarray, np.generic)) else leaf


class _Rewriter:
    """Rewrites one traced function. A body that occurs twice (as the same object) is rewritten once."""

    def __init__(self, threshold: float, in_parts: bool, inline_custom: bool):
        self.threshold, self.in_parts, self.inline_custom = threshold, in_parts, inline_custom
        self.done: dict[int, tuple[core.Jaxpr, _Result]] = {}  # keeps the jaxprs alive, so that their ids stay unique

    def rewrite(self, jaxpr: core.Jaxpr) -> _Result:
        if id(jaxpr) not in self.done:
            self.done[id(jaxpr)] = (jaxpr, self._rewrite(jaxpr))
        return self.done[id(jaxpr)][1]

    def _rewrite(self, jaxpr: core.Jaxpr) -> _Result:
        flat = Flattener(self.inline_custom)
        invars = [core.Var(v.aval) for v in jaxpr.invars]
        outvars = flat.add(jaxpr, invars)
        live, readers = _liveness(flat.eqns, outvars)
        eqns: list[core.JaxprEqn] = []
        behind_barrier: dict[Any, core.Var] = {}  # shared value -> the same value behind its barrier
        cost: dict[core.Var, float] = {}  # of recomputing a value from what is in memory; absent if it is there
        custom = flat.custom
        for eqn in live:
            for body in self._bodies(eqn):
                custom |= self.rewrite(body).custom
            eqns.append(eqn.replace(invars=rename(behind_barrier, eqn.invars), params=self._rewritten_params(eqn)))
            if eqn.primitive.multiple_results or eqn.primitive.name in _OPAQUE:
                continue
            (out,) = eqn.outvars
            own = _COSTS.get(eqn.primitive.name, 1.0)
            # An operand used twice by one equation is computed once: XLA emits one loop body per reader.
            cost[out] = own + sum(cost.get(v, 0.0) for v in {v for v in eqn.invars if isinstance(v, core.Var)})
            if cost[out] * (readers.get(out, 0) - 1) > self.threshold and _accepts_barrier(out.aval):
                behind_barrier[out] = core.Var(out.aval)
                cost[out] = 0.0
                eqns.append(_barrier(out, behind_barrier[out], eqn))
        result = core.Jaxpr(
            constvars=list(flat.constvars.values()),
            invars=invars,
            outvars=rename(behind_barrier, outvars),
            eqns=eqns,
            effects=jaxpr.effects,
            debug_info=jaxpr.debug_info,
            consts=flat.constants,
        )
        return _Result(cut(result) if self.in_parts else result, custom)

    def _bodies(self, eqn: core.JaxprEqn) -> list[core.Jaxpr]:
        """The jaxprs in `eqn` to be rewritten; none if it has effects, which may refer to its variables."""
        if eqn.effects:
            return []
        values = [eqn.params[name] for name in _BODIES.get(eqn.primitive, ())]
        return [body for v in values for body in (v if isinstance(v, tuple) else (v,)) if is_pure(body)]

    def _rewritten_params(self, eqn: core.JaxprEqn) -> dict[str, Any]:
        new = {id(body): self.rewrite(body).jaxpr for body in self._bodies(eqn)}
        if not new:
            return eqn.params
        params = dict(eqn.params)
        for name in _BODIES[eqn.primitive]:
            old = params[name]
            params[name] = tuple(new.get(id(v), v) for v in old) if isinstance(old, tuple) else new.get(id(old), old)
        return params


def _liveness(eqns: Sequence[core.JaxprEqn], outvars: Sequence[Any]) -> tuple[list[core.JaxprEqn], Counter[core.Var]]:
    """Live equations, and the number of users of each value; being an output counts as one use."""
    readers = Counter({v for v in outvars if isinstance(v, core.Var)})
    live = []
    for eqn in reversed(eqns):
        if eqn.effects or any(v in readers for v in eqn.outvars):
            live.append(eqn)
            readers.update({v for v in eqn.invars if isinstance(v, core.Var)})
    return live[::-1], readers


def _accepts_barrier(aval: Any) -> bool:
    """Whether a barrier may be put on values of this type: arrays of numbers, not keys, tokens or references."""
    return isinstance(aval, jax.core.ShapedArray) and aval.size > 0 and isinstance(aval.dtype, np.dtype)


def _barrier(value: core.Var, result: core.Var, like: core.JaxprEqn) -> core.JaxprEqn:
    return core.new_jaxpr_eqn([value], [result], lax.optimization_barrier_p, {}, set(), like.source_info, like.ctx)
