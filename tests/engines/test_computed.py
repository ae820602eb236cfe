"""`lanes` follows native MuJoCo or refuses: every member of MuJoCo's enums, and every number of a model."""

import functools

import mujoco
import mujoco.rollout
import numpy as np
import pytest
from lanes_models import CASES
from mujoco_members import ACTUATORS, OTHERS, SAME_MOTION, hopper, members, options, with_value
from mujoco_walk import (
    FOLLOWED,
    MODELS,
    SWITCHES,
    Starts,
    by_lanes,
    compiled,
    difference,
    elements,
    float_fields,
    moved,
    native,
    starts,
)

from btr_mjx import lanes
from btr_mjx.engines import (
    LanesStepper,
    UnsupportedModel,
    computed,
    possible_contacts,
    refusals,
    require_same_structure,
)
from btr_mjx.engines.computed import (
    FLAGS,
    MEMBERS,
    NUMBERS,
    VARYING,
    base_field,
    influences_motion,
    may_differ,
    not_computed,
)


@pytest.fixture(scope="module")
def models() -> dict[str, mujoco.MjModel]:
    return {name: compiled(text) for name, text in MODELS.items()}


@pytest.mark.parametrize("field", [*FLAGS, *MEMBERS])
def test_members_that_are_not_computed_are_refused_by_name(field: str, models: dict[str, mujoco.MjModel]) -> None:
    model = next(m for m in models.values() if base_field(m, field).size)
    odd = {name: value for name, value in members(field).items() if not_computed(field, value)}
    assert "of a later version" in odd
    for name, value in odd.items():
        own = with_value(model, field, value)
        told = [feature for feature in refusals(own) if feature.startswith(field)]
        assert told, name
        assert name in told[0] or name == "of a later version"
        assert name == "of a later version" or lanes.coverage(own).verdict == "refused"


def test_members_that_are_computed_are_compared_with_native_mujoco(models: dict[str, mujoco.MjModel]) -> None:
    """They occur in a model of this file or in a case of the comparison of single steps; shapes have guards instead."""
    compared = [*models.values(), *(mujoco.MjModel.from_xml_string(text) for text in CASES.values())]
    for field in MEMBERS:
        seen = {int(v) for model in compared for v in np.atleast_1d(base_field(model, field))}
        missing = {name for name, v in members(field).items() if v not in seen and not not_computed(field, v)}
        assert missing <= {"mjGEOM_HFIELD", "mjGEOM_MESH", "mjOBJ_JOINT", "mjOBJ_TENDON", *NOT_READ[field]}, field


NOT_READ = dict.fromkeys(MEMBERS, ()) | {
    "opt.solver": ("mjSOL_PGS", "mjSOL_CG"),
    "opt.jacobian": ("mjJAC_DENSE", "mjJAC_SPARSE"),
}
"""Members of options that lead to the same motion, as the next test shows."""


def test_options_that_are_not_read_have_no_effect(rng: np.random.Generator) -> None:
    for text in (SWITCHES, MODELS["contacts"], MODELS["tree"]):
        model = compiled(text)
        begin = starts(model, rng)
        expected = native(model, begin)
        for field, name, value in options():
            if name in SAME_MOTION:
                assert difference(native(with_value(model, field, value), begin), expected).max() < FOLLOWED, name


@pytest.mark.slow
@pytest.mark.parametrize(("field", "name", "value"), [o for o in options() if o[1] not in SAME_MOTION])
def test_options_are_followed(field: str, name: str, value: int, rng: np.random.Generator) -> None:
    model = compiled(SWITCHES)
    begin = starts(model, rng)
    own = with_value(model, field, value)
    expected = native(own, begin)
    if name not in ("PGS", "AUTO", "EULERDAMP"):
        assert difference(native(model, begin), expected).max() > 1e-6
    found, tripped = by_lanes(own, begin)
    assert not tripped.any()
    assert difference(found, expected).max() < (1e-6 if name == "PGS" else FOLLOWED)


