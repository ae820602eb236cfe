"""Exports against the models that they describe."""

import dataclasses
import importlib.util
import json
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gap_arm
import jax
import mujoco
import numpy as np
import polars as pl
import pytest
from mujoco import mjx

from btr_mjx.backtoreality.run_exports import export_coevolution
from btr_mjx.errors import InputError
from btr_mjx.exports import ExportedParameter, field_ends, is_linear, robot_ends, write_exports
from btr_mjx.gap.results import Diagnosis, Estimate, FoundEffect, MendedModel, NamedEffect, mend
from btr_mjx.gap.results.exported import export_diagnosis
from btr_mjx.models import compile_models, model_of, parse_path, set_values
from btr_mjx.robots import Robot
from btr_mjx.runs import write_json

ROOT = Path(__file__).parents[2]


def arm(**values: float) -> mujoco.MjModel:
    """The two-link arm with numbers set by path."""
    model = mujoco.MjModel.from_xml_string(gap_arm.XML)
    set_values(model, {name.replace("__", ":").replace("_at_", "/"): value for name, value in values.items()})
    return model


def test_field_ends_are_the_numbers_that_were_set() -> None:
    low, high = arm(joint__elbow_at_damping=0.02), arm(joint__elbow_at_damping=0.09)
    assert field_ends(low, high) == {"dof_damping[1]": (0.02, 0.09)}
    drag = field_ends(arm(option_at_density=0.0), arm(option_at_density=1.2))
    assert drag == {"option/density": (0.0, 1.2)}
    wind = mujoco.MjModel.from_xml_string(gap_arm.XML)
    wind.opt.wind[1] = 3.0
    assert field_ends(arm(), wind) == {"option/wind[1]": (0.0, 3.0)}
    heavy = field_ends(arm(), arm(body__lower_at_mass=0.6))
    assert {"body_mass[2]", "body_inertia[2][0]", "body_subtreemass[1]", "dof_M0[0]"} <= set(heavy)
    assert field_ends(low, low) == {}
    assert field_ends(low, arm(joint__elbow_at_damping=0.02 * (1 + 1e-12))) == {}


def test_paths_are_read_by_the_package(robot: Robot) -> None:
    """Every difference of two models of the hexapod has a path, and every path leads to its number."""
    s = np.array(robot.nominal_simulation)
    low, high = model_of(robot, s), model_of(robot, s + 0.1 * (np.arange(12) == 3))
    ends = field_ends(low, high)
    for path, (a, b) in ends.items():
        assert (parse_path(low, path).read(low), parse_path(high, path).read(high)) == (a, b)
    models = compile_models(robot, [s, s + 0.1 * (np.arange(12) == 3)])
    for name, leaf in models.leaves.items():
        if name.startswith(("body_", "geom_", "dof_")) and leaf.dtype.kind == "f":
            moved = ~np.isclose(leaf[0], leaf[1], rtol=0, atol=1e-9 * np.abs(leaf).max())
            assert moved.sum() == sum(path.split("[")[0] == name for path in ends)


def test_what_is_not_near_a_line() -> None:
    base, end = arm(joint__elbow_at_damping=0.0), arm(joint__elbow_at_damping=1.0)
    ends = field_ends(base, end)
    assert is_linear(ends, 0.5, base, arm(joint__elbow_at_damping=0.6))
    assert not is_linear(ends, 0.5, base, arm(joint__elbow_at_damping=0.9))
    assert not is_linear(ends, 0.5, base, base)


def test_files(tmp_path: Path) -> None:
    fixed = ExportedParameter("gain", "", 1.5, None, None, "refitted")
    ranged = ExportedParameter("damping", "N m s/rad", 0.3, 0.2, 0.4, "named", {"dof_damping[0]": (0.2, 0.4)})
    hidden = dataclasses.replace(ranged, name="backlash", paths={})
    write_exports(tmp_path, [fixed, ranged, hidden])
    table = pl.read_csv(tmp_path / "parameters.csv")
    assert table.columns == ["name", "unit", "value", "interval_low", "interval_high", "origin"]
    assert table["interval_low"].to_list() == [None, 0.2, 0.2]
    assert [row["name"] for row in json.loads((tmp_path / "parameters.json").read_text())] == table["name"].to_list()
    assert json.loads((tmp_path / "randomisation.json").read_text())["parameters"] == {
        "damping": {"dof_damping[0]": [0.2, 0.4]}
    }
    write_exports(tmp_path / "nothing", [])
    assert not (tmp_path / "nothing").exists()


