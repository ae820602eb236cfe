"""A simulator that grows: what is added to it, when, and that it can be saved in between."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gap_results import FOUND

from btr_mjx.backtoreality import CoevolveConfig, build_problem, growth, run_in_folder, summarise
from btr_mjx.backtoreality.algorithm import advance, begin
from btr_mjx.backtoreality.grown import grown
from btr_mjx.backtoreality.growth import (
    calibration_delta,
    entries_of_diagnosis,
    growth_sentence,
    proposals,
    unknown_parameters,
)
from btr_mjx.backtoreality.run_state import Problem, State, state_from_arrays, state_to_arrays
from btr_mjx.errors import Interrupted
from btr_mjx.evaluation import evaluate
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.results import Estimate, NamedEffect, RankedCandidate
from btr_mjx.models import compile_models, general_model
from btr_mjx.runs import RunFolder, StopRequest

EXAMPLES = Path(__file__).parents[2] / "examples"
SETTINGS = CoevolveConfig(
    robot=EXAMPLES / "thrower",
    engine="native",
    reality_engine="native",
    optimiser="cma",
    iterations=1,
    trials=6,
    controllers=12,
    controller_generations=2,
    simulations=16,
    simulation_generations=12,
    grow=True,
)


def number(value: float, low: float, high: float, null: float = 0.0) -> dict:
    return {"value": value, "low": low, "high": high, "null": null, "unit": "N m"}


FRICTION = {
    "effect": "dry_friction",
    "location": "each:all",
    "numbers": {"torque[shoulder]": number(0.5, 0.0, 1.0), "torque[elbow]": number(0.1, 0.0, 0.2)},
    "iteration": 1,
}


def problem(hidden: str = "", grow: bool = True) -> Problem:
    """The thrower, with something hidden at the shoulder of its reality."""
    made = build_problem(replace(SETTINGS, grow=grow))
    text = made.robot.template
    assert '<joint name="shoulder" damping="0.3"/>' in text
    real = text.replace('<joint name="shoulder" damping="0.3"/>', f'<joint name="shoulder" damping="0.3" {hidden}/>')
    return replace(made, reality=replace(made.reality, robot=replace(made.robot, template=real)))


def run(made: Problem, saved: bool = False) -> State:
    """The last state; `saved`: every state goes through what a checkpoint holds."""
    state = begin(made)
    while state.phase != "done":
        state = advance(made, state)
        if saved:
            state = state_from_arrays(*state_to_arrays(state))
    return state


@pytest.fixture(scope="module", autouse=True)
def few_effects() -> Iterator[None]:
    """Diagnoses of a robot of two joints need not try the whole library."""
    names = ("dry_friction", "viscous_damping", "armature", "actuator_gain")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(growth, "identify", partial(growth.identify, effects=[e for e in EFFECTS if e.name in names]))
        yield


@pytest.fixture(scope="module")
def ended() -> tuple[Problem, State]:
    made = problem('frictionloss="1.0"')
    return made, run(made)


def test_a_hidden_friction_becomes_a_dimension(ended: tuple[Problem, State]) -> None:
    made, state = ended
    (row,) = state.sought
    assert row["verdict"] == "effect"
    assert [name.split("@")[0] for name in row["added"]] == ["dry_friction"]
    result = summarise(made, state)
    shoulder = next(v for name, v in result["simulation"].items() if name.startswith("dry_friction"))
    assert shoulder == pytest.approx(1.0, rel=0.25)
    without = summarise(problem(grow=False), run(replace(problem('frictionloss="1.0"', grow=False))))
    assert result["delta_fitness_last"] < 0.5 * without["delta_fitness_last"]
    assert "now part of the simulator" in growth_sentence(row)
    assert set(result["truth"]) == {"ball mass", "elbow damping"}


def test_states_that_are_saved_give_the_same_result(ended: tuple[Problem, State]) -> None:
    _, state = ended
    again = run(problem('frictionloss="1.0"'), saved=True)
    np.testing.assert_array_equal(again.simulation, state.simulation)
    assert again.grown == state.grown
    assert again.sought == state.sought


class _Stop(StopRequest):
    """Asks to stop in the middle of a search, once its journal holds some results."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder

    def checkpoint(self) -> None:
        if len(list(self.folder.glob("*.npz"))) > 3:
            raise Interrupted("stopped", 15)


def test_a_search_that_is_stopped_goes_on_where_it_was(ended: tuple[Problem, State], tmp_path: Path) -> None:
    made, expected = ended
    journal = tmp_path / "run" / "search"
    with RunFolder.create(tmp_path / "run", SETTINGS, False) as folder, pytest.raises(Interrupted):
        run_in_folder(made, folder, _Stop(journal), False)
    assert journal.is_dir()
    with RunFolder.create(tmp_path / "run", SETTINGS, True) as folder:
        state = run_in_folder(made, folder, StopRequest(), False)
    np.testing.assert_array_equal(state.simulation, expected.simulation)
    assert state.sought == expected.sought
    assert state.told == expected.told
    assert not journal.exists()


def test_nothing_is_added_where_nothing_is_missing() -> None:
    state = run(problem())
    assert state.grown == ()
    assert [row["verdict"] for row in state.sought] == ["within calibration"]
    assert "nothing is sought" in growth_sentence(state.sought[0])


