"""Coverage of activity by windows: against exhaustive search, and for an arm that moves once."""

import itertools

import mujoco
import numpy as np
import pytest
from gap_arm import SIGMA, dataset, recording

from btr_mjx.gap.data import Recording
from btr_mjx.gap.simulate import Counter
from btr_mjx.gap.windows import Span, prepare, rows
from btr_mjx.gap.windows.coverage import activity, activity_weights, greedy_cover
from btr_mjx.gap.windows.impacts import contact_samples
from btr_mjx.gap.windows.placement import place_windows


def worth(shares: np.ndarray, weight: np.ndarray, chosen: np.ndarray) -> float:
    scaled = weight * shares / shares.max(0)
    return float(sum(np.sqrt(sum(scaled[i, f] for i in chosen)) for f in range(scaled.shape[1])))


@pytest.mark.parametrize("seed", range(8))
def test_greedy_cover_is_near_optimal(seed):
    """Greedy maximisation of a submodular function reaches 1 - 1/e (Nemhauser, Wolsey and Fisher, 1978)."""
    rng = np.random.default_rng(seed)
    shares, weight = rng.gamma(0.3, size=(9, 5)), rng.uniform(0.1, 2.0, 5)
    chosen = greedy_cover(shares, weight, np.zeros(9, int), 4)
    assert len(set(chosen.tolist())) == 4
    found = worth(shares, weight, chosen)
    best = max(worth(shares, weight, np.array(c)) for c in itertools.combinations(range(9), 4))
    assert (1 - 1 / np.e) * best <= found <= best + 1e-12
    steps = [worth(shares, weight, chosen[: n + 1]) for n in range(4)]
    every = [
        max(worth(shares, weight, np.append(chosen[:n], i)) for i in range(9) if i not in chosen[:n]) for n in range(4)
    ]
    np.testing.assert_allclose(steps, every)  # no other window has a larger gain


def test_rare_features_and_all_groups_are_covered():
    shares = np.ones((40, 3)) * [1.0, 1.0, 0.0]
    shares[17, 2] = 1e-3
    group = np.repeat([0, 1, 2, 3], 10)
    chosen = greedy_cover(shares, np.ones(3), group, 8)
    assert 17 in chosen
    assert set(group[chosen]) == {0, 1, 2, 3}
    assert len(greedy_cover(shares, np.ones(3), group, 2)) == 4


BALL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body pos="0 0 0.1"><joint name="height" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><motor joint="height"/></actuator>
</mujoco>
"""


def bouncing() -> Recording:
    """A ball in contact with the ground half of the time."""
    time = np.arange(0, 1, 0.005)
    qpos, qvel = 0.01 * np.sin(20 * time), 0.2 * np.cos(20 * time)
    model = mujoco.MjModel.from_xml_string(BALL)
    return Recording("ball", time, np.cos(time)[:, None], qpos[:, None], qvel[:, None], np.ones(1, bool), "fit", model)


@pytest.mark.parametrize("touching", [False, True])
def test_activity_equals_mj_forward_at_each_sample(touching):
    one = bouncing() if touching else recording("r", seed=1)
    made = prepare([one], SIGMA[: 2 * one.model.nv], Span(5, 6))
    counter = Counter()
    (found,) = activity(made, counter)
    (own,) = made.recordings
    assert counter.steps == len(own.time)
    data, nv = mujoco.MjData(own.model), own.model.nv
    for i in range(0, len(own.time), 20):
        data.qpos[:], data.qvel[:], data.ctrl[:] = own.qpos[i], own.qvel[i], own.ctrl[i]
        mujoco.mj_forward(own.model, data)
        touch = np.abs(data.qfrc_constraint) > 0
        expected = [*data.qvel**2, *data.qfrc_actuator**2, *touch, not touch.any()]
        np.testing.assert_allclose(found[i], np.array(expected, float), rtol=1e-9, atol=1e-12)
    assert activity_weights(nv).shape == (found.shape[1],)
    assert 0.2 < found[:, -1].mean() < 0.8 if touching else found[:, -1].all()


def test_windows_cover_the_motion():
    """An arm at rest except for a short motion: the single window of a recording covers it."""
    made = dataset(fit=2, test=1)
    data = prepare(made.fit, SIGMA, Span(5, 6))
    _, every, k = place_windows(data, 0.1, 1e9, 10.0)
    busy = int(every[3])
    for track in data.tracks:
        track.qvel[:] = 0.0
        track.qvel[busy : busy + k] = 5.0
    for r in data.recordings:
        r.ctrl[:] = 0.0
    recording_of, first, _ = place_windows(data, 0.1, 0.0, 10.0)
    assert recording_of.tolist() == [0, 1]
    assert first.tolist() == [busy, busy]


def test_samples_are_evaluated_in_blocks_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by the blocks, and every sample has the same answer in a block of any size, bit for bit."""
    one = bouncing()
    driven = mujoco.MjSpec.from_string(BALL.replace("<motor ", '<intvelocity actrange="-9 9" kp="20" '))
    driven.actuators[0].actlimited = 0
    model = driven.compile()
    assert model.na == 1
    integrating = Recording("i", one.time, one.ctrl, one.qpos, one.qvel, one.qvel_measured, "fit", model)
    answers = []
    for most in (rows.MAX_BATCH, 7):
        monkeypatch.setattr(rows, "MAX_BATCH", most)
        made = prepare([one, integrating], SIGMA[:2], Span(5, 6))
        answers.append((*made.acts, *activity(made, Counter()), *contact_samples(made, Counter())))
    assert answers[0][3].any()
    assert np.ptp(answers[0][1]) > 0
    for whole, blocks in zip(*answers, strict=True):
        np.testing.assert_array_equal(whole, blocks)