@pytest.mark.parametrize("field", NUMBERS)
def test_numbers_that_are_not_computed_are_refused(field: str, models: dict[str, mujoco.MjModel]) -> None:
    model = next(m for m in models.values() if base_field(m, field).size)
    for value in range(8):
        told = [feature for feature in refusals(with_value(model, field, value)) if feature.startswith(field)]
        assert bool(told) == (value not in NUMBERS[field])


@pytest.mark.parametrize("case", [*ACTUATORS, *OTHERS])
def test_what_is_refused_has_native_mujocos_answer(case: str, rng: np.random.Generator) -> None:
    """However many controls an actuator has."""
    own = {"actuator": ACTUATORS[case]} if case in ACTUATORS else {OTHERS[case][0]: OTHERS[case][1]}
    model, plain = mujoco.MjModel.from_xml_string(hopper(**own)), mujoco.MjModel.from_xml_string(hopper())
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    data = mujoco.MjData(model)
    data.qvel[:] = rng.normal(size=model.nv)
    data.qvel[0] = 0.3  # what adheres is pulled off
    start, controls = np.zeros((1, mujoco.mj_stateSize(model, full))), rng.uniform(0.2, 1, (3, 40, model.nu))
    mujoco.mj_getState(model, data, start[0], full)
    assert lanes.coverage(model).verdict == "refused"
    with pytest.raises(UnsupportedModel, match=r"'x'|geom number 0|joint number 0|dof number 0"):
        LanesStepper(model, guards=True)
    found = lanes.rollout(model, start, controls)
    begin, without = (
        Starts(data.qpos[None].copy(), data.qvel[None].copy(), np.zeros((1, m.na)), np.ones((1, m.nu)))
        for m in (model, plain)
    )
    expected = mujoco.rollout.rollout(model, [data], np.repeat(start, 3, 0), controls)[0]
    np.testing.assert_array_equal(found.state, expected)
    moving = slice(0, model.nq + model.nv)
    assert difference(native(model, begin)[:, moving], native(plain, without)[:, moving]).max() > 1e-6


