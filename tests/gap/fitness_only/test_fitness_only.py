"""Fitness alone: what a table of trials says, its bad input, and a search that finds a large effect."""

import dataclasses
import shutil
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest
from hidden_cases import FitnessCaseSettings, make_fitness_case

from btr_mjx.errors import InputError
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.fitness_only import (
    CandidateResponses,
    TrialSimulator,
    expected_steps,
    identify_fitness,
    load_fitness,
    preflight_fitness,
    save_fitness,
    simulate_candidates,
)
from btr_mjx.gap.fitness_only.screen import rank_by_fit, screening_timestep
from btr_mjx.gap.preflight import refuse_errors
from btr_mjx.gap.results import Diagnosis
from btr_mjx.gap.simulate import World

XML = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" friction="0.6"/>
    <body name="cart" pos="0 0 0.1">
      <freejoint name="root"/>
      <geom name="cart" type="box" size="0.2 0.1 0.05" mass="2" friction="0.6"/>
      <body name="tail" pos="-0.2 0 0">
        <joint name="tail" axis="0 0 1" damping="0.02"/>
        <geom name="tail" type="capsule" fromto="0 0 0 -0.3 0 0" size="0.02" mass="0.3" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="tail" joint="tail" kp="8" kv="0.1"/></actuator>
</mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(XML)
OMEGA, SPAN = 25.0, 0.4
ABOUT = {"body": "cart", "function": "distance", "duration": SPAN, "omega": OMEGA}


