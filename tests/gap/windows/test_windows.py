from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import SIGMA, arm, arm_windows, dataset, recording

from btr_mjx.errors import InputError
from btr_mjx.gap.data import StateEstimate
from btr_mjx.gap.effects import EFFECTS, Scales, candidates
from btr_mjx.gap.inference import Hypothesis
from btr_mjx.gap.inference.scoring.forces import ForceFit, circumstances, describe, lack_of_fit
from btr_mjx.gap.inference.scoring.leftover import Joints, features
from btr_mjx.gap.inference.scoring.refine import Nuisance
from btr_mjx.gap.simulate import World, simulate
from btr_mjx.gap.windows import (
    Span,
    Track,
    Windows,
    best_span,
    fine_step,
    force_signatures,
    linearise,
    prepare,
    project,
    relinearised,
    signatures,
    smooth,
    with_fitted_states,
)
from btr_mjx.gap.windows.placement import place_windows
from btr_mjx.gap.windows.propagation import jacobian
from btr_mjx.gap.windows.transitions import transition_change, transitions


@pytest.fixture(scope="module")
def windows():
    return arm_windows()


def candidate(name):
    model = arm()
    found = candidates(model, Scales.of(model), EFFECTS)
    return next(c for c in found if c.name == name)


def test_jacobian_equals_finite_differences_of_whole_windows(windows):
    found = jacobian(windows)
    for j in range(4):
        nudge = np.zeros(4)
        nudge[j] = 0.2 * SIGMA[j]
        start = windows.qpos + nudge[:2], windows.qvel + nudge[2:]
        moved = windows.whiten(windows.states([World.of], start=start)[0]) - windows.whiten(windows.base)
        np.testing.assert_allclose(moved / 0.2, found[:, :, j], atol=0.02 * np.abs(found[:, :, j]).max())


def test_starting_states_are_projected_out(windows):
    nudge = 0.5 * SIGMA
    start = windows.qpos + nudge[:2], windows.qvel + nudge[2:]
    there = windows.states([World.of], start=start)[0]
    raw = windows.whiten(there) - windows.whiten(windows.base)
    inner = np.einsum("wr,wrd->wd", raw, windows.basis)
    left = raw - np.einsum("wd,wrd->wr", inner, windows.basis)
    assert np.abs(left).max() < 0.02 * np.abs(raw).max()


def test_residual_of_the_true_model_is_noise(windows):
    chi2 = (windows.residual**2).sum(1) / windows.freedom
    assert np.all((chi2 > 0.6) & (chi2 < 1.5))


@pytest.mark.parametrize("quieter", [1.0, 1e-4, 1e-5])
def test_residual_of_a_model_far_away_does_not_depend_on_the_noise(quieter):
    """In its own units: residuals that stop growing would look like an error of the starting state."""

    def other(model):
        model.body_mass[:] *= 3.0
        model.actuator_gainprm[:, 0] *= 0.3

    data = prepare([recording(f"r{i}", other, seed=i) for i in range(2)], quieter * SIGMA, Span(5, 6))
    windows = Windows(data, np.array([0, 0, 1, 1]), np.array([10, 150, 20, 200]), 30)
    windows = linearise(windows, World.of)
    assert quieter * np.sqrt((windows.residual**2).mean()) == pytest.approx(264.0, rel=0.02)


def test_residual_of_long_windows_is_free_of_step_error(windows):
    """The residual is that of steps of 1.25e-4 s, although steps of 5e-4 s are simulated."""
    long = Windows(windows.data, np.array([0, 1]), np.array([10, 20]), 230)
    long = linearise(long, World.of)
    assert fine_step(long) == long.dt / 4
    start = long.segments(np.arange(2), long.qpos, long.qvel, long.since)
    exact = simulate([(World.of(long.groups[0][0]), start)], timestep=1.25e-4)[0]
    left = long.residual - project(long.whiten(exact), long.basis)
    coarse = project(long.whiten(long.base) - long.whiten(exact), long.basis)
    assert np.linalg.norm(left, axis=1).max() < 0.02 * np.linalg.norm(coarse, axis=1).min()


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", ["viscous_damping@joint:elbow", "actuator_delay@actuator:shoulder", "armature@all"])
def test_signatures_agree_with_simulation(windows, name, single):
    chosen = candidate(name)
    base = Hypothesis((), ())
    make = base.with_effect(chosen, [0.2 * p.step for p in chosen.parameters])
    true = windows.residuals([make])[0] - windows.residual
    found = signatures(windows, base, [make], single)[0]
    assert np.linalg.norm(found - true) < (0.35 if single else 0.12) * np.linalg.norm(true)


