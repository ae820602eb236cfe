"""Errors drawn larger than they are."""

import mujoco
import numpy as np
import pytest
from robot_logs import FLOATER

from btr_mjx.errors import InputError
from btr_mjx.replays import Replay, ReplayedMotion, draw_film, film, magnified
from btr_mjx.replays.film import GAP, LABEL, picture_height


def errors_of(replay: Replay) -> np.ndarray:
    """(F, nv) difference of the second motion from the first, by MuJoCo."""
    truth, other = replay.motions
    out = np.empty((len(replay.times), truth.model.nv))
    for row, a, b in zip(out, truth.qpos, other.qpos, strict=True):
        mujoco.mj_differentiatePos(truth.model, row, 1.0, a, b)
    return out


@pytest.fixture
def replay(rng: np.random.Generator) -> Replay:
    """A trunk that turns in any direction, and a simulation that is nearly the same."""
    model = mujoco.MjModel.from_xml_string(FLOATER)
    truth = rng.normal(size=(6, model.nq))
    truth[:, 3:7] /= np.linalg.norm(truth[:, 3:7], axis=1, keepdims=True)
    near = truth.copy()
    for row in near:
        mujoco.mj_integratePos(model, row, 0.05 * rng.normal(size=model.nv), 1.0)
    motions = [ReplayedMotion("recording", "", "", model, truth, measured=True)]
    return Replay(np.arange(6.0), [[*motions, ReplayedMotion("believed model", "as it is", "", model, near)]])


@pytest.mark.parametrize("factor", [1, 2.5, 10])
def test_the_error_is_as_many_times_larger(replay: Replay, factor: float) -> None:
    shown = magnified(replay, factor)
    np.testing.assert_array_equal(shown.motions[0].qpos, replay.motions[0].qpos)
    np.testing.assert_allclose(errors_of(shown), factor * errors_of(replay), atol=1e-9)
    if factor == 1:
        np.testing.assert_array_equal(shown.motions[1].qpos, replay.motions[1].qpos)
    assert ("×" in shown.motions[1].detail) == (factor != 1)


def test_without_a_measured_motion_there_is_no_error(replay: Replay) -> None:
    alone = Replay(replay.times, [replay.rows[0][1:]])
    assert magnified(alone, 1) is alone
    with pytest.raises(InputError, match="--magnify 3"):
        magnified(alone, 3)


def test_the_measured_motion_is_drawn_over_the_simulated_one(replay: Replay, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(motions: list, width: int, height: int, *_: object) -> list[np.ndarray]:
        return [np.full((len(qpos), height, width, 3), 200 - 100 * k, np.uint8) for k, (_, qpos) in enumerate(motions)]

    monkeypatch.setattr(film, "render", plain)
    middle = LABEL + picture_height(120) // 2
    for overlay, expected in ((False, (200, 100)), (True, (200, 150))):
        frames = draw_film(replay, 120, overlay=overlay)
        assert frames is not None
        assert (frames[0, middle, 60, 0], frames[0, middle, 120 + GAP + 60, 0]) == expected
