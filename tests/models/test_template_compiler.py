"""The vectorised template compiler against MuJoCo's compiler, leaf by leaf."""

import dataclasses
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from btr_mjx.models import batch as models
from btr_mjx.models import compiler_rules, geom_compiler, read_field, symbolic, template_compiler
from btr_mjx.models.fields import field_names
from btr_mjx.robots import Box, Robot

ARM = """
<mujoco>
  <compiler {compiler}/>
  <option timestep="0.001" gravity="0 0 {{{{ -g }}}}"/>
  <default>
    <geom density="{{{{ rho }}}}" friction="{{{{ mu }}}} 0.01 0.001"/>
    <joint damping="{{{{ d }}}}"/>
    <default class="stiff"><joint stiffness="{{{{ 3 * d }}}}" range="-40 {{{{ 10 + 30 * r }}}}"/></default>
    <position kp="{{{{ 100 * k }}}}" {damping}/>
  </default>
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    <body name="base" pos="0 0 {{{{ 1 + a }}}}">
      {base}
      <body name="link" pos="{{{{ a }}}} 0 {{{{ -b / 2 }}}}">
        <joint name="hinge" axis="0 1 0" {joint}/>
        {link}
        <site name="tip" pos="0 0 {{{{ -a * b }}}}" size="0.01"/>
        <body pos="0 {{{{ max(a, b) }}}} {{{{ -min(0.5, b) }}}}">
          <joint type="slide" axis="1 0 0" class="stiff"/>
          <geom type="sphere" size="{{{{ sqrt(r * r + 0.01) }}}}" pos="0 {{{{ a * sin(b) }}}} {{{{ cos(a) }}}}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="hinge"/></actuator>
</mujoco>
"""

NAMES = ("a", "b", "r", "rho", "mu", "d", "k", "g")


def arm(
    base: str = '<freejoint/><geom type="box" size="0.1 0.2 0.3"/>',
    link: str = '<geom type="capsule" size="{{ r }}" fromto="0 0 0 {{ a }} 0 {{ -b }}"/>',
    compiler: str = 'angle="degree"',
    joint: str = "",
    damping: str = 'kv="{{ k }}"',
) -> Robot:
    """A small robot whose parts a test chooses; a, b [m] lengths, r [m] a radius, rho a density, ..."""
    low, high = [0.1, 0.3, 0.02, 100, 0.2, 0.1, 0.5, 5], [0.6, 0.9, 0.1, 2000, 1.5, 2, 4, 12]
    return Robot(
        name="arm",
        template=ARM.format(base=base, link=link, compiler=compiler, joint=joint, damping=damping),
        template_path="arm.xml.j2",
        simulation_box=Box(NAMES, low, high),
        controller_box=Box(["u"], 0.0, 1.0),
        signal=lambda c, t, xp: c,
        nominal=tuple((np.array(low) + high) / 2),
    )