def test_force_signatures_agree_with_an_applied_force(windows):
    around = circumstances(windows, World.of)
    found = force_signatures(windows, around.inverse, 1)

    class Push:
        fields = ()

        def __call__(self, rows):
            rows.qfrc_applied[:, 1] += 0.01

    def make(model):
        world = World.of(model)
        world.laws.append(Push())
        return world

    true = (windows.residuals([make])[0] - windows.residual) / 0.01
    assert np.linalg.norm(found[1] - true) < 0.25 * np.linalg.norm(true)


def test_unknown_forces_find_joint_and_variable():
    def spring(model):
        model.jnt_stiffness[1] = 2.0

    data = prepare([recording("r", spring, seed=5)], SIGMA, Span(5, 6))
    out = Windows(data, np.zeros(8, int), np.linspace(10, 250, 8).astype(int), 20)
    out = linearise(out, World.of)
    around = circumstances(out, World.of)
    fit = ForceFit(out, around)
    forces = fit(out.residual)
    assert lack_of_fit([forces]) > 6
    best = describe(fit, forces, around)[0]
    assert best.dof == 1
    assert best.follows[0][0].startswith("position")
    assert best.follows[0][2] < 0  # a spring pulls back


def noise_of(windows, seed):
    rng = np.random.default_rng(seed)
    return project(rng.standard_normal(windows.residual.shape), windows.basis)


def forces_of(windows):
    """Unknown forces of the windows, and features that may explain them, without nuisances."""
    around = circumstances(windows, World.of)
    fit = ForceFit(windows, around)
    return (
        fit,
        features(arm(), fit, around),
        Nuisance.of(np.zeros((0, *windows.residual.shape), np.float32), np.zeros(0)),
    )


def test_unmodelled_force_is_found_at_its_joint(windows):
    """The signature of a one-sided cable plus noise, and noise alone."""
    fit, known, nothing = forces_of(windows)
    one = next(f for f in known if f.dof == 0 and f.name == "absolute position")
    pull = np.einsum("wb,wbr->wr", one.values, fit.columns.reshape(len(windows), *fit.shape, -1)[:, 0])
    noise = noise_of(windows, 0)
    size = 12.0 / np.linalg.norm(pull)
    joints = Joints(fit, nothing, known)
    found = joints(noise + size * pull, 1e4)
    best = found.feature_gains[0]
    assert (known[best.index].dof, known[best.index].name) == (0, "absolute position")
    assert best.gain > 60
    quiet = joints(noise, 1e4)
    assert all(one.gain < 25 for one in quiet.feature_gains)
    assert quiet.worst < 4 < found.worst
    assert quiet.usual[0] < 1 < found.usual[0]


def test_features_are_evaluated_on_held_out_windows(windows):
    """Loss of held-out windows with the force added, against that of the believed model."""
    fit, known, nothing = forces_of(windows)
    one = next(f for f in known if f.dof == 0 and f.name == "absolute position")
    pull = np.einsum("wb,wbr->wr", one.values, fit.columns.reshape(len(windows), *fit.shape, -1)[:, 0])
    pull *= 12.0 / np.linalg.norm(pull)
    joints = Joints(fit, nothing, known)
    feature_gains = joints(noise_of(windows, 0) + pull, 1e4).feature_gains
    assert known[feature_gains[0].index] is one
    assert [one.gain for one in feature_gains] == sorted((one.gain for one in feature_gains), reverse=True)
    other = noise_of(windows, 1)
    columns = fit.columns.reshape(len(windows), *fit.shape, -1)[:, 0]
    moved = feature_gains[0].amplitude * sum(one.values[:, b, None] * columns[:, b] for b in range(one.values.shape[1]))
    np.testing.assert_allclose(moved, -pull, atol=0.3 * np.abs(pull).max())
    expected = (other**2).sum() - ((other + moved) ** 2).sum()
    assert expected < 0  # no such force in these data
    assert joints.held_out(other, 1e4, feature_gains[0]) == pytest.approx(expected, rel=1e-6)
    assert joints.held_out(other + pull, 1e4, feature_gains[0]) > 60


