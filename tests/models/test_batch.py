"""Batches of models against MuJoCo's compiler, one simulation at a time."""

import dataclasses
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from btr_mjx.engines import MjxStepper
from btr_mjx.errors import InputError
from btr_mjx.models import PathParameter, base_model, compile_models, load_robot, read_field, varying_fields
from btr_mjx.models.model_fields import field_names
from btr_mjx.robots import Box, Robot, Sinusoids


@pytest.fixture(scope="module")
def simulations(robot: Robot) -> np.ndarray:
    return robot.simulation_box.sample(np.random.default_rng(5), 6)


def test_rows_equal_models_compiled_alone(robot: Robot, simulations: np.ndarray) -> None:
    batch = compile_models(robot, simulations)
    for i, s in enumerate(simulations):
        alone, row = mujoco.MjModel.from_xml_string(robot.render(s)), batch.row(i)
        for name in field_names(alone):
            assert np.array_equal(read_field(alone, name), read_field(row, name)), name


def test_mjx_leaves_equal_put_model_of_each(robot: Robot, simulations: np.ndarray) -> None:
    """Every leaf of the batched mjx.Model, derived fields included, against mjx.put_model of each MJCF alone."""
    batch = compile_models(robot, simulations)
    stepper = MjxStepper(batch.base, frozenset(batch.leaves))
    packed = stepper.pack({name: values[None] for name, values in batch.leaves.items()})
    for i, s in enumerate(simulations):
        text = robot.render(s).replace("<pid", "<position").replace(' input="pos"', "").replace('ki="1000.0" ', "")
        alone = mjx.put_model(mujoco.MjModel.from_xml_string(text), impl="jax")
        ours = stepper._model.tree_replace({name: values[0, i] for name, values in packed.items()})
        expected, got = (jax.tree_util.tree_leaves_with_path(m) for m in (alone, ours))
        assert len(expected) == len(got)
        for (path, x), (_, y) in zip(expected, got, strict=True):
            name = jax.tree_util.keystr(path)
            if name != "._sizes":  # counts of names and activations, not physics
                np.testing.assert_array_equal(np.asarray(x), np.asarray(y), err_msg=name)


def test_only_what_differs_is_stacked(robot: Robot) -> None:
    leaves = compile_models(robot, [robot.nominal]).leaves
    assert {"body_mass", "body_invweight0", "dof_invweight0", "stat.meaninertia", "qpos0"} <= set(leaves)
    assert not {"geom_friction", "dof_damping", "actuator_gainprm", "opt.gravity"} & set(leaves)


def test_one_program_serves_every_batch(robot: Robot) -> None:
    one = compile_models(robot, [robot.nominal])
    many = compile_models(robot, robot.simulation_box.sample(np.random.default_rng(0), 3))
    assert list(one.leaves) == list(many.leaves)
    assert len(many) == 3


def test_equal_simulations_share_a_row_and_order_does_not_matter(robot: Robot) -> None:
    rows = robot.simulation_box.sample(np.random.default_rng(8), 7)
    order = np.array([3, 3, 0, 6, 1, 0, 2])
    whole, some = compile_models(robot, rows).leaves, compile_models(robot, rows[order]).leaves
    for name, leaf in whole.items():
        assert leaf[order].tobytes() == some[name].tobytes(), name


ARM = """
<mujoco>
  <compiler angle="degree"/>
  <option timestep="0.001" gravity="0 0 {{{{ -g }}}}"/>
  <default><geom density="500"/><default class="stiff"><joint range="-40 {{{{ 10 + 30 * r }}}}"/></default></default>
  {assets}
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    <body name="base" pos="0 0 {{{{ 1 + a }}}}"><freejoint/><geom type="box" size="0.1 0.2 0.3"/>
      <body name="link" pos="{{{{ a }}}} 0 {{{{ -b / 2 }}}}"><joint name="hinge" axis="0 1 0" class="stiff"/>
        {link}<site name="tip" pos="0 0 {{{{ -a * b }}}}" size="0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="hinge" kp="{{{{ 100 * a }}}}" {damping}/></actuator>
</mujoco>
"""