def test_an_added_effect_is_an_edit_of_the_model() -> None:
    """At its null the robot is what it was; elsewhere the joints have the friction."""
    made = problem()
    larger = grown(made, [FRICTION])
    names = ("dry_friction each:all torque[shoulder]", "dry_friction each:all torque[elbow]")
    assert larger.unknown == (*made.unknown, *names)
    np.testing.assert_array_equal(larger.start[-2:], 0.0)
    simulation = np.array([*made.start, 0.5, 0.1])
    model = compile_models(larger.robot, simulation).row(0)
    np.testing.assert_allclose(model.dof_frictionloss, [0.5, 0.1])
    controllers = made.robot.controller_box.sample(np.random.default_rng(0), 3)
    before = evaluate(made.robot, made.start, controllers, engine="native").fitness
    same = evaluate(larger.robot, larger.start, controllers, engine="native").fitness
    other = evaluate(larger.robot, simulation, controllers, engine="native").fitness
    np.testing.assert_allclose(same, before, rtol=1e-9)
    assert np.abs(other - before).min() > 1e-6


def test_calibration_explains_little_but_something(ended: tuple[Problem, State]) -> None:
    made, state = ended
    left = calibration_delta(grown(made, state.grown), state)
    assert 1e-4 < left < 0.05


BACKLASH = {
    "effect": "backlash",
    "location": "all",
    "numbers": {"play": {"value": 0.05, "low": 0.0, "high": 0.2, "null": 0.0, "unit": "rad"}},
    "iteration": 1,
}


def test_an_effect_that_no_model_has_is_simulated() -> None:
    """Backlash beside friction: at their nulls the robot is what it was, with each alone it is not."""
    made = problem()
    larger = grown(replace(made, engine="lanes"), [FRICTION, BACKLASH])
    assert larger.engine is None
    controllers = made.robot.controller_box.sample(np.random.default_rng(0), 3)
    before = evaluate(made.robot, made.start, controllers, engine="native").fitness
    rows = np.tile(larger.start, (3, 1))
    rows[1, -3] = 0.5
    rows[2, -1] = 0.05
    same, friction, play = evaluate(larger.robot, rows, controllers).fitness
    np.testing.assert_allclose(same, before[0], rtol=1e-9)
    assert np.abs(friction - before).max() > 1e-4
    assert np.abs(play - before).max() > 1e-4
    coefficient = {"value": 0.1, "low": 0.0, "high": 0.3, "null": 0.0, "unit": "1"}
    loaded = {"effect": "load_friction", "location": "all", "numbers": {"coefficient": coefficient}}
    twice = grown(grown(made, [BACKLASH]), [loaded])
    assert len(twice.robot.simulator.effects) == 2


@pytest.mark.parametrize("robot", [EXAMPLES / "thrower", EXAMPLES / "quadruped", None])
def test_an_unknown_parameter_changes_what_it_does_in_S(robot: Path | None) -> None:
    """Absolute and relative paths and variables of a template, against the model of the other simulation."""
    made = build_problem(replace(SETTINGS, robot=robot))
    box = made.robot.simulation_box
    here, there = made.start, made.start.copy()
    i = box.indices(made.unknown)
    there[i] += 0.1 * (box.high - box.low)[i]
    model, expected = general_model(made.robot, here), general_model(made.robot, there)
    for unknown in unknown_parameters(made, here):
        assert unknown.value(model) == here[box.index(unknown.name)]
        unknown.write(model, there[box.index(unknown.name)])
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for name in ("body_mass", "body_inertia", "body_pos", "geom_size", "geom_pos", "dof_damping", "actuator_gainprm"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-9, atol=1e-12, err_msg=name)
    assert not np.array_equal(expected.dof_M0, general_model(made.robot, here).dof_M0)


def test_recordings_propose_what_they_prefer() -> None:
    row = RankedCandidate("dry_friction", "joint:elbow", 12.0, 0.0, 15.0, 6.0, {"torque": 0.1})
    rows = (row, replace(row, beside=("armature@joint:elbow",)), replace(row, effect="backlash", score=-1.0))
    diagnosis = replace(FOUND, unexplained=("a force",), joint_errors=(), ranking=rows)
    assert [(one.effect, one.values) for one in proposals(diagnosis)] == [("dry_friction", {"torque": 0.1})]
    assert proposals(replace(diagnosis, found=(), unexplained=())) == []


def test_bounds_of_new_dimensions(ended: tuple[Problem, State]) -> None:
    """The null is possible, and friction is not negative."""
    made, state = ended
    diagnosis = replace(
        FOUND,
        found=(
            NamedEffect("dry_friction", "joint:elbow", {"torque": Estimate(0.1, 0.05, 0.2, "N m")}, 1.0, 1.0),
            NamedEffect("armature", "joint:elbow", {"armature": Estimate(0.1, 0.09, 0.12, "kg m^2")}, 1.0, 1.0),
        ),
    )
    first, second = entries_of_diagnosis(diagnosis, made, replace(state, simulation=made.start), 5)
    torque = first["numbers"]["torque"]
    assert (torque["low"], torque["high"], torque["null"]) == (0.0, pytest.approx(0.4), 0.0)
    armature = second["numbers"]["armature"]
    assert (armature["low"], armature["high"]) == (0.0, pytest.approx(0.16))
    assert len(entries_of_diagnosis(diagnosis, made, replace(state, simulation=made.start), 1)) == 1
