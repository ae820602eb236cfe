"""The library of effects: places, nulls, groups, native edits against the compiler, user-defined effects."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gap_models import MODELS, inertia, load, moderate, one, windows
from installed_packages import install

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import (
    EFFECTS,
    KNOWN_EFFECTS,
    Effect,
    Hypothesis,
    Parameter,
    Scales,
    candidates,
    custom_effect_code,
    joint_places,
    selected_effects,
)
from btr_mjx.gap.effects.joints import ARMATURE
from btr_mjx.gap.results.mended_model import FoundEffect, resolve_effect
from btr_mjx.gap.results.transcribe import normalised, write_changes
from btr_mjx.gap.simulate import Rows, World, differing_fields, simulate
from btr_mjx.models import PathParameter


@pytest.mark.parametrize("name", MODELS)
def test_native_edits_equal_compiled_models(name: str) -> None:
    base = normalised(MODELS[name]).compile()
    original = load(name)
    assert _close(base, original)
    seen = set()
    for candidate in candidates(base, Scales.of(base), KNOWN_EFFECTS):
        if name == "hexapod" and (candidate.effect.name, len(candidate.place.members)) in seen:
            continue  # one place of a kind: each is compiled
        seen.add((candidate.effect.name, len(candidate.place.members)))
        world = candidate.apply(World.of(base), moderate(candidate))
        spec = normalised(MODELS[name])
        assert write_changes(spec, world, base) == [], candidate.name
        compiled = mujoco.MjModel.from_xml_string(_saved(spec))
        for field, ours in differing_fields(World.of(compiled), world.model).items():
            if field.endswith("sameframe"):
                continue
            theirs = np.asarray(
                getattr(world.model, field) if "." not in field else getattr(world.model.opt, field[4:])
            )
            if field in ("body_inertia", "body_iquat"):
                continue  # the principal axes may come in another order
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-7, err_msg=f"{candidate.name}: {field}")
        for body in range(base.nbody):
            np.testing.assert_allclose(
                inertia(compiled, body), inertia(world.model, body), rtol=1e-4, atol=1e-7, err_msg=candidate.name
            )


def _saved(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return spec.to_xml()


def _close(a: mujoco.MjModel, b: mujoco.MjModel) -> bool:
    return all(
        np.allclose(value, getattr(b, field), rtol=1e-5, atol=1e-8)
        for field, value in differing_fields(World.of(a), b).items()
        if field != "body_simple"  # a short cut of MuJoCo that edited bodies do without
    )


def test_every_effect_is_documented_and_has_a_place_on_a_walking_robot() -> None:
    table = (Path(__file__).parents[3] / "docs" / "effects.md").read_text(encoding="utf-8")
    assert [effect.name for effect in KNOWN_EFFECTS if f"| `{effect.name}` |" not in table] == []
    assert all(effect.equation and effect.excited_by and effect.apply.__doc__ for effect in KNOWN_EFFECTS)
    model, mounted = load("quadruped"), load("pendulum")
    found = {c.effect.name for c in candidates(model, Scales.of(model), KNOWN_EFFECTS)}
    assert {effect.name for effect in KNOWN_EFFECTS} - found == {"gravity_compensation"}
    assert "gravity_compensation" in {c.effect.name for c in candidates(mounted, Scales.of(mounted), EFFECTS)}
    assert len(found) >= 19


def test_places_of_a_robot() -> None:
    model = load("quadruped")
    labels: dict[str, list[str]] = {}
    for candidate in candidates(model, Scales.of(model), KNOWN_EFFECTS):
        labels.setdefault(candidate.effect.name, []).append(candidate.place.label)
    legs = ["subtree:thigh0", "subtree:thigh1"]
    each = ["each:subtree:thigh0", "each:subtree:thigh1", "each:all"]
    singles = ["joint:hip0", "joint:knee0", "joint:hip1", "joint:knee1"]
    assert labels["viscous_damping"] == [*singles, *legs, "all", *each]
    assert labels["actuator_delay"] == [f"actuator:{n}" for n in ("hip0", "knee0", "hip1", "knee1")] + [*legs, "all"]
    backlash = ["joint:hip0", "joint:knee0", "joint:knee1", "subtree:thigh0", "all"]
    assert labels["backlash"] == [*backlash, "each:subtree:thigh0", "each:all"]
    assert labels["payload"] == [f"body:{n}" for n in ("torso", "head", "thigh0", "shank0", "thigh1", "shank1")]
    assert labels["link_length"] == [f"body:{n}" for n in ("thigh0", "shank0", "thigh1", "shank1")]
    assert labels["constant_force"] == [f"body:{n}" for n in ("torso", "shank0", "shank1")]
    assert {"geom:foot0", "geom:foot1", "world"} <= set(labels["ground_friction"])
    assert labels["elastic_cord"] == ["body:torso"]
    pendulum = load("pendulum")
    names = {c.name for c in candidates(pendulum, Scales.of(pendulum), EFFECTS)}
    assert not {n for n in names if n.startswith(("ground_friction", "contact_softness", "com_shift"))}
    assert {"load_friction@joint:servo", "ground_slope@world", "link_length@body:arm", "payload@body:arm"} <= names
    assert not {n for n in names if n.endswith("@all")}


def test_groups_are_of_driven_joints() -> None:
    """A boom has no gears or rotors like those of the leg that it carries."""
    boom = Path(__file__).parents[3] / "benchmarks/league_robots/hopper/robot.xml"
    places = {place.label: place for place in joint_places(mujoco.MjModel.from_xml_path(str(boom)))}
    assert set(places) == {"joint:x", "joint:z", "joint:pitch", "joint:hip", "joint:knee", "all"}
    assert places["all"].members == ("joint:hip", "joint:knee")
    loose = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="a"/><geom size="1"/>
        <body><joint name="b"/><geom size="1"/></body></body></worldbody></mujoco>"""
    )
    assert joint_places(loose)[-1].members == ("joint:a", "joint:b")