def exported(folder: Path, *effects: NamedEffect) -> dict[str, Any]:
    """randomisation.json of a diagnosis of the arm."""
    diagnosis = Diagnosis(effects, (), 1, 1.0)
    dataset: Any = SimpleNamespace(parameters=())
    export_diagnosis(diagnosis, dataset, folder, lambda found: mend(gap_arm.XML, found))
    return json.loads((folder / "randomisation.json").read_text())["parameters"]


DAMPING = NamedEffect("viscous_damping", "joint:elbow", {"damping": Estimate(0.3, 0.2, 0.5, "N m s/rad")}, 9.0, 3.0)
FRICTION = NamedEffect("dry_friction", "joint:shoulder", {"torque": Estimate(0.1, 0.08, 0.13, "N m")}, 9.0, 3.0)


def test_ranges_of_named_effects(tmp_path: Path) -> None:
    """The ends are those of the models mended with the ends of the intervals."""
    found = exported(tmp_path, DAMPING, FRICTION)
    assert list(found) == ["viscous_damping@joint:elbow damping", "dry_friction@joint:shoulder torque"]
    for effect, (name, parameter) in zip((DAMPING, FRICTION), (("damping", 0), ("torque", 1)), strict=True):
        ends = list(found.values())[parameter]
        estimate = effect.parameters[name]
        for side, value in enumerate((estimate.low, estimate.high)):
            xml = mend(gap_arm.XML, [FoundEffect(effect.effect, effect.location, {name: value})]).xml
            model = mujoco.MjModel.from_xml_string(xml)
            for path, pair in ends.items():
                assert parse_path(model, path).read(model) == pytest.approx(pair[side], rel=1e-9)


def test_effects_without_mjcf_have_no_ranges(tmp_path: Path) -> None:
    play = NamedEffect("backlash", "joint:elbow", {"play": Estimate(0.02, 0.01, 0.03, "rad")}, 9.0, 3.0)
    with pytest.raises(FileNotFoundError):
        exported(tmp_path, play)
    (row,) = json.loads((tmp_path / "parameters.json").read_text())
    assert (row["interval_low"], row["interval_high"]) == (0.01, 0.03)
    assert "mended.json" in row["origin"]


def test_files_agree_on_what_is_in_the_mjcf(tmp_path: Path) -> None:
    """An effect is inside mended.xml, or to be added beside it, in every file; ranges are of numbers inside it."""
    slow = NamedEffect(
        "viscous_damping", "joint:shoulder", {"damping": Estimate(0.2, None, None, "N m s/rad")}, 9.0, 3.0
    )
    worn = NamedEffect("load_friction", "all", {"coefficient": Estimate(0.1, 0.08, 0.12, "1")}, 9.0, 3.0)
    weak = NamedEffect("actuator_gain", "all", {"change": Estimate(0.02, None, None, "1")}, 9.0, 3.0)
    late = NamedEffect("backlash", "joint:elbow", {"play": Estimate(0.01, None, None, "rad")}, 9.0, 3.0)
    diagnosis = Diagnosis((DAMPING, slow, worn), (), 1, 1.0, calibration=(weak, late))
    dataset: Any = SimpleNamespace(parameters=())
    fixed = [weak.found(), late.found()]
    export_diagnosis(diagnosis, dataset, tmp_path, lambda found: mend(gap_arm.XML, [*fixed, *found]))
    saved = mend(gap_arm.XML, [*fixed, *(effect.found() for effect in diagnosis.effects)]).as_json()
    terms = {f"{term['effect']}@{term['location']}" for term in saved["terms"]}
    assert terms == {worn.name, late.name}
    assert set(saved["native"]) == {DAMPING.name, slow.name, weak.name}
    rows = {row["name"].split(" ")[0]: row for row in json.loads((tmp_path / "parameters.json").read_text())}
    assert {name for name, row in rows.items() if "needs mended.json" in row["origin"]} == terms
    assert {name for name, row in rows.items() if row["interval_low"] is not None} == {DAMPING.name, worn.name}
    assert "interval" not in rows[slow.name]["origin"]
    assert list(json.loads((tmp_path / "randomisation.json").read_text())["parameters"]) == [f"{DAMPING.name} damping"]


def test_what_mjcf_cannot_write_is_said(tmp_path: Path) -> None:
    """A model that could not be mended holds nothing of what was found."""
    failed = MendedModel(gap_arm.XML, notes=("the model could not be mended: for some reason",))
    diagnosis = Diagnosis((DAMPING,), (), 1, 1.0)
    export_diagnosis(diagnosis, SimpleNamespace(parameters=()), tmp_path, lambda found: failed)  # type: ignore[arg-type]
    (row,) = json.loads((tmp_path / "parameters.json").read_text())
    assert "not in the model, see the notes of mended.json" in row["origin"]
    assert "see notes" in failed.as_json()["use"]
    assert not (tmp_path / "randomisation.json").exists()