def test_nuisances_are_not_attributed_to_forces(windows):
    fit, known, nothing = forces_of(windows)
    one = next(f for f in known if f.dof == 1 and f.name == "position cubed")
    pull = np.einsum("wb,wbr->wr", one.values, fit.columns.reshape(len(windows), *fit.shape, -1)[:, 1])
    residual = noise_of(windows, 1) + 10.0 / np.linalg.norm(pull) * pull
    joints = Joints(fit, nothing, [one])
    blind = joints(residual, 1e4, pull[None].astype(np.float32))
    assert all(found.gain <= 0 for found in blind.feature_gains)
    assert joints(residual, 1e4).feature_gains[0].gain > 40


def test_only_changed_transitions_are_differentiated_again(windows):
    """An additional stop at the elbow changes the intervals with contact at the stop."""

    def stopped(model):
        world = World.of(model)
        world.model.jnt_limited[1], world.model.jnt_range[1] = 1, (-3.0, 0.0)
        world.model.jnt_solref[1] = -10000.0, -10.0
        return world

    states = windows.states([stopped])[0]
    touched = states[:, :-1, 1] > 0.0
    assert 0.1 < touched.mean() < 0.9
    error = transition_change(windows, stopped, states)
    inside = states[:, :-1, 1] < -0.1
    assert np.median(error[inside]) < 0.1
    assert np.median(error[touched]) > 2.0
    anew = relinearised(with_fitted_states(windows, stopped), stopped)
    states = anew.states([stopped])[0]
    full = transitions(windows, stopped, states)[0]
    scale = SIGMA / SIGMA[:, None]
    error = np.abs((anew.transitions - full) * scale).max((2, 3))
    assert np.quantile(error, 0.9) < 0.5
    assert np.quantile(np.abs((windows.transitions - full) * scale).max((2, 3)), 0.8) > 2.0


def test_relinearised_windows_project_out_starting_states(windows):
    def stiff(model):
        world = World.of(model)
        world.model.jnt_stiffness[1] = 60.0
        return world

    there = relinearised(with_fitted_states(windows, stiff), stiff)
    nudge = 0.5 * SIGMA
    start = there.qpos + nudge[:2], there.qvel + nudge[2:]
    raw = there.whiten(there.states([stiff], start=start)[0]) - there.whiten(there.base)
    left = [np.abs(project(raw, w.basis)).max() / np.abs(raw).max() for w in (windows, there)]
    assert left[1] < 0.05 < left[0]


def test_subset_of_windows(windows):
    part = windows.some(np.array([3, 1]))
    make = World.of
    np.testing.assert_allclose(part.residuals([make])[0], windows.residuals([make])[0][[3, 1]], atol=1e-9)
    assert part.recording.tolist() == windows.recording[[3, 1]].tolist()


def test_smoothing_is_exact_for_polynomials_at_uneven_times():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.002, 0.008, 60))
    shape = np.array([[0.1, 2.0, -3.0, 4.0], [0.3, -1.0, 5.0, 2.0]])
    qpos = sum(shape[:, p] * time[:, None] ** p for p in range(4))
    qvel = sum(p * shape[:, p] * time[:, None] ** (p - 1) for p in range(1, 4))
    for measured in ([True, True], [False, True]):
        track = Track(time, qpos, np.where(measured, qvel, np.nan), np.array(measured))
        q, v, chi2 = smooth(arm(), track, np.array([0, 7, 30, 59]), SIGMA, Span(4, 4))
        np.testing.assert_allclose(q, qpos[[0, 7, 30, 59]], atol=1e-7)
        np.testing.assert_allclose(v, qvel[[0, 7, 30, 59]], atol=1e-5)
        assert chi2.max() < 1e-3