@pytest.mark.skipif(not hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE"), reason="this MuJoCo has no such integrator")
def test_the_discrete_integrator_is_left_to_native() -> None:
    model = mujoco.MjModel.from_xml_string(hopper().replace("<option ", '<option integrator="discrete" '))
    found = lanes.rollout(model, np.zeros((1, 1 + model.nq + model.nv)), steps=3)
    assert "mjINT_DISCRETE" in found.note
    assert list(found.engine) == ["native"]


TOLERANCES = ("opt.tolerance", "opt.ls_tolerance")
"""How exact MuJoCo's solver is; that of `lanes` always is."""
COMPILED = ("geom_rbound", "geom_aabb")
"""Fields that MuJoCo's compiler derives from others, with a size of 0 for what is not bounded."""


def changed(model: mujoco.MjModel, begin: Starts) -> dict[tuple[str, int], np.ndarray]:
    """(field, element) -> states by native MuJoCo with this number moved."""
    fields = [field for field in float_fields(model) if field not in TOLERANCES]
    return {(f, i): native(moved(model, f, i), begin) for f in fields for i in elements(model, f)}


def effective(states: dict[tuple[str, int], np.ndarray], expected: np.ndarray) -> set[tuple[str, int]]:
    """Numbers that change the motion."""
    return {key for key, own in states.items() if not difference(own, expected).max() < FOLLOWED}


@functools.cache
def walked(name: str) -> tuple[mujoco.MjModel, Starts, dict[tuple[str, int], np.ndarray]]:
    """A model, states, and what `changed` finds."""
    model = compiled(MODELS[name])
    begin = starts(model, np.random.default_rng(5))
    return model, begin, changed(model, begin)


def check_refusals(model: mujoco.MjModel, moving: set[tuple[str, int]]) -> None:
    """What changes the motion is computed or refused, in the model and between worlds."""
    for field in float_fields(model):
        own = [element for name, element in moving if name == field]
        known = field in VARYING or field in computed._SAME or field in COMPILED
        assert not own or known or influences_motion(field), field
        for element in [] if known or not influences_motion(field) else elements(model, field):
            assert any(feature.startswith(field) for feature in refusals(moved(model, field, element)))
        assert not own or field in VARYING or field in COMPILED or not may_differ(field, guards_geoms=True), field
        if not may_differ(field, guards_geoms=True):
            with pytest.raises(UnsupportedModel, match=field):
                LanesStepper(model, [field], guards=True)


def test_numbers_of_tendons_are_computed_or_refused(rng: np.random.Generator) -> None:
    """The quick part of the walk through all models."""
    model = compiled(MODELS["tendons"])
    begin = starts(model, rng)
    moving = effective(changed(model, begin), native(model, begin))
    assert {"wrap_prm", "tendon_armature", "dof_dampingpoly", "eq_data"} <= {field for field, _ in moving}
    check_refusals(model, moving)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_every_number_is_followed_or_refused(name: str) -> None:
    model, begin, states = walked(name)
    check_refusals(model, effective(states, native(model, begin)))
    # Each number that may differ between worlds in a world of its own.
    varying = [key for key in states if key[0] in VARYING]
    worlds = [key for key in varying if not restructures(model, key)]
    leaves = {}
    for field in sorted({field for field, _ in worlds}):
        rows = [base_field(moved(model, *key) if key[0] == field else model, field) for key in worlds]
        leaves[field] = np.repeat(np.stack(rows), len(begin.qpos), axis=0)
    many = Starts(*(np.tile(x, (len(worlds), 1)) for x in (begin.qpos, begin.qvel, begin.act, begin.ctrl)))
    found, tripped = by_lanes(model, many, leaves)
    errors = np.where(tripped, 0, difference(found, np.concatenate([states[key] for key in worlds])))
    assert tripped.mean() < 0.2
    wrong = {key: error.max() for key, error in zip(worlds, errors.reshape(len(worlds), -1), strict=True)}
    assert not {key: error for key, error in wrong.items() if not error < FOLLOWED}
    for field, element in set(varying) - set(worlds):
        stepper = LanesStepper(model, [field], guards=True)
        with pytest.raises(UnsupportedModel):
            stepper.pack({field: base_field(moved(model, field, element), field)[None, None]})
    # Those that are equal in all worlds, together.
    own, guarded = model, len(possible_contacts(model).guarded)
    for field, element in [key for key in states if key[0] in computed._SAME]:
        further = moved(own, field, element)
        left = [*refusals(further, size=False)] or len(possible_contacts(further).guarded) > guarded
        own = own if left else further
    found, tripped = by_lanes(own, begin)
    assert not tripped.all()
    assert difference(found, native(own, begin))[~tripped].max() < FOLLOWED


def restructures(model: mujoco.MjModel, key: tuple[str, int]) -> bool:
    """Whether a world in which a number is moved is refused."""
    try:
        require_same_structure(model, {key[0]: base_field(moved(model, *key), key[0])[None]})
    except UnsupportedModel:
        return True
    return False


@pytest.mark.slow
def test_every_number_that_is_computed_changes_the_motion_of_a_model_of_the_walk() -> None:
    tried, numbers = set(), set()
    for model, begin, states in map(walked, MODELS):
        tried |= {field for field, _ in effective(states, native(model, begin))}
        numbers |= set(float_fields(model))
    assert numbers & (VARYING | computed._SAME) - tried == {"geom_gap", "pair_gap", "pair_adhesion"}


def test_fields_that_the_tables_do_not_know_are_refused(
    models: dict[str, mujoco.MjModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As those of a later MuJoCo."""
    model = models["tendons"]
    assert not [*refusals(model)]
    monkeypatch.setattr(computed, "_SAME", computed._SAME - {"tendon_stiffness"})
    computed._plain_rows.cache_clear()
    try:
        assert [feature for feature in refusals(model) if "tendon_stiffness" in feature and "'pull'" in feature]
    finally:
        computed._plain_rows.cache_clear()
