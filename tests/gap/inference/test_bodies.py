from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from gap_arm import arm_windows

from btr_mjx.gap.data import load
from btr_mjx.gap.inference.scoring.bodies import AtBody, Bodies, floating, usual_needed
from btr_mjx.gap.inference.scoring.forces import ForceFit, circumstances, lack_of_fit
from btr_mjx.gap.inference.scoring.leftover import Feature, Leftover, Told
from btr_mjx.gap.inference.verdict import check
from btr_mjx.gap.simulate import World
from btr_mjx.gap.windows import Span, Windows, linearise, prepare, project
from btr_mjx.testing import CaseSettings, case_robot, make_case


def noise_of(windows: Windows, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return project(rng.standard_normal(windows.residual.shape), windows.basis)


def test_bodies_with_a_free_joint_float() -> None:
    quadruped = case_robot("quadruped").model
    assert floating(quadruped) == {quadruped.body("trunk").id: [0, 1, 2, 3, 4, 5]}
    assert floating(case_robot("pendulum").model) == {}
    two = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint type='hinge'/><geom size='.1'/></body><body><freejoint/><geom size='.1'/>"
        "</body></worldbody></mujoco>"
    )
    assert floating(two) == {2: [1, 2, 3, 4, 5, 6]}


def test_forces_at_some_degrees_of_freedom_explain_what_least_squares_do() -> None:
    windows = arm_windows()
    fit = ForceFit(windows, circumstances(windows, World.of))
    residual = noise_of(windows, 3)
    own = fit.at([1])
    found = own(residual)
    assert found.value.shape == (len(windows), fit.bins, 1)
    for w, columns in enumerate(fit.columns.reshape(len(windows), *fit.shape, -1)[:, 1].astype(float)):
        best = np.linalg.lstsq(columns.T, residual[w], rcond=1e-3)[0]
        left = residual[w] - columns.T @ best
        assert found.explained[w] == pytest.approx((residual[w] ** 2).sum() - (left**2).sum(), rel=1e-3)
    assert fit.shape == (2, fit.bins)  # as it was


def test_what_is_left_along_three_axes_shows_on_all_of_them_together(tmp_path) -> None:
    """A little of a force along x and z and of a torque about y, in every window, as the signatures have it."""
    make_case(tmp_path, 906, "quadruped", CaseSettings(verdict="none", background=0.0, recordings=(1, 1), duration=1.0))
    data = load(tmp_path)
    sigma = np.concatenate(case_robot("quadruped").sigma(data.fit[0].model))
    prepared = prepare(data.fit, data.interpolation, sigma, Span(5, 4))
    k = round(0.04 / float(np.median(np.diff(data.fit[0].time))))
    first = np.arange(k, len(data.fit[0].time) - k - 6, k)
    windows = Windows(prepared, np.zeros(len(first), int), first, k)
    linearise(windows, World.of)
    fit = ForceFit(windows, circumstances(windows, World.of))
    bodies = Bodies(data.model, [fit, fit])
    noise = [noise_of(windows, seed) for seed in (1, 2)]
    assert abs(bodies(noise).excess) < 3.0

    columns = fit.columns.reshape(len(windows), *fit.shape, -1)
    rng, some = np.random.default_rng(4), np.zeros_like(noise[0])
    for dof in (0, 2, 4):
        push = np.einsum("wb,wbr->wr", rng.standard_normal((len(windows), fit.bins)), columns[:, dof])
        some += 4.0 * push / np.linalg.norm(push, axis=1, keepdims=True)
    pushed = [project(one + some, windows.basis) for one in noise]
    found = bodies(pushed)
    assert found.body == data.model.body("trunk").id
    single = [lack_of_fit([fit.at([dof])(residual) for residual in pushed]) for dof in range(6)]
    assert found.excess > max(6.0, *single)
    assert found.usual > 1.0
    few = 3.0 * (np.arange(len(windows)) % 4 == 0)[:, None]
    thrown = bodies([project(one + few * some, windows.basis) for one in noise])
    assert thrown.excess > 6.0
    assert thrown.usual < 0.5
    assert found.chi2 > 0.5 * sum(((p**2).sum() - (n**2).sum()) for p, n in zip(pushed, noise, strict=True))
    arm = arm_windows()
    alone = Bodies(case_robot("arm").model, [ForceFit(arm, circumstances(arm, World.of))])
    assert alone([noise_of(arm, 1)]).body is None