def test_null_values_change_nothing() -> None:
    for name in MODELS:
        model = load(name)
        for candidate in candidates(model, Scales.of(model), KNOWN_EFFECTS):
            world = candidate.apply(World.of(model), candidate.null)
            allowed = (
                {"actuator_forcerange", "actuator_forcelimited"} if candidate.effect.name == "torque_limit" else set()
            )
            for field, values in differing_fields(world, model).items():
                if field in allowed | {"geom_priority", "geom_solref", "geom_solimp", "geom_friction", "geom_condim"}:
                    continue
                if field.endswith("sameframe") or field in ("body_iquat", "body_inertia"):
                    continue
                np.testing.assert_allclose(values, getattr(model, field), rtol=1e-7, atol=1e-9, err_msg=candidate.name)
            for body in range(model.nbody):
                np.testing.assert_allclose(inertia(world.model, body), inertia(model, body), rtol=1e-5, atol=1e-9)


def test_group_edit_equals_edits_of_members() -> None:
    model = load("quadruped")
    every = {c.name: c for c in candidates(model, Scales.of(model), KNOWN_EFFECTS)}
    for candidate in every.values():
        if not candidate.place.members:
            continue
        assert candidate.effect.summable or candidate.effect.saturates
        values = moderate(candidate)
        if candidate.place.parts:
            values *= np.linspace(0.2, 1.0, len(values))
        together = candidate.apply(World.of(model), values)
        one_by_one = World.of(model)
        for i, member in enumerate(candidate.place.members):
            own = values[i : i + 1] if candidate.place.parts else values
            every[f"{candidate.effect.name}@{member}"].apply(one_by_one, own)
        assert set(differing_fields(together, model)) == set(differing_fields(one_by_one, model))
        for field, values in differing_fields(together, model).items():
            np.testing.assert_allclose(values, getattr(one_by_one.model, field), err_msg=candidate.name)
        stretch = windows(model, count=2)
        a, b = simulate([(together, stretch), (one_by_one, stretch)])
        # A curved command behind a rate limit is taken as a chain of straight parts, which depend on where it is cut.
        tolerance = 3e-3 if candidate.effect.name == "command_rate_limit" else 1e-9
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=candidate.name)


