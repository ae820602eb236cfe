"""evaluate() on its fast engine: Theorems 1 and 2 to the bit, shapes, errors."""

import dataclasses
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from btr_mjx.backtoreality import along
from btr_mjx.errors import InputError
from btr_mjx.evaluation import EngineSettings, evaluate, fastest_engine, fitness
from btr_mjx.models import compile_models, model_batch
from btr_mjx.robots import Robot
from btr_mjx.runs import available_cores

THROWER = Path(__file__).parents[2] / "examples/thrower/robot.toml"


def test_theorems_1_and_2_wherever_a_pair_stands(robot: Robot) -> None:
    """1000 random pairs, in two batches of other order and other neighbours: delta_k is 0.0, not merely small."""
    rng = np.random.default_rng(11)
    s, c = robot.simulation_box.sample(rng, 1000), robot.controller_box.sample(rng, 1000)
    f_r = evaluate(robot, s, c, pairwise=True).fitness
    assert np.isfinite(f_r).all()
    assert len(np.unique(f_r)) > 900  # pairs differ, so that equal results mean something
    order = rng.permutation(1000)
    strangers = robot.simulation_box.sample(rng, 77), robot.controller_box.sample(rng, 77)
    again = evaluate(
        robot,
        np.concatenate([strangers[0], s[order]]),
        np.concatenate([strangers[1], c[order]]),
        pairwise=True,
    ).fitness[77:]
    assert (fitness.delta_of(again, f_r[order]) == 0.0).all()  # Theorem 1
    assert fitness.delta_fitness_of(again, f_r[order]) == 0.0  # Theorem 2


def test_all_pairs_equal_pairwise(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 3), robot.controller_box.sample(rng, 4)
    grid = evaluate(robot, s, c)
    assert grid.fitness.shape == grid.diverged.shape == grid.solver_capped.shape == (3, 4)
    assert grid.outcome.position.shape == (3, 4, 1, 3)
    rows = evaluate(robot, np.repeat(s, 4, 0), np.tile(c, (3, 1)), pairwise=True)
    np.testing.assert_array_equal(grid.fitness.ravel(), rows.fitness)
    np.testing.assert_array_equal(grid.outcome.energy.reshape(12, 1), rows.outcome.energy)


def test_blocks_and_progress(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 5), robot.controller_box.sample(rng, 9)
    seen: list[int] = []
    small = evaluate(robot, s, c, engine="native", settings=EngineSettings(chunk=7), progress=seen.append)
    np.testing.assert_array_equal(small.fitness, evaluate(robot, s, c, engine="native").fitness)
    assert sum(seen) == 45
    assert len(seen) == 7


def test_fastest_engine_agrees_with_native(robot: Robot, rng: np.random.Generator) -> None:
    s, c = robot.simulation_box.sample(rng, 8), robot.controller_box.sample(rng, 8)
    fast, exact = evaluate(robot, s, c), evaluate(robot, s, c, engine="native")
    assert fast.engine == fastest_engine(robot)
    np.testing.assert_allclose(fast.fitness, exact.fitness, rtol=0, atol=1e-3)


def test_another_engine_than_lanes_is_told_once_with_its_reason(
    robot: Robot, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    template = robot.template.replace("implicitfast", "implicit")
    own, c = dataclasses.replace(robot, template=template), robot.controller_box.sample(rng, 2)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert evaluate(own, robot.nominal, c, times=[0.01]).engine == "native"
    reason = "the lanes engine does not compute opt.integrator mjINT_IMPLICIT"
    assert [record.getMessage() for record in caplog.records] == [f"native: {reason}"]


def test_samples_on_the_way(robot: Robot, rng: np.random.Generator) -> None:
    c = robot.controller_box.sample(rng, 2)
    result = evaluate(robot, [robot.nominal], c, times=[0.01, 0.02, 0.03], engine="native", states=True)
    np.testing.assert_allclose(result.outcome.times, [0.01, 0.02, 0.03])
    assert result.outcome.qpos.shape == (1, 2, 3, 25)
    early = evaluate(dataclasses.replace(robot, duration=0.01), [robot.nominal], c, engine="native")
    np.testing.assert_array_equal(early.outcome.position[:, :, 0], result.outcome.position[:, :, 0])


def test_other_fitness_functions(robot: Robot, rng: np.random.Generator) -> None:
    c = robot.controller_box.sample(rng, 3)
    mine = fitness.FitnessFunction("height", "m", True, lambda o: o.position[..., -1, 2])
    result = evaluate(robot, [robot.nominal], c, engine="native", fitness=mine)
    np.testing.assert_array_equal(result.fitness, result.outcome.position[..., -1, 2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"simulations": [[0.64] * 11]}, r"simulations: got shape \(1, 11\)"),
        ({"simulations": [[0.3] + [0.64] * 11]}, r"0\.3.*bl_3"),
        ({"controllers": [[np.nan] * 36]}, r"nan.*a_1"),
        ({"simulations": np.full((2, 12), 0.64), "pairwise": True}, "2 simulations and 3 controllers"),
        ({"engine": "warp"}, r"warp.*lanes, mjx, native"),
        ({"times": [0.02, 0.01]}, "ascending"),
        ({"times": [0.02, 1.0]}, "at most the trial's duration"),
        ({"times": []}, "ascending"),
        ({"settings": EngineSettings(timestep=1e-4), "engine": "mjx"}, "engine='native'"),
        ({"simulations": np.zeros((0, 12))}, "non-empty"),
    ],
)
def test_bad_input(robot: Robot, arguments: dict, message: str) -> None:
    good = {"simulations": [robot.nominal], "controllers": np.tile(robot.controller_box.low, (3, 1))}
    with pytest.raises(ValueError, match=message):
        evaluate(robot, **(good | arguments))


def test_a_file_is_no_robot() -> None:
    for evaluated in (evaluate, along):
        with pytest.raises(InputError, match=r"got 'robot\.toml', expected a Robot; load_robot"):
            evaluated("robot.toml", [], [])  # type: ignore[operator]


def test_base_body_must_move_freely(robot: Robot) -> None:
    c = robot.controller_box.low[None]
    for name, message in (("b3", "with a free joint; nearest: 'b0'"), ("trunk", "nearest: 'b0'")):
        with pytest.raises(InputError, match=message):
            evaluate(dataclasses.replace(robot, base_body=name), [robot.nominal], c, engine="native")


def test_equal_simulations_are_prepared_once(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """What makes 10,000 pairs of a few morphologies cheap to prepare."""
    s = robot.simulation_box.sample(np.random.default_rng(99), 2)
    texts, compiler = [], model_batch.compile_mjcf
    monkeypatch.setattr(model_batch, "compile_mjcf", lambda robot, text: texts.append(text) or compiler(robot, text))
    models = compile_models(robot, np.repeat(s, 500, 0))
    assert sorted(texts) == sorted(robot.render(row) for row in s)
    assert len(models) == 1000


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit"])
def test_choosing_an_engine_leaves_all_cores_to_programs(integrator: str) -> None:
    """JAX fixes its devices when it is first asked for its backend: with lanes, and where lanes refuses the robot."""
    lines = (
        "import dataclasses, jax",
        "from btr_mjx.evaluation import fastest_engine",
        "from btr_mjx.models import load_robot",
        f"robot = load_robot({str(THROWER)!r})",
        f"template = robot.template.replace('implicitfast', {integrator!r})",
        "fastest_engine(dataclasses.replace(robot, template=template))",
        "print(jax.device_count())",
    )
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == [str(available_cores())], done.stderr