@pytest.mark.parametrize(
    ("finer", "usual", "expected"), [(1, 0.1, True), (4, 0.1, False), (4, 1.2, False), (4, 1.6, True)]
)
def test_few_windows_may_show_a_load_that_swings_where_touchdowns_are_not_rough(finer, usual, expected) -> None:
    """A battery in the trunk of a heavy hexapod had 7.6 standard deviations and 0.13 in half of the windows."""
    nulls = [AtBody(1, 0.5, 9.0, 0.2), AtBody(1, 1.0, 9.0, 1.5)]
    needed = usual_needed(finer > 1, nulls)
    chance = SimpleNamespace(excess_at_body=4.0, usual_at_body=needed[1])
    assert check.Check.thrown(chance, AtBody(1, 7.6, 380.0, usual)) is expected  # type: ignore[arg-type]
    assert needed[0] == (1.0 if finer > 1 else -np.inf)


@pytest.mark.parametrize(
    ("excess", "joint", "expected"), [(4.1, 0.0, "body:trunk"), (3.9, 0.0, None), (9.0, 50.0, "fl_")]
)
def test_what_acts_at_a_joint_is_told_there(monkeypatch, excess, joint, expected) -> None:
    """A force at a joint pulls at the trunk as well; the trunk is told where no joint is."""
    monkeypatch.setattr(check, "describe", lambda *_: [])
    model = case_robot("quadruped").model
    feature = Feature(6, "ripple", None, np.zeros((1, 1)))
    chance = SimpleNamespace(excess_at_body=4.0, usual_at_body=0.5)
    stub = SimpleNamespace(
        bench=SimpleNamespace(dataset=SimpleNamespace(model=model)),
        around=[None],
        gain=45.0,
        thrown=lambda there: check.Check.thrown(chance, there),  # type: ignore[arg-type]
        _known=[[feature]],
        left=lambda _: Leftover(np.zeros(1), np.zeros(1), np.zeros(1), joint, feature),
        follows=lambda _: Told(0, 1.0, joint) if joint > 45.0 else None,
        told=lambda _: None,
        at_body=lambda _: AtBody(model.body("trunk").id, excess, 90.0, 1.0),
        _fit=lambda *_: None,
        _forces=lambda *_: None,
    )
    said = check.Check.words(stub, None)  # type: ignore[arg-type]
    assert len(said) == (expected is not None)
    if expected == "body:trunk":
        assert said[0].startswith(f"body:trunk: forces and torques on the body explain {excess} standard deviations")
    elif expected:
        assert said[0].endswith("a force there follows ripple, as no effect that was tried does")


def test_a_trunk_is_asked_beside_a_name_that_moves_no_contacts() -> None:
    def at_body(name: str | None) -> AtBody:
        effect = SimpleNamespace(name=name)
        judged = None if name is None else SimpleNamespace(hypothesis=SimpleNamespace(effects=((effect, ()),)))
        stub = SimpleNamespace(
            bench=SimpleNamespace(delicate={"joint_offset@joint:fl_knee"}),
            fits=[1, 2],
            _fit=lambda i, _: i + 1,
            _bodies=lambda residuals: AtBody(1, 5.0, 90.0),
            _residual=lambda *_: np.zeros((1, 1)),
        )
        return check.Check.at_body(stub, judged)  # type: ignore[arg-type]

    assert at_body("payload@body:trunk") == AtBody(1, 5.0, 90.0)
    assert at_body("joint_offset@joint:fl_knee") == at_body(None) == AtBody()