def plain(model: mujoco.MjModel, amplitude: float, phase: float) -> float:
    """Fitness of one controller by a loop over mj_step."""
    data = mujoco.MjData(model)
    for k in range(round(SPAN / model.opt.timestep)):
        data.ctrl[0] = amplitude * np.sin(OMEGA * k * model.opt.timestep + phase)
        mujoco.mj_step(model, data)
    return float(np.hypot(*(data.qpos[:2] - model.qpos0[:2]))) / SPAN


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trials of a cart whose ground has less friction than believed."""
    rng = np.random.default_rng(2)
    amplitude, phase = rng.uniform(0.3, 1.2, 24), rng.uniform(0, 3, 24)
    real = mujoco.MjModel.from_xml_string(XML.replace('friction="0.6"', 'friction="0.25"'))
    fitness = [plain(real, a, p) for a, p in zip(amplitude, phase, strict=True)]
    columns = {"amplitude/tail": amplitude, "phase/tail": phase, "fitness": fitness}
    folder = tmp_path_factory.mktemp("made") / "cart"
    save_fitness(folder, XML, ABOUT, columns)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """Those trials, which a test may change."""
    return shutil.copytree(made, tmp_path / "cart")


@pytest.fixture(scope="module")
def found(made: Path) -> Diagnosis:
    return identify_fitness(load_fitness(made), CHOSEN)


def test_a_table_of_trials(folder: Path) -> None:
    table = load_fitness(folder)
    raw = pl.read_csv(folder / "trials.csv")
    np.testing.assert_array_equal(table.amplitude[:, 0], raw["amplitude/tail"])
    np.testing.assert_array_equal(table.fitness, raw["fitness"])
    assert table.test.tolist() == [False] * 18 + [True] * 6
    assert table.commands(np.array([0.1])).shape == (24, 1, 1)
    refuse_errors(preflight_fitness(table))
    renamed = raw.rename({"amplitude/tail": "a_1", "phase/tail": "phi_1"})
    renamed.with_columns(pl.lit(0.1).alias("offset/tail")).write_csv(folder / "trials.csv")
    again = load_fitness(folder)
    np.testing.assert_array_equal(again.amplitude, table.amplitude)
    np.testing.assert_allclose(again.commands(np.array([0.1])), table.commands(np.array([0.1])) + 0.1)


def test_failed_trials_are_left_out(folder: Path) -> None:
    raw = pl.read_csv(folder / "trials.csv")
    fitness = raw["fitness"].to_list()
    fitness[3] = None
    raw.with_columns(pl.Series("fitness", fitness)).write_csv(folder / "trials.csv")
    assert len(load_fitness(folder).fitness) == 23


def test_fitness_against_a_loop(folder: Path) -> None:
    trials, table = TrialSimulator(load_fitness(folder)), load_fitness(folder)
    rows = np.arange(5)
    model = mujoco.MjModel.from_xml_string(XML)
    expected = [plain(model, table.amplitude[k, 0], table.phase[k, 0]) for k in rows]
    np.testing.assert_allclose(trials.fitness([World.of(model)], rows)[0], expected, atol=1e-6)
    slippery = {c.name: c for c in candidates(MODEL, Scales.of(MODEL), EFFECTS)}["ground_friction@world"]
    world = slippery.apply(World.of(MODEL), [0.25])
    np.testing.assert_allclose(trials.fitness([world], rows)[0], table.fitness[:5], atol=1e-6)


CHOSEN = [e for e in EFFECTS if e.name in ("ground_friction", "viscous_damping", "payload", "actuator_gain")]


def test_a_large_effect_is_found(made: Path, found: Diagnosis) -> None:
    table = load_fitness(made)
    assert found.verdict == "effect"
    assert found.effects[0].effect == "ground_friction"
    assert found.effects[0].parameters["coefficient"].value == pytest.approx(0.25, rel=0.25)
    assert found.misfit.after < 0.5 * found.misfit.before
    assert found.ranking[0].margin == 0
    assert len(found.ranking) == len(candidates(MODEL, TrialSimulator(table).scales(np.arange(3)), CHOSEN))
    assert expected_steps(table, CHOSEN) == pytest.approx(found.steps, rel=0.5)


def test_responses_can_be_reused_for_another_reality(made: Path, found: Diagnosis) -> None:
    """Responses do not depend on measured fitness: a search with given responses is the same, at less cost."""
    table = load_fitness(made)
    trials = TrialSimulator(table)
    rows = np.arange(16)
    own = trials.fitness([World.of(MODEL)], rows)[0]
    step = screening_timestep(trials, rows, own, table.fitness[rows] - own)
    responses = simulate_candidates(trials, candidates(MODEL, trials.scales(np.arange(3)), CHOSEN), rows, step)
    again = identify_fitness(table, CHOSEN, responses=responses)
    np.testing.assert_equal(*([dataclasses.asdict(row) for row in d.ranking] for d in (again, found)))
    assert again.steps < 0.9 * found.steps


def test_responses_against_single_simulations(folder: Path) -> None:
    trials = TrialSimulator(load_fitness(folder))
    rows = np.arange(3)
    slippery = {c.name: c for c in candidates(MODEL, Scales.of(MODEL), EFFECTS)}["ground_friction@world"]
    responses = simulate_candidates(trials, [slippery], rows, 0.002)
    world = slippery.apply(World.of(MODEL), slippery.null + responses.tried[0][0])
    expected = trials.fitness([world], rows)[0] - trials.fitness([World.of(MODEL)], rows)[0]
    np.testing.assert_array_equal(responses.change[0][0], expected)
    assert responses.tried[0].shape == (1, 1)
    assert responses.tried[0][0, 0] == pytest.approx(8 * slippery.parameters[0].step)


def test_ranking_is_a_fit_within_bounds(rng: np.random.Generator) -> None:
    both = [c for c in candidates(MODEL, Scales.of(MODEL), EFFECTS) if c.effect.name in ("dry_friction", "payload")]
    friction = next(c for c in both if c.effect.name == "dry_friction")
    other = next(c for c in both if c.effect.name == "payload")
    step = friction.parameters[0].step
    change = rng.normal(size=(2, 12))
    tried = (0.1 * np.eye(len(other.parameters))[:1], np.array([[step]]))
    responses = CandidateResponses(
        (other, friction), np.arange(12), 0.002, np.zeros(12), tried, (change[:1], change[1:])
    )
    first, second = rank_by_fit(responses, 3.0 * change[1])
    assert (first.candidate, first.explained) == (friction, pytest.approx(1.0))
    assert first.values[0] == pytest.approx(3.0 * step)
    assert second.explained < 0.6
    against = next(lead for lead in rank_by_fit(responses, -3.0 * change[1]) if lead.candidate is friction)
    assert against.values[0] == friction.parameters[0].low  # friction is never negative
    assert against.explained <= 0


def test_vectors_are_simulated_in_both_directions(folder: Path, rng: np.random.Generator) -> None:
    """Responses in both directions are independent: the fit uses the simulated one, not the negative of the other."""
    slope = {c.name: c for c in candidates(MODEL, Scales.of(MODEL), EFFECTS)}["ground_slope@world"]
    rows = np.arange(2)
    responses = simulate_candidates(TrialSimulator(load_fitness(folder)), [slope], rows, 0.002)
    step = 4 * slope.parameters[0].step
    np.testing.assert_allclose(responses.tried[0], step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    ahead, behind, left, right = change = rng.uniform(0.0, 1.0, (4, 12))
    responses = CandidateResponses((slope,), np.arange(12), 0.002, np.zeros(12), responses.tried, (change,))
    (lead,) = rank_by_fit(responses, 1.5 * behind + 0.5 * left)
    np.testing.assert_allclose(lead.values, [-1.5 * step, 0.5 * step])
    assert lead.explained == pytest.approx(1.0)
    assert rank_by_fit(responses, -ahead - right)[0].explained <= 0


def test_the_error_of_the_screening_time_step_is_bounded(folder: Path) -> None:
    trials = TrialSimulator(load_fitness(folder))
    rows = np.arange(6)
    own = trials.fitness([World.of(MODEL)], rows)[0]
    error = np.abs(trials.fitness([World.of(MODEL)], rows, 0.008)[0] - own).mean()
    assert screening_timestep(trials, rows, own, np.full(6, 2.1 * error)) == pytest.approx(0.008)
    assert screening_timestep(trials, rows, own, np.full(6, 1.9 * error)) < 0.008
    assert screening_timestep(trials, rows, own, np.zeros(6)) == pytest.approx(0.002)


def test_nothing_is_named_where_nothing_is_missing(folder: Path) -> None:
    table = load_fitness(folder)
    fitness = [plain(MODEL, a, p) for a, p in zip(table.amplitude[:, 0], table.phase[:, 0], strict=True)]
    noise = np.random.default_rng(1).normal(0, 0.02 * np.std(fitness), 24)
    columns = {"amplitude/tail": table.amplitude[:, 0], "phase/tail": table.phase[:, 0], "fitness": fitness + noise}
    save_fitness(folder, XML, ABOUT, columns)
    chosen = [e for e in EFFECTS if e.name in ("ground_friction", "viscous_damping")]
    assert identify_fitness(load_fitness(folder), chosen).verdict == "none"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('body = "cart"', 'body = "card"', r"no body 'card'; nearest: 'cart'"),
        ('"distance"', '"energy_per_metre"', r"expected one of distance, forward_speed"),
        ("omega = 25.0", "omega = 0.0", r"omega = 0\.0: expected a positive number"),
        ("trials.csv", "trial.csv", r"there is no file .*trial\.csv"),
        ("[fitness]", "[fitnes]", r"'fitnes'; did you mean 'fitness'"),
    ],
)
def test_bad_settings(folder: Path, old: str, new: str, message: str) -> None:
    file = folder / "dataset.toml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        load_fitness(folder)


def test_bad_tables(folder: Path) -> None:
    raw = pl.read_csv(folder / "trials.csv")
    raw.drop("phase/tail").write_csv(folder / "trials.csv")
    with pytest.raises(InputError, match=r"no column 'phase/tail'"):
        load_fitness(folder)
    raw.head(8).write_csv(folder / "trials.csv")
    with pytest.raises(InputError, match=r"6 trials to fit and 2 held out; expected at least 4"):
        load_fitness(folder)
    raw.with_columns(pl.lit(0.5).alias("fitness")).write_csv(folder / "trials.csv")
    with pytest.raises(InputError, match=r"every trial has the same fitness"):
        refuse_errors(preflight_fitness(load_fitness(folder)))


def test_hidden_trials(tmp_path: Path) -> None:
    truth = make_fitness_case(
        tmp_path, 3, "quadruped", FitnessCaseSettings(effects=["ground_slope"], trials=(5, 4), duration=0.1)
    )
    table = load_fitness(tmp_path)
    assert truth.effects[0].effect == "ground_slope"
    assert (table.test.sum(), len(table.fitness)) == (4, 9)
    assert (table.fitness > 0).all()
    with pytest.raises(InputError, match="bolted down"):
        make_fitness_case(tmp_path, 3, "arm")
