"""Flattening of a traced function into one list of equations: calls are inlined, common subexpressions merged.

Two equations are merged only if they compute the same bits; see `retrace` for the guarantees.
"""

import struct
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

_P = core.primitives

# a op b equals b op a to the bit. This does not hold for float max and min of +0 and -0.
_COMMUTATIVE = frozenset({"add", "mul", "and", "or", "xor", "eq", "ne"})
_COMMUTATIVE_EXACT = frozenset({"max", "min"})

# Never merged: barriers keep values apart, copies own their memory, the others may have state.
_KEEP_APART = ("optimization_barrier", "copy", "random_", "rng_", "threefry", "pure_callback", "io_callback", "infeed")


class _Unmergeable(Exception):
    """Raised for an equation whose parameters cannot be compared."""


def is_pure(jaxpr: core.Jaxpr) -> bool:
    """Whether neither a jaxpr nor any of its equations has side effects."""
    return not jaxpr.effects and not any(eqn.effects for eqn in jaxpr.eqns)


class Flattener:
    """Copies equations into one list, inlining calls and leaving out equations that are already in the list."""

    def __init__(self, inline_custom: bool):
        self.inline_custom = inline_custom
        self.eqns: list[core.JaxprEqn] = []
        self.constants: list[Any] = []
        self.constvars: dict[tuple[int, Any], core.Var] = {}
        self.custom = False
        self.known: dict[Hashable, list[core.Var]] = {}

    def add(self, jaxpr: core.Jaxpr, inputs: Sequence[Any]) -> list[Any]:
        """Adds the equations of `jaxpr` applied to `inputs`; returns the variables or literals of its results."""
        # One jaxpr may be added many times, and jaxprs may share variables: names are local to this call.
        names = dict(zip(jaxpr.invars, inputs, strict=True))
        names.update((v, self._constant(v, c)) for v, c in zip(jaxpr.constvars, jaxpr.consts, strict=True))
        for eqn in jaxpr.eqns:
            operands = rename(names, eqn.invars)
            body = self._inlinable(eqn, operands)
            if body is None:
                names.update(zip(eqn.outvars, self._append(eqn, operands), strict=True))
            else:
                self.custom |= eqn.primitive is _P.custom_jvp_call_p
                names.update(zip(eqn.outvars, self.add(body, operands), strict=True))
        return rename(names, jaxpr.outvars)

    def _constant(self, var: core.Var, value: Any) -> core.Var:
        key = (id(value), var.aval)
        if key not in self.constvars:
            self.constvars[key] = core.Var(var.aval)
            self.constants.append(value)
        return self.constvars[key]

    def _inlinable(self, eqn: core.JaxprEqn, operands: Sequence[Any]) -> core.Jaxpr | None:
        """The jaxpr that `eqn` calls if it can be inlined, else None."""
        params = eqn.params
        if eqn.primitive is _P.jit_p:
            # Shardings, layouts and options of a nested compilation cannot be applied to a part of a program.
            requested = [
                *params["in_shardings"],
                *params["out_shardings"],
                *params["in_layouts"],
                *params["out_layouts"],
            ]
            if params["compiler_options_kvs"] or any(
                a is not None and repr(a) != "UnspecifiedValue" for a in requested
            ):
                return None
            body = params["jaxpr"]
        elif eqn.primitive in (_P.call_p, _P.closed_call_p) or (
            eqn.primitive is _P.custom_jvp_call_p and self.inline_custom
        ):
            body = params["call_jaxpr"]
        else:
            return None
        inner, outer = [*body.invars, *body.outvars], [*operands, *eqn.outvars]
        same_types = len(inner) == len(outer) and all(a.aval == b.aval for a, b in zip(inner, outer, strict=True))
        return body if same_types and not eqn.effects and is_pure(body) else None

    def _append(self, eqn: core.JaxprEqn, operands: list[Any]) -> list[core.Var]:
        try:
            key = _key(eqn, operands)
        except _Unmergeable:
            key = None
        if key in self.known:
            return self.known[key]
        outvars = [core.Var(v.aval) for v in eqn.outvars]
        self.eqns.append(eqn.replace(invars=operands, outvars=outvars))
        if key is not None:
            self.known[key] = outvars
        return outvars


def rename(names: Mapping[Any, Any], atoms: Sequence[Any]) -> list[Any]:
    """Variables replaced by their new names, where they have one; literals unchanged."""
    return [v if isinstance(v, core.Literal) else names.get(v, v) for v in atoms]


def _key(eqn: core.JaxprEqn, operands: Sequence[Any]) -> Hashable:
    """A key that two equations share only if they compute the same bits; raises `_Unmergeable` if there is none."""
    name = eqn.primitive.name
    if eqn.effects or name.startswith(_KEEP_APART):
        raise _Unmergeable
    inputs: Any = tuple(_literal_key(v) if isinstance(v, core.Literal) else v for v in operands)
    if name in _COMMUTATIVE or (name in _COMMUTATIVE_EXACT and not jnp.issubdtype(operands[0].aval.dtype, jnp.inexact)):
        inputs = frozenset(inputs)
    # Types and contexts are interned by JAX, so they compare by identity. Types include weakness and sharding.
    return eqn.primitive, inputs, _freeze(eqn.params), tuple(v.aval for v in eqn.outvars), eqn.ctx


def _literal_key(literal: core.Literal) -> Hashable:
    # By bits: 0 and -0 differ, a NaN equals itself, and 1 is not 1.0 nor True, because the types differ.
    if not isinstance(literal.aval, jax.core.ShapedArray) or not isinstance(literal.aval.dtype, np.dtype):
        raise _Unmergeable
    return literal.aval, np.asarray(literal.val, dtype=literal.aval.dtype).tobytes()


def _freeze(value: Any) -> Hashable:
    """A hashable key for a parameter; unlike `==` it distinguishes 1, True and 1.0, and 0.0 and -0.0."""
    if isinstance(value, dict):
        return type(value), frozenset((k, _freeze(v)) for k, v in value.items())
    if isinstance(value, tuple | list):
        return type(value), tuple(map(_freeze, value))
    if isinstance(value, float):
        return type(value), struct.pack("d", value)
    if isinstance(value, complex):
        return type(value), struct.pack("dd", value.real, value.imag)
    if isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        return type(value), value.dtype, value.shape, value.tobytes()
    if isinstance(value, core.Jaxpr):
        raise _Unmergeable
    try:
        hash(value)
    except TypeError:
        raise _Unmergeable from None
    return type(value), value