def simulations(robot: Robot, count: int) -> np.ndarray:
    """Random simulations and random corners of the box."""
    box, rng = robot.simulation_box, np.random.default_rng(3)
    corners = np.where(rng.random((count // 4, box.n)) < 0.5, box.low, box.high)
    return np.concatenate([box.sample(rng, count - len(corners) - 2), corners, [box.low, box.high]])


def compiler_of(robot: Robot) -> template_compiler.TemplateCompiler:
    return template_compiler.build_template_compiler(robot, models.base_model(robot), models.varying_fields(robot))


def assert_equal_to_compiled(robot: Robot, rows: np.ndarray, tolerance: float = 0.0) -> None:
    """Every leaf against the compiled model of the rendered MJCF; tolerance relative to a field's largest element."""
    leaves, done = compiler_of(robot).prepare(rows)
    assert done.all()
    for i, s in enumerate(rows):
        alone = mujoco.MjModel.from_xml_string(robot.render(s))
        base = models.base_model(robot)
        rebuilt = not np.array_equal(alone.bvh_nodeid, base.bvh_nodeid)
        for name, leaf in leaves.items():
            if rebuilt and name.startswith("bvh_"):
                continue  # another way to gather a body's geoms, as right as the base model's
            expected = read_field(alone, name)
            bound = tolerance * np.abs(expected).max(initial=0)
            np.testing.assert_allclose(leaf[i], expected, rtol=0, atol=bound, err_msg=name)


def test_hexapod_equals_the_compiler_to_the_bit(robot: Robot) -> None:
    assert models.why_compiled(robot) == ""
    assert_equal_to_compiled(robot, simulations(robot, 240))


SHAPES = {
    "capsule": '<geom type="capsule" size="{{ r }} {{ b }}" pos="{{ a }} 0 0"/>',
    "capsule between ends": '<geom type="capsule" size="{{ r }}" fromto="{{ -a }} 0.1 0 {{ a }} {{ b }} {{ -b }}"/>',
    "upright capsule": '<geom type="capsule" size="{{ r }}" fromto="0 0 {{ a }} 0 0 {{ -b }}"/>',
    "hanging capsule": '<geom type="capsule" size="{{ r }}" fromto="0 0 {{ -a }} 0 0 {{ b }}"/>',
    "sphere": '<geom type="sphere" size="{{ r }}" pos="0 {{ b }} 0"/>',
    "cylinder": '<geom type="cylinder" size="{{ r }} {{ a }}"/>',
    "cylinder between ends": '<geom type="cylinder" size="{{ 2 * r }}" fromto="0 0 0 {{ a }} {{ b }} 0"/>',
    "box": '<geom type="box" size="{{ r }} {{ a }} {{ b }}" euler="10 20 30"/>',
    "box between ends": '<geom type="box" size="{{ r }}" fromto="0 0 0 {{ a }} {{ b }} 0.1"/>',
    "ellipsoid": '<geom type="ellipsoid" size="{{ r }} {{ a }} {{ b }}"/>',
    "ellipsoid between ends": '<geom type="ellipsoid" size="{{ r }}" fromto="0 0 0 {{ a }} {{ b }} 0.1"/>',
    "given mass": '<geom type="capsule" size="{{ r }}" fromto="0 0 0 {{ a }} 0 0" mass="{{ k / 2 }}"/>',
    "massless": '<geom type="box" size="{{ r }} {{ r }} 0.1"/><geom mass="0" size="{{ b }}"/>',
    "given inertia": '<inertial pos="0 0 {{ a }}" mass="{{ k }}" diaginertia="{{ r }} {{ r }} {{ r }}"/>',
}


@pytest.mark.parametrize("link", SHAPES.values(), ids=SHAPES.keys())
def test_shapes_equal_the_compiler_to_the_bit(link: str) -> None:
    robot = arm(link=link)
    assert_equal_to_compiled(robot, simulations(robot, 40))


SEVERAL = {
    "two capsules": '<geom type="capsule" size="{{ r }}" fromto="0 0 0 {{ a }} 0 {{ b }}"/>'
    '<geom type="capsule" size="0.05" fromto="0 0 0 0 {{ b }} {{ a }}"/>',
    "box and ellipsoid": '<geom type="box" size="{{ r }} {{ a }} {{ b }}" euler="10 20 30" pos="{{ a }} 0 0.1"/>'
    '<geom type="ellipsoid" size="{{ a }} {{ r }} {{ r }}" pos="0 {{ b }} 0" quat="1 2 3 4"/>',
    "three, one of them constant": '<geom type="cylinder" size="0.1 0.2" pos="0.3 0 0"/><geom size="{{ r }}"/>'
    '<geom type="box" size="0.1 0.1 {{ b }}" mass="{{ k }}" pos="0 0 -0.3"/>',
    "symmetric": '<geom size="{{ r }}" pos="{{ a }} 0 0"/><geom size="{{ r }}" pos="{{ -a }} 0 0"/>',
}


@pytest.mark.parametrize("link", SEVERAL.values(), ids=SEVERAL.keys())
def test_bodies_of_several_geoms_equal_the_compiler(link: str) -> None:
    """The principal axes follow from an iteration: its order and signs are MuJoCo's."""
    robot = arm(link=link)
    assert_equal_to_compiled(robot, simulations(robot, 60), 2e-14)


def test_bounding_volumes_hold_their_geoms() -> None:
    """Where the compiler would gather a body's geoms in another order, the base model's order is kept."""
    robot = arm(link=SEVERAL["box and ellipsoid"])
    batch = models.compile_models(robot, simulations(robot, 40))
    for i in range(len(batch)):
        model = batch.row(i)
        for body in range(1, model.nbody):
            first, count = model.body_bvhadr[body], model.body_bvhnum[body]
            boxes = model.bvh_aabb[first : first + count]
            low, high = boxes[:, :3] - boxes[:, 3:], boxes[:, :3] + boxes[:, 3:]
            assert np.all(low >= low[0] - 1e-9)
            assert np.all(high <= high[0] + 1e-9)
            geoms = model.body_geomadr[body] + np.arange(model.body_geomnum[body])
            assert sorted(x for x in model.bvh_nodeid[first : first + count] if x >= 0) == geoms.tolist()


def test_parameters_reach_every_kind_of_attribute() -> None:
    """Defaults, classes, degrees, shortcuts of actuators, options: whatever is a copy of a number."""
    robot = arm()
    leaves, _ = compiler_of(robot).prepare(robot.nominal_simulation[None])
    assert {
        "geom_friction", "dof_damping", "jnt_stiffness", "jnt_range", "actuator_gainprm", "actuator_biasprm",
        "opt.gravity", "site_pos", "body_mass", "geom_rbound", "qpos0", "stat.extent",
    } <= set(leaves)  # fmt: skip
    assert_equal_to_compiled(robot, simulations(robot, 40))


FALLBACKS = {
    "decision": dict(link='{% if a > 0.3 %}<geom size="0.1"/>{% else %}<geom size="0.2"/>{% endif %}'),
    "comparison": dict(link='<geom size="{{ r if r < b else b }}"/>'),
    "rounding": dict(link='<geom size="{{ r | round(3) }}"/>'),
    "conversion": dict(link='<geom size="{{ r | float }}"/>'),
    "formatting": dict(link="<geom size=\"{{ '%.6f' | format(r) }}\"/>"),
    "text": dict(link='<geom size="{{ r }}e-1"/>'),
    "angle": dict(link='<geom type="box" size="0.1 0.2 0.3" euler="{{ 90 * a }} 0 0"/>'),
    "full inertia": dict(link='<inertial pos="0 0 0" mass="1" fullinertia="{{ b }} {{ b }} {{ b }} {{ r }} 0 0"/>'),
    "frame": dict(
        link='<frame pos="{{ a }} 0 0" euler="0 30 0"><geom type="box" size="{{ r }} 1 1" pos="0 0 {{ b }}"/></frame>'
    ),
    "compiler option": dict(compiler='boundmass="1"', link='<geom type="box" size="0.1 0.1 {{ a }}"/>'),
    "shell": dict(link='<geom type="box" size="0.1 0.2 {{ a }}" shellinertia="true"/>'),
    "damping ratio": {"damping": 'dampratio="{{ r }}"'},
}


@pytest.mark.parametrize("parts", FALLBACKS.values(), ids=FALLBACKS.keys())
def test_what_is_not_understood_is_compiled(parts: dict[str, str]) -> None:
    robot = arm(**parts)
    rows = simulations(robot, 12)
    assert models.why_compiled(robot)
    batch = models.compile_models(robot, rows)
    for i, s in enumerate(rows):
        alone = mujoco.MjModel.from_xml_string(robot.render(s))
        for name, leaf in batch.leaves.items():
            np.testing.assert_array_equal(leaf[i], read_field(alone, name), err_msg=name)


def test_mesh_scale_is_compiled() -> None:
    mesh = '<asset><mesh name="m" scale="1 1 {{ b }}" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><worldbody>'
    plain = arm(link='<geom type="mesh" mesh="m"/>')
    robot = dataclasses.replace(plain, template=plain.template.replace("<worldbody>", mesh))
    assert models.why_compiled(robot)
    alone = mujoco.MjModel.from_xml_string(robot.render(robot.simulation_box.high))
    assert models.compile_models(robot, robot.simulation_box.high).leaves["body_mass"][0, 2] == alone.body_mass[2]


def test_reasons_are_told() -> None:
    assert "decision" in models.why_compiled(arm(**FALLBACKS["decision"]))
    assert "boundmass" in models.why_compiled(arm(**FALLBACKS["compiler option"]))
    assert "shell" in models.why_compiled(arm(**FALLBACKS["shell"]))


@pytest.mark.parametrize("name", ["geom_inertia", "volume", "frame_between"])
def test_a_wrong_rule_is_refused(name: str, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    right = getattr(compiler_rules, name)

    def wrong(*args: object) -> object:
        result = right(*args)
        return tuple(x * (1 + 1e-9) for x in result) if isinstance(result, tuple) else result * (1 + 1e-9)

    monkeypatch.setattr(compiler_rules, name, wrong)
    with pytest.raises(geom_compiler.NotVectorisable, match="not what the compiler makes"):
        compiler_of(robot)


def test_a_wrong_number_is_refused(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(symbolic._OPERATIONS, "max", lambda a, b: np.maximum(a, b) + 1e-9)
    with pytest.raises(geom_compiler.NotVectorisable):
        compiler_of(robot)


def test_rows_that_the_compiler_treats_otherwise_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A geom without mass at one end of the box only: there the body takes its inertia from the other geom."""
    robot = arm(link='<geom size="0.1"/><geom type="box" size="0.1 0.2 0.3" mass="{{ max(0, a - 0.3) }}"/>')
    rows = simulations(robot, 40)
    light = rows[:, 0] <= 0.3
    compiler = compiler_of(robot)
    _, done = compiler.prepare(rows)
    np.testing.assert_array_equal(done, ~light)
    assert 0 < light.sum() < 40
    batch = models.compile_models(robot, rows)
    for i, s in enumerate(rows):
        alone = mujoco.MjModel.from_xml_string(robot.render(s))
        for name, leaf in batch.leaves.items():
            np.testing.assert_array_equal(leaf[i], read_field(alone, name), err_msg=name)


@pytest.mark.parametrize("extra", ["", 'mass="0"'])
def test_a_model_that_the_compiler_refuses_is_refused(extra: str) -> None:
    """A size that is negative in a gap between all probes."""
    robot = arm(link=f'<geom size="{{{{ (a - 0.4321) | abs - 0.0005 }}}}" {extra}/><geom size="0.1"/>')
    assert models.why_compiled(robot) == ""
    inside = robot.nominal_simulation
    inside[0] = 0.4321
    with pytest.raises(models.InputError, match="size"):
        models.compile_models(robot, [robot.nominal, inside])


@pytest.mark.parametrize("several", [False, True])
def test_a_row_does_not_depend_on_its_batch(several: bool, robot: Robot) -> None:
    chosen = arm(link=SEVERAL["box and ellipsoid"]) if several else robot
    compiler, rows = compiler_of(chosen), chosen.simulation_box.sample(np.random.default_rng(8), 1000)
    whole, _ = compiler.prepare(rows)
    order = np.random.default_rng(9).permutation(1000)
    shuffled, _ = compiler.prepare(rows[order])
    for count in (1, 2, 7, 64):
        first, _ = compiler_of(chosen).prepare(rows[37 : 37 + count])
        for name, leaf in whole.items():
            assert leaf[37 : 37 + count].tobytes() == first[name].tobytes(), name
    for name, leaf in whole.items():
        assert leaf[order].tobytes() == shuffled[name].tobytes(), name


def test_a_batch_without_compiling_has_the_names_of_a_compiled_one(robot: Robot) -> None:
    batch = models.compile_models(robot, simulations(robot, 8))
    assert tuple(batch.leaves) == models.varying_fields(robot)
    assert all(leaf.dtype == np.float64 and len(leaf) == 8 for leaf in batch.leaves.values())
    assert set(batch.leaves) <= set(field_names(batch.base))


EXPRESSIONS = st.recursive(
    st.sampled_from(["x", "y", "2", "0.5", "3.7", "-1.25"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*/"), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        st.tuples(st.sampled_from(["sin", "cos", "sqrt", "radians", "-"]), inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(st.sampled_from(["min", "max"]), inner, inner).map(lambda t: f"{t[0]}({t[1]}, {t[2]})"),
        st.tuples(inner, st.sampled_from(["2", "3", "0.5"])).map(lambda t: f"({t[0]} ** {t[1]})"),
    ),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(EXPRESSIONS, st.integers(0, 2**31))
def test_traced_arithmetic_equals_the_templates_to_the_bit(expression: str, seed: int) -> None:
    # Added to a parameter, so that it is a number that depends on one.
    template = "{{ x + " + expression + " }}|"
    robot = dataclasses.replace(arm(), template=template, simulation_box=Box(["x", "y"], -3, 3), nominal=(0.5, 0.5))
    rows = robot.simulation_box.sample(np.random.default_rng(seed), 5)

    def rendered(row: np.ndarray) -> float:
        """NaN for an error of the template's arithmetic and for a complex number."""
        try:
            return float(robot.render(row)[:-1])
        except (models.InputError, ValueError):
            return np.nan

    try:
        skeleton = symbolic.trace(robot)
    except symbolic.Untraceable:  # a constant part of it has no value
        assert all(np.isnan(rendered(row)) for row in rows)
        return
    values, failed = skeleton.evaluate(rows)
    for i, row in enumerate(rows):
        number = rendered(row)
        if np.isnan(number):
            assert failed[i]
        elif not failed[i]:
            assert values[0, i].tobytes() == np.float64(number).tobytes()
            assert skeleton.matches(robot.render(row), values[:, i].tolist())


@pytest.mark.parametrize(
    "text", ["{{ x > 1 }}", "{{ x | int }}", "{{ x // 2 }}", "{{ [x, y] | sort }}", "{{ x == y }}"]
)
def test_what_cannot_be_traced_is_refused(text: str) -> None:
    robot = dataclasses.replace(arm(), template=text, simulation_box=Box(["x", "y"], 0.0, 1.0), nominal=(0.5, 0.5))
    with pytest.raises(symbolic.Untraceable):
        symbolic.trace(robot)


def full_matrix(values: Sequence[float]) -> np.ndarray:
    """A symmetric matrix from its elements xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_principal_axes_diagonalise() -> None:
    rng = np.random.default_rng(4)
    full = rng.normal(size=(6, 50))
    values, quaternions = compiler_rules.principal_axes(full)
    for i in range(50):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, quaternions[:, i])
        turned = rotation.reshape(3, 3).T @ full_matrix(full[:, i]) @ rotation.reshape(3, 3)
        np.testing.assert_allclose(turned, np.diag(values[:, i]), atol=1e-5)
        np.testing.assert_allclose(values[:, i], np.linalg.eigvalsh(full_matrix(full[:, i]))[::-1], atol=1e-10)
