"""The Kalman filter and its smoother against the joint Gaussian distribution of all measurements of a stretch."""

from dataclasses import replace

import numpy as np
import pytest
from gap_forces import arm_stretches, moved_arm, shortened

from btr_mjx.gap.forces import kalman_filter
from btr_mjx.gap.forces.kalman_filter import Variances, filtered, smoothed
from btr_mjx.gap.forces.motion import Linearised

STRETCHES, INTERVALS, LASTING = 2, 7, 2
BLOCKS = 4


@pytest.fixture(scope="module", autouse=True)
def short_blocks():
    """Forces are unusual for two intervals."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kalman_filter, "LASTS", LASTING * 0.005)
        yield


@pytest.fixture(scope="module")
def linear() -> Linearised:
    """Any linear motion at uneven times; one of the velocities is not measured."""
    rng = np.random.default_rng(3)
    own = shortened(arm_stretches([moved_arm(f"r{i}", i) for i in range(2)]), STRETCHES, INTERVALS)
    assert own.time.shape == (STRETCHES, INTERVALS + 1)
    interval = rng.uniform(0.003, 0.007, (STRETCHES, INTERVALS))
    time = np.concatenate([np.zeros((STRETCHES, 1)), np.cumsum(interval, 1)], 1)
    sigma = np.array([1e-3, 2e-3, 0.02, 0.01])
    measured_q = own.qpos + 3e-3 * rng.standard_normal(own.qpos.shape)
    measured_v = own.qvel + 0.05 * rng.standard_normal(own.qvel.shape)
    own = replace(
        own,
        time=time,
        measured_q=measured_q,
        measured_v=measured_v,
        seen=np.array([True, True, True, False]),
        sigma=sigma,
    )
    shape = (STRETCHES, INTERVALS)
    transition = np.eye(4) + 0.2 * rng.standard_normal((*shape, 4, 4))
    force = rng.standard_normal((*shape, 4, 2)) * np.array([1e-3, 1e-3, 0.3, 0.3])[:, None]
    defect = rng.standard_normal((*shape, 4)) * np.array([1e-3, 1e-3, 0.02, 0.02])
    inertia = np.broadcast_to(np.eye(2), (*shape, 2, 2))
    return Linearised(own, defect, transition, inertia, force, np.zeros((*shape, 0, 4)), interval)


@pytest.fixture(scope="module")
def variances(linear: Linearised) -> Variances:
    rng = np.random.default_rng(4)
    weight = rng.uniform(0.2, 1.5, (STRETCHES, BLOCKS, 2))
    return Variances(linear.stretches.sigma**2, 4e-7, np.array([0.05, 0.2]), weight)


def starting_covariance(linear: Linearised, variances: Variances) -> np.ndarray:
    """Thirty standard deviations of a measurement; of a velocity, at least of a quotient of two positions."""
    sigma = np.sqrt(variances.sensor)
    quotient = np.minimum(sigma[:2] / linear.interval.mean(), linear.stretches.qvel.std((0, 1)))
    velocity = np.maximum(np.where(linear.stretches.seen[2:], sigma[2:], 0), quotient)
    return np.diag(np.concatenate([900 * sigma[:2] ** 2, 900 * velocity**2]))


class Joint:
    """The joint Gaussian distribution of states and measurements of one stretch, written out."""

    def __init__(self, linear: Linearised, variances: Variances, s: int, start: np.ndarray) -> None:
        count = INTERVALS + 1
        # Everything is a linear function of the starting state and of the forces.
        sources = 4 + 2 * INTERVALS
        of_state, covariance = np.zeros((count, 4, sources)), np.zeros((sources, sources))
        of_state[0, :, :4], covariance[:4, :4] = np.eye(4), start
        self.state = np.zeros((count, 4))
        for k in range(INTERVALS):
            force = slice(4 + 2 * k, 6 + 2 * k)
            of_state[k + 1] = linear.transition[s, k] @ of_state[k]
            of_state[k + 1, :, force] = linear.force[s, k]
            weight = np.ones(2) if variances.weight is None else variances.weight[s, k // LASTING]
            # The mean of white noise over an interval, whose mean over 10 ms has the variance that is given.
            covariance[force, force] = np.diag(variances.force * 0.01 / linear.interval[s, k] / weight)
            self.state[k + 1] = linear.transition[s, k] @ self.state[k] - linear.defect[s, k]
        own = linear.stretches
        seen = np.flatnonzero(own.seen)
        speed, rate = own.qvel[s], np.gradient(own.qvel[s], axis=0) / linear.interval.mean()
        noise = variances.sensor + variances.jitter * np.concatenate([speed, rate], 1) ** 2
        of_measured = of_state[:, seen].reshape(-1, sources)
        self.covariance = of_measured @ covariance @ of_measured.T + np.diag(noise[:, seen].ravel())
        every = np.concatenate([of_state.reshape(-1, sources), np.eye(sources)[4:]])
        self.across = every @ covariance @ of_measured.T
        measured = np.concatenate([own.measured_q[s] - own.qpos[s], own.measured_v[s] - own.qvel[s]], 1)
        self.residual = (measured - self.state)[:, seen].ravel()

    def loss(self) -> float:
        return float(self.residual @ np.linalg.solve(self.covariance, self.residual)) + self.log_determinant()

    def log_determinant(self) -> float:
        return float(np.linalg.slogdet(self.covariance)[1])


def driven(linear: Linearised, columns: np.ndarray) -> np.ndarray:
    """(S, N, C) responses of the measured values to numbers with such columns."""
    seen, out = np.flatnonzero(linear.stretches.seen), []
    for s in range(STRETCHES):
        state, own = np.zeros((4, columns.shape[-1])), []
        for k in range(INTERVALS + 1):
            own.append(state[seen])
            if k < INTERVALS:
                state = linear.transition[s, k] @ state + columns[s, k]
        out.append(np.concatenate(own))
    return np.stack(out)


def test_whitened_innovations_have_the_products_of_the_joint_distribution(linear, variances):
    columns = np.random.default_rng(5).standard_normal((STRETCHES, INTERVALS, 4, 3))
    for own in (variances, replace(variances, weight=None), replace(variances, jitter=0.0)):
        found = filtered(linear, columns, own)
        start, answer = starting_covariance(linear, own), driven(linear, columns)
        for s in range(STRETCHES):
            joint = Joint(linear, own, s, start)
            # Of what is left of the residual beside numbers: their responses come with a minus.
            every = np.concatenate([joint.residual[:, None], -answer[s]], 1)
            gram = every.T @ np.linalg.solve(joint.covariance, every)
            size = np.sqrt(np.diag(gram))
            np.testing.assert_allclose(found.gram[s] / size / size[:, None], gram / size / size[:, None], atol=1e-7)
            assert found.gram[s, 0, 0] == pytest.approx(gram[0, 0], rel=1e-7)
            assert found.log_determinant[s] == pytest.approx(joint.log_determinant(), abs=1e-7)
        loss = own.penalty + (found.gram[:, 0, 0] + found.log_determinant).sum()
        assert smoothed(linear, np.zeros_like(linear.defect), own).loss == pytest.approx(loss, rel=1e-12)
        assert found.count == 3 * (INTERVALS + 1)


def test_smoothed_states_and_forces_are_conditional_means(linear, variances):
    found = smoothed(linear, np.zeros_like(linear.defect), variances)
    start = starting_covariance(linear, variances)
    for s in range(STRETCHES):
        joint = Joint(linear, variances, s, start)
        gain = np.linalg.solve(joint.covariance, joint.across.T).T
        known, split = gain @ joint.residual, 4 * (INTERVALS + 1)
        mean, force = joint.state + known[:split].reshape(-1, 4), known[split:].reshape(-1, 2)
        for i in range(4):
            np.testing.assert_allclose(found.state[s, :, i], mean[:, i], atol=1e-7 * np.abs(mean[:, i]).max())
        np.testing.assert_allclose(found.force[s], force, atol=1e-7 * np.abs(force).max())


def test_a_fitted_effect_is_taken_off_before_smoothing(linear, variances):
    """An effect that fills the defect leaves a motion in which no force is missing."""
    effect = np.random.default_rng(6).standard_normal(linear.defect.shape) * 0.01
    found = smoothed(linear, effect, variances)
    other = smoothed(replace(linear, defect=linear.defect - effect), np.zeros_like(effect), variances)
    np.testing.assert_allclose(found.state, other.state, atol=1e-12)
    assert np.abs(found.state - smoothed(linear, 0 * effect, variances).state).max() > 1e-4


PLACES = ((0, 0, 0), (1, 2, 1), (0, 3, 1))


def slopes(linear: Linearised, variances: Variances, start: np.ndarray) -> dict[str, float]:
    """Derivatives of -2 ln p with respect to the logarithms of variances, of a starting state that is given."""

    def loss(own: Variances) -> float:
        return sum(Joint(linear, own, s, start).loss() for s in range(STRETCHES)) + own.penalty

    def slope(change) -> float:
        return (loss(change(np.exp(1e-4))) - loss(change(np.exp(-1e-4)))) / 2e-4

    def at(values: np.ndarray, index, factor: float) -> np.ndarray:
        out = values.copy()
        out[index] *= factor
        return out

    out = {"jitter": slope(lambda x: replace(variances, jitter=x * variances.jitter))}
    for i in (0, 1, 2):
        out[f"sensor {i}"] = slope(lambda x, i=i: replace(variances, sensor=at(variances.sensor, i, x)))
    for j in (0, 1):
        out[f"force {j}"] = slope(lambda x, j=j: replace(variances, force=at(variances.force, j, x)))
    for where in PLACES:
        if variances.weight is not None:
            out[f"weight {where}"] = slope(
                lambda x, where=where: replace(variances, weight=at(variances.weight, where, x))
            )
    return out


def factors(before: Variances, after: Variances) -> dict[str, float]:
    out = {"jitter": after.jitter / before.jitter}
    out |= {f"sensor {i}": after.sensor[i] / before.sensor[i] for i in (0, 1, 2)}
    out |= {f"force {j}": after.force[j] / before.force[j] for j in (0, 1)}
    if before.weight is not None and after.weight is not None:
        out |= {f"weight {where}": after.weight[where] / before.weight[where] for where in PLACES}
    return out


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_variances_move_to_where_the_likelihood_is_larger(linear, variances, scale):
    tried = 0
    for name in ("sensor", "jitter", "force"):
        own = replace(variances, **{name: scale * getattr(variances, name)})
        update = smoothed(linear, np.zeros_like(linear.defect), own).variances
        slope = slopes(linear, own, starting_covariance(linear, own))
        for key, factor in factors(own, update).items():
            if abs(slope[key]) > 0.1:
                assert (factor > 1) == (slope[key] < 0), (name, key, factor, slope[key])
                tried += 1
    assert tried > 12


def kept_but(name: str, before: Variances, after: Variances) -> Variances:
    """The variances before, but for one of them."""
    field, _, index = name.partition(" ")
    new = np.array(getattr(before, field), copy=True)
    new[int(index or 0) if index else ...] = np.array(getattr(after, field))[int(index) if index else ...]
    return replace(before, **{field: float(new) if field == "jitter" else new})


@pytest.mark.parametrize("name", ["sensor 0", "sensor 2", "jitter", "force 0", "force 1"])
def test_the_likelihood_is_largest_where_a_variance_stays(linear, variances, name):
    """One variance at a time, of sensors whose noise is so small that it does not stand for all others."""
    rng = np.random.default_rng(8)
    own = replace(
        linear, defect=linear.defect + (linear.force @ rng.standard_normal((STRETCHES, INTERVALS, 2, 1)))[..., 0]
    )
    known = replace(variances, sensor=0.05 * variances.sensor, jitter=0.05 * variances.jitter)
    for _ in range(150):
        before, known = known, kept_but(name, known, smoothed(own, np.zeros_like(own.defect), known).variances)
    found, start = factors(before, known)[name], starting_covariance(own, known)
    assert found == pytest.approx(1, abs=1e-4)
    assert abs(slopes(own, known, start)[name]) < 1e-2
    # It is a maximum: the slopes on both sides lead to it.
    for factor in (0.5, 2.0):
        away = kept_but(name, known, Variances(factor * known.sensor, factor * known.jitter, factor * known.force))
        assert (slopes(own, away, start)[name] > 0) == (factor > 1)


def test_weights_stay_where_their_density_is_largest(linear, variances):
    known = variances
    for _ in range(200):
        known = replace(known, weight=smoothed(linear, np.zeros_like(linear.defect), known).variances.weight)
    slope = slopes(linear, known, starting_covariance(linear, known))
    for key, value in slope.items():
        if key.startswith("weight"):
            assert abs(value) < 1e-2
    assert np.ptp(known.weight) > 0.3


def test_weights_are_those_of_a_student_distribution(linear, variances):
    """Less where the force is larger than usual; the penalty is smallest at weight 1."""
    pushed = linear.defect.copy()
    pushed[1, 3] -= linear.force[1, 3] @ np.array([0.0, 40.0])
    weight = smoothed(replace(linear, defect=pushed), 0 * pushed, replace(variances, weight=None)).variances.weight
    assert weight.shape == (STRETCHES, BLOCKS, 2)
    assert weight[1, 3 // LASTING, 1] < 0.1
    assert np.median(weight) > 0.5
    assert replace(variances, weight=np.ones_like(weight)).penalty == 0
    assert replace(variances, weight=np.full_like(weight, 0.9)).penalty > 0
    assert replace(variances, weight=np.full_like(weight, 1.1)).penalty > 0
