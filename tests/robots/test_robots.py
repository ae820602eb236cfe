import dataclasses

import mujoco
import numpy as np
import pytest

from btr_mjx.errors import InputError
from btr_mjx.models import base_model, chosen_robot, compile_models
from btr_mjx.robots import Robot, hexapod
from btr_mjx.robots.hexapod import OMEGA


def test_hexapod_is_the_papers(robot: Robot) -> None:
    model = base_model(robot)
    names = [model.body(i).name for i in range(1, model.nbody)]
    assert sorted(names, key=lambda n: int(n[1:])) == [f"b{i}" for i in range(15)]
    assert (model.nu, model.nv) == (18, 24)
    assert robot.simulation_box.names == tuple(f"bl_{i}" for i in range(3, 15))
    assert robot.controller_box.n == 36
    np.testing.assert_allclose(robot.controller_box.low[:2], [0.12989, 0])
    np.testing.assert_allclose(robot.controller_box.high[:2], [0.314, 3.1416])
    assert model.opt.timestep == 5e-4
    assert round(hexapod().duration / model.opt.timestep) == 3400


@pytest.mark.parametrize("body", range(3, 15))
def test_a_limb_length_moves_its_own_body_only(robot: Robot, body: int) -> None:
    longer = robot.nominal_simulation
    longer[body - 3] += 0.1
    models = [compile_models(robot, s).row(0) for s in (robot.nominal_simulation, longer)]
    names = [models[0].body(i).name for i in range(models[0].nbody)]
    mass = [dict(zip(names, m.body_mass, strict=True)) for m in models]
    changed = {name for name in names if mass[0][name] != mass[1][name]}
    assert changed == {f"b{body}"}
    # The capsule spans the limb: its half length grew by half of what was added.
    geom = [m.geom(f"b{body}") for m in models]
    assert geom[1].size[1] - geom[0].size[1] == pytest.approx(0.05, abs=1e-12)


def test_density_is_uniform(robot: Robot) -> None:
    model = base_model(robot)
    for i in range(model.ngeom):
        if model.geom_type[i] != mujoco.mjtGeom.mjGEOM_CAPSULE:
            continue
        radius, half = model.geom_size[i, :2]
        volume = np.pi * radius**2 * (2 * half + 4 * radius / 3)
        body = model.geom_bodyid[i]
        assert model.body_mass[body] / volume == pytest.approx(dict(robot.constants)["density"])


def test_start_touches_the_ground_with_the_lowest_foot(robot: Robot, rng: np.random.Generator) -> None:
    for s in robot.simulation_box.sample(rng, 5):
        model = mujoco.MjModel.from_xml_string(robot.render(s))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        feet = [data.geom(f"foot{i}").xpos[2] - model.geom(f"foot{i}").size[0] for i in range(6)]
        assert min(feet) == pytest.approx(0.01, abs=1e-9)
        assert data.ncon == 0


def test_reference_signal_by_hand(robot: Robot) -> None:
    c = np.arange(36) / 10.0
    expected = [c[2 * i] * np.sin(OMEGA * 0.123 + c[2 * i + 1]) for i in range(18)]
    np.testing.assert_allclose(robot.signal(c, 0.123, np), expected, rtol=0, atol=1e-15)


def test_parameters_outside_the_box(robot: Robot) -> None:
    bad = robot.nominal_simulation
    bad[11] = 1.7
    with pytest.raises(ValueError, match=r"1\.7.*bl_14.*\[0\.4, 1\.6\]"):
        robot.render(bad)
    bad[11] = np.nan
    with pytest.raises(ValueError, match=r"nan.*bl_14"):
        robot.render(bad)
    with pytest.raises(ValueError, match=r"\(11,\)"):
        robot.render(bad[:11])


def test_undefined_variable_names_file_and_line(robot: Robot) -> None:
    text = robot.template.replace("{{ kp }}", "{{ stiffness }}")
    line = next(i for i, row in enumerate(text.splitlines(), 1) if "stiffness" in row)
    broken = dataclasses.replace(robot, template=text, template_path="mine.xml.j2")
    with pytest.raises(InputError, match=rf"mine\.xml\.j2.*stiffness.*line {line}"):
        broken.render(robot.nominal)


def test_broken_template_syntax(robot: Robot) -> None:
    broken = dataclasses.replace(robot, template=robot.template + "\n{% endfor %}", template_path="mine.xml.j2")
    with pytest.raises(InputError, match=r"mine\.xml\.j2.*endfor.*line"):
        broken.render(robot.nominal)


def test_broken_xml_shows_the_line(robot: Robot) -> None:
    broken = dataclasses.replace(
        robot, template=robot.template.replace("<freejoint", "<freejiont"), template_path="mine.xml.j2"
    )
    with pytest.raises(InputError, match=r"mine\.xml\.j2: MuJoCo.*freejiont.*line \d+.*reads: <freejiont"):
        base_model(broken)


def test_templates_are_sandboxed(robot: Robot) -> None:
    evil = dataclasses.replace(robot, template="{{ ''.__class__.__mro__ }}")
    with pytest.raises(InputError):
        evil.render(robot.nominal)


def test_unknown_constant() -> None:
    with pytest.raises(InputError, match=r"stiffness.*kp"):
        hexapod(stiffness=3.0)


def test_unreadable_template(tmp_path) -> None:
    with pytest.raises(InputError, match=r"absent\.xml\.j2"):
        chosen_robot(None, tmp_path / "absent.xml.j2", None)


def test_robots_are_values() -> None:
    assert hexapod() == hexapod()
    assert hash(hexapod(kp=1.0)) != hash(hexapod())


def test_a_robot_in_three_lines(robot: Robot) -> None:
    first, simulations, controllers = repr(robot).splitlines()
    assert "hexapod" in first
    assert simulations.split() == [
        "simulations:",
        "12",
        "parameters",
        "(bl_3,",
        "bl_4,",
        "bl_5,",
        "bl_6,",
        "bl_7,",
        "bl_8,",
        "...,",
        "bl_14)",
    ]
    assert "36 parameters" in controllers
    one = dataclasses.replace(robot, simulation_box=robot.simulation_box.subspace(["bl_3"]), nominal=(0.5,))
    assert repr(one).splitlines()[1] == "  simulations: 1 parameter (bl_3)"
