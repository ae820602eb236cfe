"""Scores of blind cases on made-up answers, and one blind case from end to end."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gap_arm import dataset
from hidden_cases import case_robot

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import Bench
from btr_mjx.gap.windows import Options

FOLDER = Path(__file__).parents[2] / "benchmarks"
DOG, ARM = case_robot("quadruped").model, case_robot("arm").model


@pytest.fixture(scope="module")
def scores() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gap_scores", FOLDER / "gap_scores.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def effect(kind: str, location: str, **values: float) -> dict[str, Any]:
    return {"effect": kind, "location": location, "parameters": values}


def said(kind: str, location: str, **values: float) -> dict[str, Any]:
    parameters = {name: {"value": v, "low": v - 0.05, "high": v + 0.05, "null": 0.0} for name, v in values.items()}
    return {"effect": kind, "location": location, "parameters": parameters, "score": 80.0}


def case(hidden: list[dict], named: list[dict], **more: Any) -> dict[str, Any]:
    truth = {
        "robot": "quadruped",
        "seed": 1,
        "effects": hidden,
        "outside": "",
        "visible": 500.0,
        "rate": 400,
        "noise": 1,
    }
    truth["verdict"] = more.pop("truth", "effect" if hidden else "none")
    gap = {"before": 3.0, "after": 1.5, "nulls": 1.0, "closed": 0.75}
    answer = {
        "verdict": more.pop("said", "effect" if named else "none"),
        "effects": named,
        "equivalent": [],
        "gap": gap,
    }
    answer |= {"best_score": 5.0, "margin": 30.0, "steps": 1e5, "seconds": 9.0} | more
    score = answer.pop("oracle", 200.0)
    oracle = {"gains": [score] * len(hidden), "scores": [score - 150.0] * len(hidden)}
    return {"truth": truth, "answer": answer, "oracle": oracle}


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("joint:fl_knee", "actuator:fl_knee", True),
        ("joint:fl_knee", "joint:fr_knee", False),
        ("subtree:fl_hip", "all", False),
        ("subtree:fl_hip", "subtree:fl_hip", True),
        ("body:fl_thigh", "body:fl_shank", False),
        ("world", "geom:floor", True),
        ("world", "body:trunk", False),
    ],
)
def test_places(scores: ModuleType, one: str, other: str, same: bool) -> None:
    assert scores.same_place(DOG, one, other) == scores.same_place(DOG, other, one) == same


def test_limbs(scores: ModuleType) -> None:
    assert scores.limbs_of(DOG, "joint:fl_knee") == scores.limbs_of(DOG, "body:fl_shank") == {"fl_hip"}
    assert scores.limbs_of(DOG, "subtree:fl_hip") == {"fl_hip"}
    assert len(scores.limbs_of(DOG, "all")) == 4
    assert scores.limbs_of(DOG, "body:trunk") == {"trunk"}
    assert scores.limbs_of(DOG, "world") == {"world"}
    assert scores.limbs_of(ARM, "joint:elbow") == scores.limbs_of(ARM, "body:hand") == {"column"}


def test_errors_of_parameters(scores: ModuleType) -> None:
    force = scores.parameter_error(
        effect("constant_force", "body:trunk", x=3.0, y=4.0, z=0.0),
        said("constant_force", "body:trunk", x=3.0, y=4.5, z=0),
    )
    assert force == pytest.approx(0.1)
    payload = scores.parameter_error(
        effect("payload", "body:fl_shank", mass=0.1, x=0, y=0, z=-0.2),
        said("payload", "body:fl_shank", mass=0.12, along=0.1),
    )
    assert payload == pytest.approx(0.2)
    slippery = said("ground_friction", "world", coefficient=0.5)
    slippery["parameters"]["coefficient"]["null"] = 0.8
    assert scores.parameter_error(effect("ground_friction", "world", coefficient=0.4), slippery) == pytest.approx(0.25)


def test_hidden_payloads_in_the_parameters_of_the_library(scores: ModuleType) -> None:
    hidden = effect("payload", "body:lower", mass=0.3, x=0.2, y=0.0, z=0.0)
    np.testing.assert_allclose(scores.true_values(ARM, hidden, ["mass", "along"]), [0.3, 0.2])
    np.testing.assert_allclose(scores.true_values(ARM, hidden, ["mass", "x", "y", "z"]), [0.3, 0.2, 0, 0])


def test_summary_by_hand(scores: ModuleType) -> None:
    knee, thigh = ("joint:fl_knee", "joint:fl_swing")
    hidden = [effect("dry_friction", knee, torque=1.0)]
    two = [*hidden, effect("armature", "all", armature=1.0)]
    close = [{"effect": "dry_friction", "location": knee}]
    cases = [
        case(hidden, [said("dry_friction", knee, torque=1.1)], oracle=300.0),
        case(hidden, [said("dry_friction", thigh, torque=1.0)]),
        case(hidden, [said("viscous_damping", knee, damping=1.0)], equivalent=close),
        case(hidden, [], said="unexplained"),
        case(hidden, [], oracle=10.0),
        case([], []),
        case([], [said("backlash", knee, play=0.1)]),
        case([], [], truth="unexplained", said="unexplained", visible=0),
        case(two, [said("armature", "all", armature=1.0), said("dry_friction", knee, torque=1.0)]),
    ]
    cases[7]["truth"]["visible"] = 5000.0
    numbers = scores.summary([scores.judge(DOG, c) for c in cases])
    assert (numbers["effects"], numbers["detectable"], numbers["nulls"], numbers["outside"]) == (5, 4, 2, 1)
    assert numbers["undetectable_share"] == 0.2
    assert numbers["right_kind_and_place"] == 0.25
    assert (numbers["scoring"], numbers["right_of_scoring"], numbers["in_set_of_scoring"]) == (1, 1.0, 1.0)
    assert numbers["truth_in_equivalence_set"] == 0.5
    assert numbers["right_limb_or_body"] == 0.75
    assert numbers["parameter_error_median"] == pytest.approx(0.1)
    assert (numbers["numbers"], numbers["within_intervals"]) == (3, pytest.approx(2 / 3))  # 1.1 ± 0.05 is not 1
    assert numbers["nulls_named"] == 0.5
    assert numbers["strong_outside_flagged"] == 1.0
    assert numbers["false_unexplained"] == pytest.approx(1 / 8)
    assert numbers["gap_closed_median"] == numbers["gap_closed_where_seen"] == 0.75
    assert numbers["gap_seen_share"] == 1.0
    assert numbers["pairs_both_found"] == 1.0
    assert numbers["false_names"] == pytest.approx(3 / 9)
    met = {name: bar["met"] for name, bar in scores.bars(numbers).items()}
    assert met["gap_closed_median"] is True
    assert met["nulls_named"] is False
    confusion = {
        (row["hidden"], row["said"]): row["cases"] for row in scores.confusion([scores.judge(DOG, c) for c in cases])
    }
    assert confusion["dry_friction", "dry_friction"] == 2
    assert confusion["dry_friction", "none"] == 1
    assert confusion["two effects", "armature"] == 1


def test_a_lag_for_a_delay_of_the_same_motor_is_counted_apart(scores: ModuleType) -> None:
    knee = "actuator:fl_knee"
    late = [effect("actuator_delay", knee, delay=1e-3)]
    cases = [
        case(late, [said("actuator_lag", knee, time_constant=1e-3)]),
        case(late, [said("actuator_lag", "actuator:fl_swing", time_constant=1e-3)]),
        case(late, [said("armature", "joint:fl_knee", armature=0.1)]),
        case(late, [said("actuator_delay", knee, delay=1e-3)]),
    ]
    numbers = scores.summary([scores.judge(DOG, c) for c in cases])
    assert numbers["right_kind_and_place"] == 0.25
    assert numbers["right_or_lag_for_delay"] == 0.5


def test_in_pairs_a_lag_for_a_delay_is_counted_apart_as_well(scores: ModuleType) -> None:
    knee = "actuator:fl_knee"
    two = [effect("actuator_delay", knee, delay=1e-3), effect("armature", "all", armature=1.0)]
    lag, delay, heavy = (
        said("actuator_lag", knee, time_constant=1e-3),
        said("actuator_delay", knee, delay=1e-3),
        said("armature", "all", armature=1.0),
    )
    answers = ([heavy, lag], [heavy, delay], [heavy], [lag, delay])
    numbers = scores.summary([scores.judge(DOG, case(two, named)) for named in answers])
    assert numbers["pairs_both_found"] == 0.25
    assert numbers["pairs_or_lag_for_delay"] == 0.5


def test_gains_of_true_effects_against_separate_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains against separate fits of each hypothesis; an absent effect gains nothing beside the true one."""
    monkeypatch.syspath_prepend(str(FOLDER))
    import blind_gap

    def damped(model):
        model.dof_damping[1] += 0.1

    library = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature"))
    bench = Bench(dataset(damped, seed=4, fit=2, test=1), library, Options(steps=4e4, leaders=2, contact_leaders=0))
    known = {candidate.name: candidate for candidate in bench.candidates}
    true = known["viscous_damping@joint:elbow"], np.array([0.1])
    absent = known["armature@joint:shoulder"], np.array([1e-9])
    judged = bench.find()[0]  # the best candidate sets the bound of windows
    plain = 0.0
    for side, free in ((bench.fit, bench.free), (bench.test, bench.nuisance)):
        for sign, hypothesis in ((1.0, bench.base), (-1.0, bench.base.with_effect(*true))):
            own = side.with_fitted_states(hypothesis)
            plain += sign * free(own).profile(own.windows.residual, bench.cut).loss / bench.dispersion
    assert plain > 100
    gains, scores = blind_gap._true_gains(bench, [true])
    assert gains[0] == pytest.approx(plain, rel=0.05)
    price = np.log(bench.fit.windows.residual.size + bench.test.windows.residual.size)
    assert judged.name == "viscous_damping@joint:elbow"
    # Starting states of the oracle are estimated with the true effect, those of a first round without it.
    assert 0.8 * judged.score < scores[0] <= gains[0] - price
    gains, scores = blind_gap._true_gains(bench, [true, absent])
    assert gains[0] == pytest.approx(plain, rel=0.05)
    assert gains[1] == pytest.approx(0.0, abs=0.1)
    assert scores[1] == pytest.approx(-price, abs=1.0)


