"""`mjx` follows native MuJoCo or refuses, as `lanes` does: members of enums, numbers of a model, and of worlds."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from lanes_models import QUICK
from mujoco_members import ACTUATORS, OTHERS, hopper, members, options, with_value
from mujoco_walk import (
    FOLLOWED,
    MODELS,
    STEPS,
    SWITCHES,
    Starts,
    compiled,
    difference,
    elements,
    float_fields,
    moved,
    native,
    starts,
)

from btr_mjx.engines import MjxStepper, UnsupportedModel
from btr_mjx.engines.computed import MEMBERS, VARYING, base_field, not_plain

MUSCLES = {"mjDYN_MUSCLE", "mjGAIN_MUSCLE", "mjBIAS_MUSCLE"}
COMPUTED_BY_MJX = {
    "opt.solver": {"mjSOL_CG", "mjSOL_NEWTON"},
    "actuator_trntype": {"mjTRN_JOINT", "mjTRN_JOINTINPARENT", "mjTRN_SITE", "mjTRN_TENDON"},
}
"""Members that differ from those of `lanes`."""


FOLLOWED_BY_MJX = ("ELLIPTIC", "RK4", "IMPLICITFAST", "CONSTRAINT", "DAMPER", "EULERDAMP", "FILTERPARENT")
"""Options that are compared with native MuJoCo."""


def by_mjx(model: mujoco.MjModel, begin: Starts, leaves: dict[str, np.ndarray] | None = None) -> np.ndarray:
    """States (rows, nq + nv) after some steps; leaves are (rows, *field shape)."""
    with jax.enable_x64(True):
        stepper = MjxStepper(model, frozenset(leaves or {}))
        packed = stepper.pack({name: values[None] for name, values in (leaves or {}).items()})
        params = {name: jnp.asarray(values[0]) for name, values in packed.items()}
        step = jax.jit(lambda *args: stepper.step(*args), compiler_options=QUICK)
        state = stepper.state(begin.qpos.T, begin.qvel.T, begin.act.T)
        for k in range(STEPS):
            state = step(params, state, jnp.asarray(begin.ctrl.T * (1 - 0.5 * k)))
        return np.concatenate([np.asarray(stepper.qpos(state)), np.asarray(stepper.qvel(state))]).T


@pytest.mark.parametrize("field", ["opt.integrator", "opt.enableflags", "opt.disableflags", "opt.solver"])
def test_options_that_mjx_does_not_compute_are_refused(field: str) -> None:
    model = compiled(SWITCHES)
    computed = {name for own, name, _ in options() if own == field}
    for name, value in members(field).items():
        short = name.partition("_")[2]
        mine = name in COMPUTED_BY_MJX[field] if field in COMPUTED_BY_MJX else short in computed
        if (mine and short not in ("ENERGY", "FWDINV")) or value == int(base_field(model, field)):
            MjxStepper(with_value(model, field, value), frozenset())
        elif name != "of a later version" or field != "opt.solver":
            with pytest.raises(UnsupportedModel):
                MjxStepper(with_value(model, field, value), frozenset())


@pytest.mark.parametrize("field", ["actuator_dyntype", "actuator_gaintype", "actuator_biastype", "actuator_trntype"])
def test_kinds_of_actuators_that_mjx_does_not_compute_are_refused(field: str) -> None:
    model = compiled(SWITCHES)
    words = {f"{name.split('_')[0]}" for name in members(field) if "_" in name}
    known = COMPUTED_BY_MJX.get(field, {f"{w}_{m}" for w in words for m in MEMBERS[field][1].split()} | MUSCLES)
    for name, value in members(field).items():
        if name not in known and name != "of a later version":
            with pytest.raises(UnsupportedModel):
                MjxStepper(with_value(model, field, value), frozenset())


@pytest.mark.parametrize("case", [*ACTUATORS, *OTHERS])
def test_what_mjx_would_ignore_is_refused_by_name(case: str) -> None:
    own = {"actuator": ACTUATORS[case]} if case in ACTUATORS else {OTHERS[case][0]: OTHERS[case][1]}
    model = mujoco.MjModel.from_xml_string(hopper(**own))
    if case in ("site", "muscle"):  # MJX has them
        MjxStepper(model, frozenset())
        return
    with pytest.raises(UnsupportedModel, match=r"'x'|geom number 0|joint number 0|dof number 0|mjTRN"):
        MjxStepper(model, frozenset())


def test_numbers_that_no_table_knows_are_refused() -> None:
    model = compiled(MODELS["tendons"])
    for field in float_fields(model):
        for element in elements(model, field):
            own = moved(model, field, element)
            if field in {name for name, _ in not_plain(own)} - {"tendon_armature"}:
                with pytest.raises(UnsupportedModel, match=field):
                    MjxStepper(own, frozenset())


def test_worlds_may_not_differ_in_what_is_compiled_in() -> None:
    model = compiled(SWITCHES)
    for field in ("wrap_prm", "opt.noslip_iterations", "geom_adhesion", "geom_fluid", "actuator_delay"):
        with pytest.raises(UnsupportedModel, match=field):
            MjxStepper(model, frozenset({field}))
    for field, value in (("dof_frictionloss", 0.5), ("opt.density", 3.0)):
        stepper = MjxStepper(model, frozenset({field}))
        values = np.stack([base_field(model, field), np.full_like(base_field(model, field), value)])
        with pytest.raises(UnsupportedModel, match="some of the worlds"):
            stepper.pack({field: values[None]})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "name", "value"), [o for o in options() if o[1] in ("ELLIPTIC", "RK4", "IMPLICITFAST")]
)
def test_options_are_followed_by_mjx(field: str, name: str, value: int, rng: np.random.Generator) -> None:
    model = with_value(compiled(SWITCHES), field, value)
    begin = starts(model, rng)
    assert difference(by_mjx(model, begin), native(model, begin)).max() < 1e-7


@pytest.mark.slow
def test_every_number_in_which_worlds_may_differ_is_followed_by_mjx(rng: np.random.Generator) -> None:
    model = compiled(SWITCHES)
    begin = starts(model, rng)
    worlds = []
    for field in [name for name in float_fields(model) if name in VARYING]:
        for element in elements(model, field):
            if field == "body_quat" and not element:
                continue  # that of the world, which is the identity in every model
            values = base_field(moved(model, field, element), field)
            try:
                MjxStepper(model, frozenset({field})).pack({field: values[None, None]})
            except UnsupportedModel:
                continue
            worlds.append((field, element))
    leaves = {
        field: np.repeat(
            np.stack([base_field(moved(model, *key) if key[0] == field else model, field) for key in worlds]),
            len(begin.qpos),
            axis=0,
        )
        for field in sorted({field for field, _ in worlds})
    }
    many = Starts(*(np.tile(x, (len(worlds), 1)) for x in (begin.qpos, begin.qvel, begin.act, begin.ctrl)))
    errors = difference(by_mjx(model, many, leaves), np.concatenate([native(moved(model, *k), begin) for k in worlds]))
    wrong = {key: error.max() for key, error in zip(worlds, errors.reshape(len(worlds), -1), strict=True)}
    assert {"body_mass", "geom_friction", "jnt_range", "eq_data", "actuator_gear"} <= {field for field, _ in worlds}
    assert not {key: error for key, error in wrong.items() if not error < 100 * FOLLOWED}
