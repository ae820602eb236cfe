"""Cases of `diagnose --demo`: what they hide is in the data that they write, and the seed decides it."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from btr_mjx.demo import cases as demo_cases
from btr_mjx.demo import demo_robot, make_demo, make_fitness_demo
from btr_mjx.errors import InputError
from btr_mjx.gap.data import load, noise_of
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.fitness_only import load_fitness
from btr_mjx.gap.simulate import Command, Segments, World, simulate


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_cases, "_FIT", 1)
    monkeypatch.setattr(demo_cases, "_TEST", 1)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("robot", ["pendulum", "arm"])
def test_the_hidden_effect_brings_the_believed_model_to_the_recordings(robot: str, tmp_path: Path) -> None:
    """The believed model with what the truth says is many times closer to a recording than without it."""
    truth = make_demo(tmp_path, 4, robot)
    dataset = load(tmp_path)
    assert (len(dataset.fit), len(dataset.test)) == (1, 1)
    (effect,) = truth["effects"]
    model, recording = dataset.model, dataset.recordings[0]
    named = {c.name: c for c in candidates(model, Scales.of(model), EFFECTS)}
    mended = named[f"{effect['effect']}@{effect['location']}"].apply(
        World.of(model), list(effect["parameters"].values())
    )
    command = Command(recording.time, recording.ctrl, "cubic")
    start = recording.qpos[:1] * 0, recording.qvel[:1] * 0
    segments = Segments(np.zeros(1), *start, recording.time, (command,), np.zeros(1, int))
    believed, named_only = (
        states[0, :, : model.nq] - recording.qpos
        for states in simulate([(World.of(model), segments), (mended, segments)], timestep=1e-4)
    )
    assert np.mean(named_only**2) < 0.1 * np.mean(believed**2)
    sigma = demo_robot(robot).sigma(model)
    np.testing.assert_allclose(noise_of(dataset).qpos, sigma[0], rtol=0.15)
    np.testing.assert_allclose(noise_of(dataset).qvel, sigma[1], rtol=0.15)


@pytest.mark.usefixtures("small")
def test_the_seed_decides(tmp_path: Path) -> None:
    def case(name: str, seed: int) -> tuple[object, bytes]:
        truth = make_demo(tmp_path / name, seed, "pendulum")
        return truth, (tmp_path / name / "behaviour_01.npz").read_bytes()

    first = case("a", 3)
    assert case("b", 3) == first
    assert case("c", 4)[1] != first[1]


def test_a_table_of_trials_is_read_and_differs_from_the_believed_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same trials of the believed model by a loop over `mj_step`."""
    monkeypatch.setattr(demo_cases, "_TRIALS", (4, 4))
    truth = make_fitness_demo(tmp_path, 1, "quadruped")
    table = load_fitness(tmp_path)
    assert len(truth["effects"]) == 1
    assert table.test.sum() == 4
    model, believed = table.head.model, []
    times = np.arange(0, table.duration, model.opt.timestep)
    for command in table.commands(times):
        data = mujoco.MjData(model)
        for ctrl in command:
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)
        believed.append(np.linalg.norm(data.qpos[:2]) / table.duration)
    apart = np.abs(believed - table.fitness)
    assert 1e-3 < apart.mean() < 0.5
    with pytest.raises(InputError, match="bolted down"):
        make_fitness_demo(tmp_path, 1, "arm")
    with pytest.raises(InputError, match="robot 'dog': expected one of hexapod"):
        make_fitness_demo(tmp_path, 1, "dog")