@pytest.mark.parametrize("name", MODELS)
def test_a_world_that_goes_on_from_another_is_that_of_all_effects(name: str) -> None:
    """With one more effect than a hypothesis that has its world already, and without; the first world stays."""
    model, segments = load(name), windows(load(name), count=2)
    first, *others = candidates(model, Scales.of(model), KNOWN_EFFECTS)
    shorter = Hypothesis((), ()).with_effect(first, moderate(first))
    (before,) = simulate([(shorter(model), segments)])
    for candidate in {(c.effect.name, bool(c.place.members)): c for c in others}.values():
        longer = shorter.with_effect(candidate, moderate(candidate))
        anew = Hypothesis((), (), longer.effects)
        assert differing_fields(longer(model), anew(model).update_constants()) == {}, candidate.name
        after = simulate([(longer(model), segments), (anew(model), segments), (shorter(model), segments)])
        np.testing.assert_array_equal(after[0], after[1], candidate.name)
        np.testing.assert_array_equal(after[2], before, candidate.name)


def test_a_changed_hypothesis_does_not_go_on_from_the_world_of_other_numbers() -> None:
    model = load("pendulum")
    believed = PathParameter("damping", (f"joint:{model.joint(0).name}/damping",), 0.0, 1.0)
    first, second, *_ = candidates(model, Scales.of(model), KNOWN_EFFECTS)
    shorter = Hypothesis((believed,), (0.1,)).with_effect(first, moderate(first))
    shorter(model)
    longer = shorter.with_effect(second, moderate(second))
    for changed in (
        replace(longer, believed=(0.2,)),
        replace(longer, effects=((second, tuple(second.null)), *longer.effects[1:])),
        longer.replaced(longer.values(True) / 2, True),
    ):
        anew = Hypothesis(changed.parameters, changed.believed, changed.effects)
        assert differing_fields(changed(model), anew(model).update_constants()) == {}


def test_scales_of_measured_states() -> None:
    model = load("quadruped")
    data, rows = mujoco.MjData(model), []
    for k in range(600):
        data.ctrl[:] = 0.3 * np.sin(0.012 * k + np.arange(4))
        mujoco.mj_step(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), np.abs(data.actuator_force).copy()))
    qpos, qvel, ctrl, force = (np.array(column) for column in zip(*rows, strict=True))
    scales = Scales.measured(model, qpos, qvel, ctrl)
    np.testing.assert_allclose(scales.force, np.percentile(force, 99.5, axis=0), rtol=0.3)
    np.testing.assert_allclose(scales.torque[8], 5 * scales.force[2])
    assert 0.02 < scales.time < 0.5
    floor, feet = model.geom("floor").id, [model.geom(n).id for n in ("foot0", "foot1")]
    assert scales.touching[feet].all()
    assert not scales.touching[floor]


class Gust:
    fields = ()

    def __init__(self, dofs: np.ndarray, size: float) -> None:
        self.dofs, self.size = dofs, size

    def __call__(self, rows: Rows) -> None:
        rows.qfrc_applied[:, self.dofs] -= self.size * (rows.qvel * np.abs(rows.qvel))[:, self.dofs]


def test_armature_range_exceeds_light_link() -> None:
    model = load("quadruped")
    place, scales = one(model, "armature@joint:knee0").place, Scales.of(model)
    dof = place.dofs(model)[0]

    def most(torque: float) -> float:
        given = replace(scales, torque=np.full(model.nv, torque))
        (parameter,) = ARMATURE.parameters(model, given, place)
        assert parameter.step == pytest.approx(0.05 * scales.inertia[dof])
        return parameter.high

    acceleration = scales.speed[dof] ** 2 / scales.amplitude[dof]
    assert most(0.0) == pytest.approx(5 * scales.inertia[dof])
    assert most(100.0) == pytest.approx(3 * 100.0 / acceleration)


def test_values_at_search_bounds() -> None:
    friction, gain = Parameter("torque", "N m", -0.1, 0.8, 0.02, floor=True), Parameter("change", "1", -0.9, 9.0, -0.03)
    assert [friction.at_edge(value) for value in (-0.1, 0.0, 0.79, 0.8)] == [False, False, False, True]
    offset, limit = Parameter("offset", "rad", -0.3, 0.3, 0.005), Parameter("limit", "N m", 1.0, 9.0, -0.1, null=9.0)
    assert [offset.at_edge(value) for value in (-0.3, 0.0, 0.3)] == [True, False, True]
    assert [limit.at_edge(value) for value in (1.0, 5.0, 9.0)] == [True, False, False]
    assert [gain.at_edge(value) for value in (-0.9, 0.0, 9.0)] == [True, False, True]
    assert not Parameter("along", "m", 0.0, 0.2, 0.01, shape=True).at_edge(0.2)