def test_a_finished_run(tmp_path: Path) -> None:
    name = "backlash all play"
    space = {"bl_5": {"unit": "m"}, name: {"unit": "rad"}}
    told = {"intervals": {"bl_5": [0.8, 1.0], name: [0.0, 0.05]}, "told": ["bl_5"], "combinations": []}
    write_json(tmp_path / "result.json", {"simulation": {"bl_5": 0.9, name: 0.02}, "space": space, "told": told})
    term = {"effect": "backlash", "location": "all", "parameters": {"play": 0.02}}
    write_json(tmp_path / "simulation.json", {"terms": [term]})
    export_coevolution(tmp_path)
    rows = json.loads((tmp_path / "parameters.json").read_text())
    assert [(row["name"], row["unit"], row["value"], row["interval_low"]) for row in rows] == [
        ("bl_5", "m", 0.9, 0.8),
        (name, "rad", 0.02, 0.0),
    ]
    assert ["not told by these trials" in row["origin"] for row in rows] == [False, True]
    assert ["needs simulation.json" in row["origin"] for row in rows] == [False, True]
    assert not (tmp_path / "randomisation.json").exists()


def test_ends_of_a_parameter_of_a_robot(robot: Robot) -> None:
    ends = robot_ends(robot, {"bl_14": 1.5}, "bl_5", 0.8, 0.9)
    assert len(ends) > 10
    s = np.array(robot.nominal_simulation)
    s[robot.simulation_box.indices(["bl_14"])] = 1.5
    for side, value in enumerate((0.8, 0.9)):
        s[robot.simulation_box.indices(["bl_5"])] = value
        model = model_of(robot, s)
        assert all(parse_path(model, path).read(model) == pair[side] for path, pair in ends.items())
    assert robot_ends(robot, {}, "bl_5", 0.4, 1.6) == {}  # the height of the lifted trunk has a kink
    with pytest.raises(InputError, match=r"1\.7"):
        robot_ends(robot, {}, "bl_5", 0.8, 1.7)


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("randomize", ROOT / "examples" / "randomize.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_randomised_models(example: ModuleType, tmp_path: Path) -> None:
    """Worlds differ in the exported numbers only, within their ends; two parameters of one number add up."""
    model = mujoco.MjModel.from_xml_string(
        mend(gap_arm.XML, [FoundEffect("viscous_damping", "joint:elbow", {"damping": 0.3})]).xml
    )
    ranges = exported(tmp_path, DAMPING)
    ranges["mass"] = {"body_mass[2]": [0.4, 0.6], "body_inertia[2][0]": [0.004, 0.006], "dof_M0[1]": [0.1, 0.2]}
    ranges["more mass"] = {"body_mass[2]": [0.5, 0.7]}
    write_json(tmp_path / "all.json", {"parameters": ranges})
    keys = jax.random.split(jax.random.key(0), 200)
    put = mjx.put_model(model)
    batched, in_axes = example.randomizer(tmp_path / "all.json")(put, keys)
    damping, mass = np.asarray(batched.dof_damping), np.asarray(batched.body_mass)
    assert damping.shape == (200, 2)
    low, high = ranges["viscous_damping@joint:elbow damping"]["dof_damping[1]"]
    assert low <= damping[:, 1].min() < low + 0.1 * (high - low)
    assert high - 0.1 * (high - low) < damping[:, 1].max() <= high * (1 + 1e-6)
    assert np.ptp(damping[:, 0]) == 0
    added = np.asarray(batched.body_inertia)[:, 2, 0] * 100 - 0.5
    np.testing.assert_array_less(-1e-6, mass[:, 2] - model.body_mass[2] - added)
    np.testing.assert_array_less(mass[:, 2] - model.body_mass[2] - added, 0.2 + 1e-6)
    axes = {jax.tree_util.keystr(path) for path, axis in jax.tree_util.tree_leaves_with_path(in_axes) if axis == 0}
    assert {name.split(".")[-1] for name in axes} == {"dof_damping", "body_mass", "body_inertia"} | (
        {"dof_M0"} if hasattr(put, "dof_M0") else set()
    )
    moved = jax.vmap(mjx.kinematics, in_axes=(in_axes, None))(batched, mjx.make_data(put))
    assert moved.xpos.shape == (200, 3, 3)