def test_smoothing_of_a_free_body_follows_its_rotation():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    time, spin = np.arange(30) * 0.01, np.array([0.5, -2.0, 1.0])
    qpos, qvel = np.zeros((30, 7)), np.zeros((30, 6))
    quat = np.array([1.0, 0, 0, 0])
    for k in range(30):
        qpos[k, 3:] = quat
        qpos[k, 0], qvel[k, 0], qvel[k, 3:] = time[k] ** 2, 2 * time[k], spin
        mujoco.mju_quatIntegrate(quat, spin, 0.01)
    track = Track(time, qpos, qvel, np.array([True] * 3 + [False] * 3))
    q, v, _ = smooth(model, track, np.array([12]), np.full(12, 1e-3), Span(4, 4))
    np.testing.assert_allclose(q[0], qpos[12], atol=1e-5)
    np.testing.assert_allclose(v[0], qvel[12], atol=2e-3)


def test_slower_motion_has_longer_fits():
    tracks = []
    for speed in (2.0, 60.0):
        time = np.arange(300) * 0.002
        rng = np.random.default_rng(1)
        qpos = 0.3 * np.sin(speed * time)[:, None] + 1e-3 * rng.standard_normal((300, 2))
        qvel = 0.3 * speed * np.cos(speed * time)[:, None] + 0.01 * rng.standard_normal((300, 2))
        tracks.append(Track(time, qpos, qvel, np.ones(2, bool)))
    slow, fast = (best_span(arm(), [track], SIGMA) for track in tracks)
    assert slow.half > fast.half


def test_noise_that_samples_share_is_smoothed_over_longer_times():
    """Encoders with noise of 5 ms at 1 kHz: a sample hardly differs from the next, and velocities are lost in it."""
    time, rng = np.arange(3000) * 0.001, np.random.default_rng(2)
    white, noise = rng.standard_normal((3000, 2)), np.zeros((3000, 2))
    for k in range(1, 3000):
        noise[k] = 0.8 * noise[k - 1] + 1e-4 * white[k]
    qpos, qvel = 0.3 * np.sin(5 * time)[:, None] + noise, np.repeat(1.5 * np.cos(5 * time)[:, None], 2, 1)
    track, sigma = Track(time, qpos, np.zeros_like(qvel), np.zeros(2, bool)), np.full(4, 4e-5)
    samples = np.arange(100, 2900, 40)
    short, long = (best_span(arm(), [track], sigma, every) for every in (1, 4))
    errors = [np.std(smooth(arm(), track, samples, sigma, span)[1] - qvel[samples]) for span in (short, long)]
    assert errors[1] < 0.5 * errors[0]


def test_windows_with_uneven_samples():
    data = prepare([recording("r", seed=4, uneven=True)], SIGMA, Span(5, 6))
    out = Windows(data, np.zeros(4, int), np.array([10, 80, 150, 220]), 25)
    out = linearise(out, World.of)
    chi2 = (out.residual**2).sum(1) / out.freedom
    assert np.all((chi2 > 0.5) & (chi2 < 1.6))


def test_windows_lie_inside_recordings_and_short_recordings_raise():
    made = dataset(fit=2, test=1)
    data = prepare(made.fit, SIGMA, Span(5, 6))
    recording_of, first, k = place_windows(data, 0.1, 1e6, 10.0)
    for r, f in zip(recording_of, first, strict=True):
        assert f >= 0
        assert f + k < len(made.fit[r].time)
    with pytest.raises(InputError, match="too short for a window"):
        place_windows(data, 5.0, 1e6, 10.0)


def test_errors_of_estimates_that_last_are_no_residual():
    """Of an estimated coordinate only changes count: it may be off by a constant."""
    recordings, known = [recording(f"r{i}", seed=i) for i in range(2)], np.array([0.01, np.nan, np.nan, np.nan])

    def windows(off):
        shifted = [
            replace(r, estimate=StateEstimate(0.1 * known, known), qpos=r.qpos + np.array([off, 0.0]))
            for r in recordings
        ]
        return Windows(prepare(shifted, SIGMA, Span(5, 6)), np.array([0, 1]), np.array([20, 40]), 8)

    plain, moved = windows(0.0), windows(0.02)
    states = plain.states([World.of])[0]
    np.testing.assert_allclose(moved.whiten(states), plain.whiten(states), atol=1e-9)
    assert plain.freedom == plain.correction.shape[1] - 5
    np.testing.assert_allclose(plain.reach[:, 0], 0.02)  # starting states are as free as the estimate is uncertain