def test_margins(scores: ModuleType) -> None:
    hidden = [effect("dry_friction", "joint:fl_knee", torque=1.0)]
    rows = [
        scores.judge(DOG, case(hidden, [said("dry_friction", "joint:fl_knee", torque=1.0)], margin=margin))
        for margin in (30, 40, 200)
    ]
    table = {row["from"]: (row["names"], row["right"]) for row in scores.calibration(rows)}
    assert table[25.0] == (2, 1.0)
    assert table[100.0] == (1, 1.0)
    assert table[0.0] == (0, None)


@pytest.mark.slow
def test_a_blind_case_from_end_to_end(tmp_path: Path) -> None:
    """A case with a saved answer is scored without a search."""
    run = tmp_path / "run"
    command = [
        sys.executable,
        FOLDER / "blind_gap.py",
        "--cases=1",
        "--robot=pendulum",
        "--only-effects",
        "--no-oracle",
    ]
    command += ["--duration=0.5", f"--out={run}", f"--json={tmp_path / 'numbers.json'}"]
    answer = case([], [])["answer"] | {"ranking": []}
    (run / "answers").mkdir(parents=True)
    (run / "answers" / "0000.json").write_text(json.dumps(answer))
    subprocess.run(command, check=True, capture_output=True)
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    assert numbers["numbers"]["cases"] == 1
    assert numbers["rows"][0]["said"] == "none"
    assert numbers["rows"][0]["truth"] == "effect"
    assert not (run / "data" / "0000").exists()
    truth = (run / "truth" / "0000.json").read_bytes()
    again = subprocess.run(command, check=True, capture_output=True, text=True)
    assert "right_kind_and_place" in again.stdout
    assert (run / "truth" / "0000.json").read_bytes() == truth
    other = subprocess.run([*command, "--seed=4"], capture_output=True, text=True)
    assert other.returncode == 2
    assert "cases of other settings" in other.stderr