def test_user_defined_effect() -> None:
    def ranges(model: mujoco.MjModel, scales: Scales, place: object) -> tuple[Parameter, ...]:
        return (Parameter("coefficient", "N m s^2", 0.0, 1.0, 0.01),)

    def edit(world: World, place, values: np.ndarray) -> None:
        world.model.dof_dampingpoly[place.dofs(world.model), 0] += values[0]

    def by_law(world: World, place, values: np.ndarray) -> None:
        world.laws.append(Gust(place.dofs(world.model), values[0]))

    native = Effect("quadratic_damping", joint_places, ranges, edit, summable=True)
    law = Effect("gust", joint_places, ranges, by_law, summable=True)
    model = load("quadruped")
    stretch = windows(model)
    effects = (*EFFECTS, native, law)
    worlds = [one(model, f"{n}@all", effects).apply(World.of(model), [0.001]) for n in ("quadratic_damping", "gust")]
    a, b, plain = simulate([*((world, stretch) for world in worlds), (World.of(model), stretch)], timestep=1e-4)
    assert np.abs(a - plain).max() > 1e-3
    np.testing.assert_allclose(a, b, atol=0.05 * np.abs(a - plain).max())
    with pytest.raises(InputError, match="same name"):
        candidates(model, Scales.of(model), (native, native))
    with pytest.raises(InputError, match="values"):
        one(model, "gust@all", effects).apply(World.of(model), [0.1, 0.2])
    with pytest.raises(InputError, match="null"):
        Parameter("coefficient", "1", 1.0, 2.0, 0.1)


def test_effects_of_a_file_are_selected_by_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from btr_mjx.gap.effects import Effect, Parameter, joint_places\n"
        "def ranges(model, scales, place):\n"
        "    return (Parameter('coefficient', 'N m s^2/rad^2', 0.0, 3.0, 0.05),)\n"
        "def edit(world, place, values):\n"
        "    world.model.dof_dampingpoly[place.dofs(world.model), 0] += values[0]\n"
        "MINE = Effect('quadratic_damping', joint_places, ranges, edit, summable=True)\n"
        "NUMBER = 3\n"
    )
    library = selected_effects(["all", f"{file}:MINE"])
    assert [e.name for e in library] == [*(e.name for e in EFFECTS), "quadratic_damping"]
    assert [e.name for e in selected_effects(["backlash", f"{file}:MINE"])] == [
        "backlash",
        "quadratic_damping",
    ]
    with pytest.raises(InputError, match=r"NUMBER.*: got int, expected an Effect"):
        selected_effects([f"{file}:NUMBER"])


def test_effects_of_installed_packages_are_selected_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import dataclasses, btr_mjx.gap.effects as e\nmine = dataclasses.replace(e.EFFECTS[0], name={})"
    with pytest.raises(InputError, match="'own' is not in the library"):
        selected_effects(("own",))
    before = custom_effect_code(("all",))
    install(tmp_path / "a", monkeypatch, "own_effects", code.format("'own'"), "btr_mjx.effects", "a = own_effects:mine")
    assert [effect.name for effect in selected_effects(("all", "own"))] == [*(e.name for e in EFFECTS), "own"]
    assert custom_effect_code(("all",)) != before
    model = load("pendulum")
    candidate = candidates(model, Scales.of(model), selected_effects(("own",)))[0]
    values = dict(zip([p.name for p in candidate.parameters], moderate(candidate), strict=True))
    found = FoundEffect("own", candidate.place.label, values)
    assert resolve_effect(model, found, EFFECTS)[0].name == "own"  # as a mended model is read again
    twice = code.format("e.EFFECTS[1].name")
    install(tmp_path / "b", monkeypatch, "twice", twice, "btr_mjx.effects", "b = twice:mine")
    with pytest.raises(InputError, match="is there already; give it another name"):
        selected_effects(("all",))