def arm(link: str = '<geom size="{{ r }}"/>', damping: str = 'kv="1"', assets: str = "") -> Robot:
    """A small robot whose parts a test chooses; a, b [m] lengths, r [m] a radius, g [m/s^2] gravity."""
    low, high = [0.1, 0.3, 0.02, 5.0], [0.6, 0.9, 0.1, 12.0]
    return Robot(
        name="arm",
        template=ARM.format(link=link, damping=damping, assets=assets),
        template_path="arm.xml.j2",
        simulation_box=Box(["a", "b", "r", "g"], low, high),
        controller_box=Box(["u"], 0.0, 1.0),
        signal=Sinusoids((0,), (0,), (), -1, 1.0, (0.0,), (1.0,), (0.0,)),
        nominal=tuple((np.array(low) + high) / 2),
    )


_CORNERS = " ".join(f"{x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
TEMPLATES = {
    "plain": {},
    "decision": {"link": '{% if a > 0.3 %}<geom size="0.1"/>{% else %}<geom size="0.2"/>{% endif %}'},
    "rounding": {"link": '<geom size="{{ r | round(3) }}"/>'},
    "formatting": {"link": "<geom size=\"{{ '%.6f' | format(r) }}\"/>"},
    "text": {"link": '<geom size="{{ r }}e-1"/>'},
    "angle": {"link": '<geom type="box" size="0.1 0.2 0.3" euler="{{ 90 * a }} 0 0"/>'},
    "ends": {"link": '<geom type="capsule" size="{{ r }}" fromto="{{ -a }} 0.1 0 {{ a }} {{ b }} {{ -b }}"/>'},
    "several": {
        "link": '<geom type="box" size="{{ r }} {{ a }} {{ b }}" euler="10 20 30" pos="{{ a }} 0 0.1"/>'
        '<geom type="ellipsoid" size="{{ a }} {{ r }} {{ r }}" pos="0 {{ b }} 0" quat="1 2 3 4"/><geom size="{{ b }}"/>'
    },
    "other order of geoms between the probes": {
        "link": "{% set side = 1 if (a - 0.4321) | abs > 0.0005 else -1 %}"
        '<geom size="0.05" pos="{{ side * a }} 0 0"/><geom size="0.05" pos="{{ -side * a }} 0 0"/>'
    },
    "full inertia": {
        "link": '<inertial pos="0 0 0" mass="1" fullinertia="{{ b }} {{ b }} {{ b }} {{ r }} 0 0"/>',
    },
    "shell": {"link": '<geom type="box" size="0.1 0.2 {{ a }}" shellinertia="true"/>'},
    "damping ratio": {"damping": 'dampratio="{{ r }}"'},
    "mesh": {
        "link": '<geom type="mesh" mesh="m"/>',
        "assets": f'<asset><mesh name="m" scale="1 1 {{{{ b }}}}" vertex="{_CORNERS}"/></asset>',
    },
}


@pytest.mark.parametrize("parts", TEMPLATES.values(), ids=TEMPLATES.keys())
def test_every_field_of_a_row_is_the_compilers(parts: dict[str, str]) -> None:
    robot = arm(**parts)
    box, rng = robot.simulation_box, np.random.default_rng(3)
    rows = np.concatenate([box.sample(rng, 6), [box.low, box.high, robot.nominal]])
    rows[-1, 0] = 0.4321
    batch = compile_models(robot, rows)
    assert tuple(batch.leaves) == varying_fields(robot)
    for i, s in enumerate(rows):
        alone, row = mujoco.MjModel.from_xml_string(robot.render(s)), batch.row(i)
        same_tree = np.array_equal(alone.bvh_nodeid, row.bvh_nodeid)
        for name in field_names(alone):
            if same_tree or not name.startswith("bvh_"):
                np.testing.assert_array_equal(read_field(row, name), read_field(alone, name), err_msg=name)


def test_bounding_volumes_hold_their_geoms() -> None:
    """Where the compiler would gather a body's geoms in another order, the base model's order is kept."""
    robot = arm(**TEMPLATES["several"])
    rows = robot.simulation_box.sample(np.random.default_rng(3), 40)
    assert len({mujoco.MjModel.from_xml_string(robot.render(s)).bvh_nodeid.tobytes() for s in rows}) > 1
    batch = compile_models(robot, rows)
    for i in range(len(batch)):
        model = batch.row(i)
        body = model.body("link").id
        nodes = model.body_bvhadr[body] + np.arange(model.body_bvhnum[body])
        boxes, geoms = model.bvh_aabb[nodes], model.bvh_nodeid[nodes]
        assert np.all(boxes[:, :3] - boxes[:, 3:] >= boxes[0, :3] - boxes[0, 3:] - 1e-9)
        assert np.all(boxes[:, :3] + boxes[:, 3:] <= boxes[0, :3] + boxes[0, 3:] + 1e-9)
        assert sorted(geoms[geoms >= 0]) == (model.body_geomadr[body] + np.arange(3)).tolist()
        for box, geom in zip(boxes[geoms >= 0], geoms[geoms >= 0], strict=True):
            centre, turn = np.empty(3), model.body_iquat[body] * [1, -1, -1, -1]
            mujoco.mju_rotVecQuat(centre, model.geom_pos[geom] - model.body_ipos[body], turn)
            assert np.all(np.abs(centre - box[:3]) <= box[3:] + 1e-9)


def test_paths_set_what_the_compiler_would_make_of_their_numbers() -> None:
    """Five unknown numbers of the quadruped against its MJCF with these numbers, compiled for each simulation alone."""
    file = Path(__file__).parents[2] / "examples/quadruped"
    robot = load_robot(file)
    paths = {
        "mass": ("body:trunk/mass", 3.0, 12.0),
        "damping": ("joint:front_left_knee/damping", 0.1, 2.0),
        "armature": ("joint:rear_left_hip/armature", 0.0, 0.1),
        "friction": ("geom:floor/friction[0]", 0.3, 1.2),
        "shift": ("body:front_left_shank/pos[2]", -0.2, -0.12),
    }
    edits = tuple(PathParameter(name, (path,), low, high) for name, (path, low, high) in paths.items())
    robot = dataclasses.replace(
        robot,
        simulation_box=Box(list(paths), [low for _, low, _ in paths.values()], [high for _, _, high in paths.values()]),
        nominal=(6.0, 0.5, 0.01, 0.8, -0.16),
        edits=edits,
    )
    rows = robot.simulation_box.sample(np.random.default_rng(0), 20)
    batch = compile_models(robot, rows)
    for i, s in enumerate(rows):
        mass, damping, armature, friction, shift = s.tolist()
        spec = mujoco.MjSpec.from_file(str(file / "robot.xml"))
        for body in spec.bodies:
            body.simple = 0
        trunk = base_model(robot).body("trunk")
        body = spec.body("trunk")
        body.explicitinertial, body.mass, body.ipos, body.iquat = True, mass, trunk.ipos, trunk.iquat
        body.inertia = trunk.inertia * mass / trunk.mass[0]
        spec.joint("front_left_knee").damping[0] = damping
        spec.joint("rear_left_hip").armature = armature
        spec.geom("floor").friction[0] = friction
        spec.body("front_left_shank").pos[2] = shift
        alone, row = spec.compile(), batch.row(i)
        for name in field_names(alone):
            if not name.startswith("stat."):  # mj_setConst leaves the statistics
                found, expected = read_field(row, name), read_field(alone, name)
                np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15, err_msg=name)


