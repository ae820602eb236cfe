"""Long programs as calls of their parts: the same results, and functions that XLA compiles one by one."""

import re

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jax import lax
from lanes_models import QUICK
from random_programs import INTEGER, integer_program, straight_line
from retrace_checks import assert_same, equations, op_by_op

from btr_mjx.engines import LanesStepper
from btr_mjx.engines.rewriting import parts
from btr_mjx.engines.rewriting.retrace import retrace

CALL = "xla_metadata_call"


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs of more than 40 equations are cut, into parts of up to 10."""
    monkeypatch.setattr(parts, "LONGEST", 40)
    monkeypatch.setattr(parts, "PART", 10)


def calls(fn, *args) -> list:
    return [eqn for eqn in equations(jax.make_jaxpr(fn)(*args)) if eqn.primitive.name == CALL]


def long_loop(count: int):
    """A loop of `count` random operations on integers, which stay exact."""

    def fn(x: jax.Array, y: jax.Array, turns: jax.Array) -> tuple[jax.Array, jax.Array]:
        def body(i: jax.Array, carry: tuple) -> tuple:
            pool = straight_line(np.random.default_rng(count), [*carry, carry[0] + i], INTEGER, count)
            return pool[-1] + pool[count // 2], pool[-2]

        return lax.fori_loop(0, turns, body, (x, y))

    return fn


INPUTS = (np.arange(3, dtype=np.int32), np.array([5, -7, 11], np.int32), np.int32(4))


@pytest.mark.parametrize("number", range(4))
def test_nested_control_flow_is_exact(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "LONGEST", 12)
    monkeypatch.setattr(parts, "PART", 5)
    program, inputs = integer_program(number, 2), [np.arange(3, dtype=np.int32), np.ones((2, 3), np.int32)]
    new = retrace(program, threshold=2, in_parts=True)
    assert len(calls(new, *inputs)) > 2
    with jax.enable_checks(True):
        assert_same(jax.jit(new)(*inputs), jax.jit(program)(*inputs))


@pytest.mark.usefixtures("short")
def test_parts_are_short_and_the_loop_is_not_one_function() -> None:
    new = retrace(long_loop(120), in_parts=True)
    found = calls(new, *INPUTS)
    assert len(found) > 8
    assert all(len(eqn.params["jaxpr"].eqns) <= 10 for eqn in found)
    compiled = jax.jit(new).lower(*INPUTS).compile()
    text = compiled.as_text()
    entry = text[text.index("ENTRY") :]
    assert " while(" in entry  # not in a function of its own
    assert len(re.findall(r" call\(.*xla_cpu_small_call", text)) == len(found)
    assert_same(compiled(*INPUTS), jax.jit(long_loop(120))(*INPUTS))


def test_short_programs_stay_whole() -> None:
    assert not calls(retrace(long_loop(120), in_parts=True), *INPUTS)


@pytest.mark.usefixtures("short")
def test_twice_is_once() -> None:
    once = retrace(long_loop(120), in_parts=True)
    twice = retrace(once, in_parts=True)
    assert [len(eqn.params["jaxpr"].eqns) for eqn in calls(once, *INPUTS)] == [
        len(eqn.params["jaxpr"].eqns) for eqn in calls(twice, *INPUTS)
    ]


@pytest.mark.usefixtures("short")
def test_cuts_are_where_few_values_are_alive() -> None:
    """Three values are made and summed in turn: a cut anywhere else than behind a sum takes more along."""

    def fn(x: jax.Array) -> jax.Array:
        for _ in range(12):
            many = [lax.optimization_barrier(x * k) for k in (2, 3, 5)]
            x = lax.optimization_barrier(many[0] + many[1] + many[2])
        return x

    found = calls(retrace(fn, in_parts=True), np.int32(1))
    assert len(found) > 5
    assert {len(eqn.invars) for eqn in found} == {1}


@pytest.mark.usefixtures("short")
def test_arguments_that_the_compiler_finds_to_be_of_no_use() -> None:
    """XLA aborts the process where a function it was given does not read an argument any more."""

    def fn(x: jax.Array, y: jax.Array, turns: jax.Array) -> jax.Array:
        def body(i: jax.Array, carry: jax.Array) -> jax.Array:
            for k in range(20):
                carry = lax.optimization_barrier(carry * 3 + y * 0) ^ (i + k)
            return carry

        return lax.fori_loop(0, turns, body, x)

    new = retrace(fn, in_parts=True)
    assert len(calls(new, *INPUTS)) > 3
    assert_same(jax.jit(new)(*INPUTS), op_by_op(fn, *INPUTS))


BALLS = "".join(
    f'<body pos="{0.19 * k} 0 0.{9 + k}"><freejoint/><geom size="0.1"/></body>' for k in range(3)
)  # they touch each other and the floor


@pytest.mark.parametrize("option", ['cone="elliptic"', 'integrator="RK4"'], ids=["elliptic", "Runge-Kutta"])
def test_steps_of_lanes_are_the_same(option: str, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    floor = '<geom type="plane" size="1 1 1"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><option {option}/><worldbody>{floor}{BALLS}</worldbody></mujoco>")
    with jax.enable_x64(True):
        stepper = LanesStepper(model, guards=True)
        qpos = np.repeat(model.qpos0[:, None], 6, axis=1)
        qvel = 0.1 * rng.normal(size=(model.nv, 6))

        def steps(q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
            state = lax.fori_loop(0, 5, lambda _, s: stepper.step({}, s, jnp.zeros((model.nu, 6))), stepper.state(q, v))
            return stepper.qpos(state), stepper.qvel(state)

        whole = jax.jit(lambda q, v: steps(q, v), compiler_options=QUICK)(qpos, qvel)
        monkeypatch.setattr(parts, "LONGEST", 300)
        monkeypatch.setattr(parts, "PART", 100)
        in_parts = lambda q, v: steps(q, v)  # noqa: E731 -- a new function, which JAX has not traced
        assert len(calls(in_parts, qpos, qvel)) > 5
        cut = jax.jit(in_parts, compiler_options=QUICK)(qpos, qvel)
    assert np.abs(np.asarray(whole[1]) - qvel).max() > 0.05  # the contacts take part
    for a, b in zip(cut, whole, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)
