"""Whoever names no fitness gets the robot's own: every public function, method and field that takes a fitness."""

import ast
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_robots import hopper

import btr_mjx as btr
from btr_mjx.backtoreality import FolderReality, SearchSettings, evolve_controllers
from btr_mjx.cluster import evaluate_blocks, iterate_blocks
from btr_mjx.errors import InputError
from btr_mjx.evaluation import FITNESS_FUNCTIONS, evaluate
from btr_mjx.gap.data.writing import recording_columns
from btr_mjx.robots import Robot

BACKWARDS = """
import numpy as np

def backwards(outcome):
    return outcome.start[..., 0] - outcome.qpos[..., -1, 0] - 1.0
"""


@pytest.fixture(scope="module", params=["forward_speed", "target_distance", "FILE.py:backwards"])
def own(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A robot whose fitness is not the distance, whose sign or size differs from it for every controller below."""
    name = request.param
    if name.startswith("FILE"):
        file = tmp_path_factory.mktemp("own") / "fitness.py"
        file.write_text(BACKWARDS)
        name = f"{file}:backwards"
    return dataclasses.replace(hopper(), fitness=name, target=(0.0, 3.0, 0.1))


S, C = np.array([[0.3, 0.1, 800.0], [0.25, 0.09, 600.0]]), np.array([[0.9, 1.5], [0.4, 0.2], [0.8, 2.5]])


def by_hand(robot: Robot, s: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The robot's own fitness (L, M), from where it came."""
    outcome = evaluate(robot, s, c, engine="native").outcome
    return formula(robot, outcome.start, outcome.position[..., -1, :])


def formula(robot: Robot, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    if robot.fitness == "forward_speed":
        return (end - start)[..., 0] / robot.duration
    if robot.fitness == "target_distance":
        return np.linalg.norm(end - robot.target, axis=-1)
    return (start - end)[..., 0] - 1.0


Values = tuple[np.ndarray, np.ndarray]
"""What an entry point gives, and what it should be."""


def called_pair_fitness(robot: Robot, folder: Path) -> Values:
    leaves, fitness = btr.model_leaves(robot, S), jax.jit(btr.pair_fitness(robot))
    rows = [{name: leaf[i] for name, leaf in leaves.items()} for i in range(2)]
    return np.array([[fitness(row, jnp.asarray(c)) for c in C] for row in rows]), by_hand(robot, S, C)


def called_iterate_blocks(robot: Robot, folder: Path) -> Values:
    (block,) = iterate_blocks(robot, S, C, engine="native")
    return block.fitness, by_hand(robot, S, C)


def called_evolve_controllers(robot: Robot, folder: Path) -> Values:
    genomes, scores = evolve_controllers(robot, S[0], SearchSettings(4, 1), seed=0, engine="native")
    return scores, by_hand(robot, S[:1], robot.controller_box.with_bits(8).decode(genomes[0]))


def called_folder(robot: Robot, folder: Path) -> Values:
    """A recording is judged by the robot's own fitness."""
    (true,) = btr.SimulatedReality(robot, tuple(S[0]), recording_rate=1000.0).record(C[:1], [0])
    (folder / "measured").mkdir()
    np.savez(folder / "measured" / "trial-0.npz", **recording_columns(true))
    recorded = dataclasses.replace(robot, duration=float(true.time[-1] - true.time[0]))
    measured = FolderReality(recorded, folder).measure(C[:1], 0, (recorded.duration,))
    return measured, formula(recorded, true.qpos[0, :3], true.qpos[-1, :3])


CALLED: dict[str, Callable[[Robot, Path], Values]] = {
    "evaluate": lambda robot, folder: (evaluate(robot, S, C, engine="native").fitness, by_hand(robot, S, C)),
    "pair_fitness": called_pair_fitness,
    "evaluate_blocks": lambda robot, folder: (
        evaluate_blocks(robot, S, C, engine="native").fitness,
        by_hand(robot, S, C),
    ),
    "iterate_blocks": called_iterate_blocks,
    "evolve_controllers": called_evolve_controllers,
    "delta": lambda robot, folder: (
        btr.scan.delta(robot, S, C, [9.0, 9.0, 9.0], engine="native"),
        9.0 - by_hand(robot, S, C),
    ),
    "delta_fitness": lambda robot, folder: (
        btr.scan.delta_fitness(robot, S, C, [9.0, 9.0, 9.0], engine="native"),
        (9.0 - by_hand(robot, S, C)).mean(axis=1),
    ),
    "SimulatedReality": lambda robot, folder: (
        btr.SimulatedReality(robot, tuple(S[0]), "native").measure(C),
        by_hand(robot, S[:1], C),
    ),
    "FolderReality": called_folder,
}
"""Every public entry point with a fitness, called without one."""


@pytest.mark.parametrize("name", CALLED)
def test_the_default_is_the_robots_own(own: Robot, name: str, tmp_path: Path) -> None:
    got, expected = CALLED[name](own, tmp_path)
    np.testing.assert_allclose(np.ravel(got), np.ravel(expected), rtol=2e-3, atol=2e-4)


def test_the_own_fitness_is_no_distance(own: Robot) -> None:
    """Else the test above would not see the wrong default."""
    distance = FITNESS_FUNCTIONS["distance"](evaluate(own, S, C, engine="native").outcome)
    assert (np.abs(by_hand(own, S, C) - distance) > 1e-2).all()


def _defaults() -> Iterator[tuple[str, str]]:
    """Functions and classes of the package with a fitness that need not be given, and its default."""
    for path in Path(btr.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                given = node.args
                late = [*given.posonlyargs, *given.args][
                    len(given.posonlyargs) + len(given.args) - len(given.defaults) :
                ]
                pairs = [
                    *zip(late, given.defaults, strict=True),
                    *zip(given.kwonlyargs, given.kw_defaults, strict=True),
                ]
                named = [(one.arg, one.annotation, default) for one, default in pairs if default is not None]
            elif isinstance(node, ast.ClassDef):
                fields = (one for one in node.body if isinstance(one, ast.AnnAssign) and one.value is not None)
                named = [(ast.unparse(one.target), one.annotation, one.value) for one in fields]
            else:
                continue
            for name, annotation, default in named:
                kind = ast.unparse(annotation or ast.Constant("Fitness"))
                if "Fitness" in kind or (name == "fitness" and "str" in kind):
                    yield node.name, ast.unparse(default)


def test_every_default_is_tested() -> None:
    """A function that takes a fitness has either no default, or None, and is then among those called above."""
    defaults = dict(_defaults())
    assert defaults.pop("Robot") == "'distance'"  # the own fitness itself
    assert len(defaults) > 7
    assert set(defaults.values()) == {"None"}
    assert set(defaults) <= {*CALLED, "fitness_of", "RunSettings"}, "call the new one above without a fitness"


def test_no_fitness_of_a_point_inside_jax(own: Robot) -> None:
    """JAX functions know the base's position only: another point is refused rather than measured at the origin."""
    with pytest.raises(InputError, match=r"point 'tip'.*evaluate"):
        btr.pair_fitness(dataclasses.replace(own, point="tip", base_body=None))
