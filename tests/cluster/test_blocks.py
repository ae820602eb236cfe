"""Blocks of pairs in one process: the same numbers as `evaluate`, kept, read again, and computed again if damaged."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_robots import hopper

from btr_mjx.cluster import BlockSettings, evaluate_blocks, iterate_blocks
from btr_mjx.cluster.blocks import tiles
from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS, EngineSettings, FitnessFunction, evaluate
from btr_mjx.robots import Robot


@pytest.fixture(scope="module")
def pairs() -> tuple[Robot, np.ndarray, np.ndarray]:
    robot, rng = hopper(), np.random.default_rng(3)
    return robot, robot.simulation_box.sample(rng, 7), robot.controller_box.sample(rng, 5)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 300))
def test_tiles_cover_the_table_once(rows: int, columns: int, size: int) -> None:
    count = np.zeros((rows, columns), int)
    for place in tiles(rows, columns, size):
        count[place] += 1
        assert count[place].size <= size
    assert (count == 1).all()


def test_tiles_are_nearly_square() -> None:
    assert len(list(tiles(1000, 1000, 4096))) == 256  # 16 x 16 of 64 x 64
    assert len(list(tiles(100_000, 15, 4096))) == 367  # 15 wide, 273 tall


@pytest.mark.parametrize("engine", ["native", "lanes"])
@pytest.mark.parametrize("size", [1, 6, 4096])
def test_blocks_equal_evaluate(pairs, engine, size) -> None:
    robot, s, c = pairs
    whole = evaluate(robot, s, c, engine=engine)
    table = evaluate_blocks(robot, s, c, engine=engine, blocks=BlockSettings(size=size))
    np.testing.assert_array_equal(table.fitness, whole.fitness)
    np.testing.assert_array_equal(table.diverged, whole.diverged)
    np.testing.assert_array_equal(table.solver_capped, whole.solver_capped)
    assert table.engine == engine


def test_diverged_pairs_stay_marked(pairs, tmp_path: Path) -> None:
    robot, s, c = pairs
    speeds = evaluate(robot, s, c, engine="native").peak_speed
    limited = Robot(**{**vars(robot), "speed_limit": float(np.median(speeds))})
    whole = evaluate(limited, s, c, engine="native")
    assert 0 < whole.diverged.sum() < whole.diverged.size
    for _ in range(2):  # computed, then read
        table = evaluate_blocks(limited, s, c, engine="native", blocks=BlockSettings(tmp_path, 6))
        np.testing.assert_array_equal(table.fitness, whole.fitness)
        np.testing.assert_array_equal(table.diverged, whole.diverged)


def counted() -> tuple[FitnessFunction, list[int]]:
    """The hopper's fitness, and a list that grows by the size of each computed block."""
    calls: list[int] = []

    def function(outcome):
        values = FITNESS_FUNCTIONS["distance"](outcome)
        calls.append(values.size)
        return values

    return FitnessFunction("counted", "m/s", True, function), calls


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_what_is_there_is_not_computed_again(pairs, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    robot, s, c = pairs
    folder = tmp_path / "blocks"
    first = list(iterate_blocks(robot, s, c, engine="native", blocks=BlockSettings(folder, 6)))
    saved = files(folder)
    assert {f"{block.name}.npz" for block in first} == set(saved)
    lost, damaged, renamed, other = sorted(folder.iterdir())[:4]
    lost.unlink()
    damaged.write_bytes(saved[damaged.name][:-90] + b"x" + saved[damaged.name][-89:])
    renamed.write_bytes(saved[other.name])
    steps: list[int] = []
    again = list(iterate_blocks(robot, s, c, engine="native", blocks=BlockSettings(folder, 6), progress=steps.append))
    assert files(folder) == saved
    assert sum(steps) == 35
    assert {b.name for b in again[-3:]} == {path.stem for path in (lost, damaged, renamed)}  # the others were read
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2
    assert all("computed again" in line for line in lines)
    assert any(damaged.name in line for line in lines)
    assert any(renamed.name in line for line in lines)


def test_a_stopped_evaluation_goes_on(pairs, tmp_path: Path) -> None:
    robot, s, c = pairs
    fitness, calls = counted()
    options = {"engine": "native", "fitness": fitness, "blocks": BlockSettings(tmp_path, 6)}
    running = iterate_blocks(robot, s, c, **options)
    for _ in range(3):
        next(running)
    running.close()
    done, number = sum(calls), len(list(tmp_path.iterdir()))
    assert number == 3
    calls.clear()
    table = evaluate_blocks(robot, s, c, **options)
    assert done + sum(calls) == 35
    np.testing.assert_array_equal(table.fitness, evaluate(robot, s, c, engine="native").fitness)
    grown = np.concatenate([s, s[:2] * 0.99 + 0.01 * s[2:4]])
    calls.clear()
    evaluate_blocks(robot, grown, c, **options)
    assert sum(calls) < grown[:, 0].size * 5  # whole blocks of the smaller table are found again


def test_blocks_of_other_content_have_other_names(pairs, tmp_path: Path) -> None:
    robot, s, c = pairs
    slow = EngineSettings(timestep=0.002)
    other = Robot(**{**vars(robot), "template": robot.template.replace("0.7", "0.6")})
    for changed, settings in ((robot, EngineSettings()), (other, EngineSettings()), (robot, slow)):
        evaluate_blocks(changed, s, c, engine="native", settings=settings, blocks=BlockSettings(tmp_path))
    assert len(list(tmp_path.iterdir())) == 3
    evaluate_blocks(robot, s, c, engine="native", settings=EngineSettings(threads=1), blocks=BlockSettings(tmp_path))
    assert len(list(tmp_path.iterdir())) == 3


def test_bad_input(pairs) -> None:
    robot, s, c = pairs
    with pytest.raises(InputError, match="size 0"):
        BlockSettings(size=0)
    with pytest.raises(InputError, match="local:N"):
        BlockSettings(cluster="slurm")
    with pytest.raises(InputError, match="simulations"):
        evaluate_blocks(robot, s[:, :2], c)