def test_structure_that_changes_is_refused(robot: Robot) -> None:
    odd = dataclasses.replace(
        robot,
        template=robot.template.replace("</worldbody>", "{% if bl_3 > 1 %}<geom size='1'/>{% endif %}</worldbody>"),
    )
    with pytest.raises(InputError, match="same bodies"):
        compile_models(odd, [robot.nominal])


def test_fields_that_jump_between_the_probes_are_refused(robot: Robot) -> None:
    # Friction that differs in a corner that no probe visits.
    corner = "{{ 0.1 if [bl_3, bl_4, bl_5]|min > 1.599 and bl_6 < 0.401 else friction }}"
    odd = dataclasses.replace(robot, template=robot.template.replace("{{ friction }}", corner))
    s = robot.nominal_simulation
    compile_models(odd, [s])
    s[:3], s[3] = 1.6, 0.4
    with pytest.raises(InputError, match="geom_friction changes"):
        compile_models(odd, [s])


def test_an_error_of_one_row_names_its_parameters() -> None:
    """A size that is negative in a gap between all probes, and arithmetic that fails in one."""
    size, root = "(a - 0.4321) | abs - 0.0005", "sqrt((a - 0.4321) | abs - 0.0005)"
    for link, message in ((size, "size"), (root, "math domain error")):
        robot = arm(link=f'<geom size="{{{{ {link} }}}}"/><geom size="0.1"/>')
        inside = robot.nominal_simulation
        inside[0] = 0.4321
        with pytest.raises(InputError, match=rf"(?s)arm\.xml\.j2.*{message}.*a = 0\.4321, b = 0\.6") as error:
            compile_models(robot, [robot.nominal, inside])
        assert "\n" not in str(error.value)
