import dataclasses

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from btr_mjx.engines import MjxStepper
from btr_mjx.errors import InputError
from btr_mjx.models import batch as models
from btr_mjx.robots import Robot


@pytest.fixture(scope="module")
def simulations(robot: Robot) -> np.ndarray:
    return robot.simulation_box.sample(np.random.default_rng(5), 6)


def test_rows_equal_models_compiled_alone(robot: Robot, simulations: np.ndarray) -> None:
    batch = models.compile_models(robot, simulations)
    for i, s in enumerate(simulations):
        alone, row = mujoco.MjModel.from_xml_string(robot.render(s)), batch.row(i)
        for name in models.field_names(alone):
            assert np.array_equal(models.read_field(alone, name), models.read_field(row, name)), name


def test_mjx_leaves_equal_put_model_of_each(robot: Robot, simulations: np.ndarray) -> None:
    """Every leaf of the batched mjx.Model, derived fields included, against mjx.put_model of each MJCF alone."""
    batch = models.compile_models(robot, simulations)
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
    leaves = models.compile_models(robot, [robot.nominal]).leaves
    assert {"body_mass", "body_invweight0", "dof_invweight0", "stat.meaninertia", "qpos0"} <= set(leaves)
    assert not {"geom_friction", "dof_damping", "actuator_gainprm", "opt.gravity"} & set(leaves)


def test_one_program_serves_every_batch(robot: Robot) -> None:
    one = models.compile_models(robot, [robot.nominal])
    many = models.compile_models(robot, robot.simulation_box.sample(np.random.default_rng(0), 3))
    assert list(one.leaves) == list(many.leaves)
    assert len(many) == 3


def test_structure_that_changes_is_refused(robot: Robot) -> None:
    odd = dataclasses.replace(
        robot,
        template=robot.template.replace("</worldbody>", "{% if bl_3 > 1 %}<geom size='1'/>{% endif %}</worldbody>"),
    )
    with pytest.raises(InputError, match="same bodies"):
        models.compile_models(odd, [robot.nominal])


def test_fields_that_jump_between_the_probes_are_refused(robot: Robot) -> None:
    # Friction that differs in a corner that no probe visits.
    corner = "{{ 0.1 if [bl_3, bl_4, bl_5]|min > 1.599 and bl_6 < 0.401 else friction }}"
    odd = dataclasses.replace(robot, template=robot.template.replace("{{ friction }}", corner))
    s = robot.nominal_simulation
    models.compile_models(odd, [s])
    s[:3], s[3] = 1.6, 0.4
    with pytest.raises(InputError, match="geom_friction changes"):
        models.compile_models(odd, [s])
