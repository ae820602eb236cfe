"""Files of a diagnosis, read back."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest
from gap_models import QUADRUPED

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.report import draw_report
from btr_mjx.gap.results import (
    Chi2,
    Confound,
    Diagnosis,
    DisagreementMap,
    Estimate,
    JointError,
    NamedEffect,
    NextExperiment,
    OpenLoop,
    Overlay,
    RankedCandidate,
    Refit,
    as_result,
    found_effects,
    save_diagnosis,
)
from btr_mjx.gap.results.drawn import place_of_disagreement
from btr_mjx.models import PathParameter
from btr_mjx.runs import read_arrays, read_json

REGIMES = ("all", "slow", "fast", "low load", "high load", "contact", "air", "early", "late")


def disagreement() -> DisagreementMap:
    force = np.full((2, len(REGIMES)), 0.1)
    force[1] = [0.6, 0.2, 1.0, 0.1, 1.2, np.nan, 0.6, 0.6, 0.6]
    relative = np.full((2, len(REGIMES)), 1.02)
    relative[1] = [6.0, 1.5, 10.0, 1.1, 12.0, np.nan, 6.0, 6.1, 6.0]
    places, count = ("body:torso, force", "joint:knee0"), np.ones((2, len(REGIMES)), int)
    return DisagreementMap(places, ("N", "N m"), REGIMES, force, None, relative, count)


def diagnosis() -> Diagnosis:
    time = np.linspace(0.4, 0.48, 9)
    friction = {"coefficient": Estimate(0.31, 0.28, 0.34, "1")}
    return Diagnosis(
        found=(NamedEffect("load_friction", "joint:knee0", friction, 300.0, 90.0, ("dry_friction@joint:knee0",)),),
        ranking=(
            RankedCandidate("load_friction", "joint:knee0", 300.0, 0.0, 220.0, 90.0, {"coefficient": 0.31}),
            RankedCandidate("dry_friction", "joint:knee0", 290.0, 10.0, 210.0, 85.0, {"torque": 1.3}),
            RankedCandidate("payload", "body:torso", 3.0, 297.0, 5.0, 1.0, {"mass": 0.2, "x": 0.0, "y": 0.0, "z": 0.0}),
        ),
        steps=700_000,
        seconds=9.1,
        joint_errors=(JointError("joint knee0", "rad", 0.25, 0.04, 0.012, 0.01, None, 0.5),),
        chi2=Chi2(4.0, 1.2, 1.0),
        equivalent=("load_friction@joint:knee0", "dry_friction@joint:knee0"),
        disagreement=disagreement(),
        believed=(Refit("knee damping", 0.2, 0.3, 0.21), Refit("hip gain", 1.0, 1.1, 1.05)),
        confounds=(Confound("payload@body:a", "armature@joint:b", 0.96, "a careful word"),),
        overlays=(Overlay("trot", "joint:knee0", time, time, time + 0.1, time + 0.01),),
        share=0.9,
        lack_of_fit=(9.0, 0.4),
        threshold=15.0,
        dispersion=1.03,
        sigma=np.full(20, 0.001),
        windows=(96, 48, 11, 0.02),
    )


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    file = tmp_path / "robot.xml"
    file.write_text(QUADRUPED)
    parameters = (
        PathParameter("knee damping", ("joint:knee0/damping",), 0.0, 2.0),
        PathParameter("hip gain", ("actuator:hip0/kp", "actuator:hip0/kv"), 0.5, 2.0, relative=True),
    )
    return Dataset(tmp_path, mujoco.MjModel.from_xml_string(QUADRUPED), file, QUADRUPED, parameters, ())


def test_saved_files_hold_the_diagnosis(dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "run"
    save_diagnosis(diagnosis(), dataset, out, more={"seed": 3})
    result = read_json(out / "result.json")
    assert json.loads((out / "result.json").read_text()) == result
    assert result["verdict"] == "effect"
    assert result["effects"][0]["parameters"]["coefficient"] == {
        "value": 0.31,
        "low": 0.28,
        "high": 0.34,
        "unit": "1",
        "null": 0.0,
        "edge": False,
    }
    assert [row["equivalent"] for row in result["ranking"]] == [True, True, False]
    assert result["equivalent"][1] == {"effect": "dry_friction", "location": "joint:knee0"}
    assert result["misfit"]["before"] == pytest.approx(4.0)
    assert result["misfit"]["noise_reached"] is True
    assert result["mended"] == {"file": "mended.xml", "kind": "explained"}
    assert result["seed"] == 3
    assert result["where"] == "joint knee0, when it moves fast under high load"
    assert "load-dependent gear friction at joint knee0 (0.310 ± 0.030 of the motor torque)" in result["sentence"]
    assert pl.read_csv(out / "ranking.csv")["effect"].to_list() == ["load_friction", "dry_friction", "payload"]
    assert pl.read_csv(out / "disagreement.csv")["fast"].to_list() == [0.1, 1.0]
    assert read_arrays(out / "overlays.npz")["units"].tolist() == ["rad"]
    page = draw_report(out).read_text(encoding="utf-8")
    assert "mended.xml is the believed model with what was named" in page
    assert "NaN" not in page


@pytest.mark.parametrize(
    ("joints", "unit"),
    [("slide", "m"), ("hinge", "rad"), ("ball", "rad"), ("slide hinge", "rad and m"), ("free", "rad and m")],
)
def test_the_error_over_whole_recordings_has_the_unit_of_the_joints(tmp_path: Path, joints: str, unit: str) -> None:
    body = "".join(f'<joint type="{kind}"/>' for kind in joints.split())
    xml = f'<mujoco><worldbody><body>{body}<geom size="0.1"/></body></worldbody></mujoco>'
    dataset = Dataset(tmp_path, mujoco.MjModel.from_xml_string(xml), None, xml, (), ())
    followed = replace(diagnosis(), open_loop=OpenLoop(0.2, 0.1))
    assert as_result(followed, dataset)["open_loop"] == {"before": 0.2, "after": 0.1, "unit": unit}


def test_the_mended_model_has_what_was_refitted(dataset: Dataset, tmp_path: Path) -> None:
    save_diagnosis(diagnosis(), dataset, tmp_path / "run")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "run" / "mended.xml"))
    assert model.dof_damping[model.joint("knee0").dofadr[0]] == pytest.approx(0.21)
    assert model.actuator("hip0").gainprm[0] == pytest.approx(63.0)
    assert model.actuator("hip0").biasprm[2] == pytest.approx(-1.575)
    terms = read_json(tmp_path / "run" / "mended.json")["terms"]
    assert [(t["effect"], t["parameters"]) for t in terms] == [("load_friction", {"coefficient": 0.31})]


def test_meshes_are_found_from_anywhere(dataset: Dataset, tmp_path: Path) -> None:
    points = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    lines = [f"v {x} {y} {z}" for x, y, z in points] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "wedge.obj").write_text("\n".join(lines))
    text = QUADRUPED.replace(
        "<mujoco>", '<mujoco><compiler meshdir="shapes"/><asset><mesh file="wedge.obj"/></asset>', 1
    )
    text = text.replace('<geom type="sphere" size="0.05"/>', '<geom type="mesh" mesh="wedge" density="300"/>')
    dataset.model_file.write_text(text)
    dataset = replace(dataset, model=mujoco.MjModel.from_xml_path(str(dataset.model_file)), spec_xml=text)
    save_diagnosis(diagnosis(), dataset, tmp_path / "elsewhere" / "run")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "elsewhere" / "run" / "mended.xml")).nmesh == 1


@pytest.mark.parametrize("verdict", ["none", "unexplained"])
def test_files_of_a_diagnosis_without_a_name(dataset: Dataset, tmp_path: Path, verdict: str) -> None:
    left = ("joint knee0: all of it",) if verdict == "unexplained" else ()
    nothing = replace(diagnosis(), found=(), equivalent=(), unexplained=left, overlays=(), joint_errors=())
    time = np.linspace(0, 1, 30)
    values = np.sin(np.outer(time, [3, 4, 5, 6]))
    names = ("load_friction@joint:knee0", "nothing missing")
    proposal = NextExperiment(time, values, names, 40.0, (3.0, 40.0, 5.0), 1, "it tells them apart")
    result = save_diagnosis(nothing, dataset, tmp_path / "run", next_experiment=proposal)
    assert not (tmp_path / "run" / "mended.xml").exists()
    page = draw_report(tmp_path / "run").read_text(encoding="utf-8")
    assert ("Nothing is missing" in page) == (verdict == "none")
    assert "Send the command in next_command.csv: it tells them apart." in page
    assert "It decides between load-dependent gear friction at joint knee0 and nothing missing." in page
    assert result["next_experiment"]["others"] == {"median": 4.0, "count": 2}
    saved = pl.read_csv(tmp_path / "run" / "next_command.csv")
    assert saved.columns == ["time", *(f"ctrl/{name}" for name in ("hip0", "knee0", "hip1", "knee1"))]
    assert (tmp_path / "run" / "figures" / "next-command.png").is_file()


def test_no_place_of_disagreement_within_the_noise() -> None:
    quiet = disagreement()
    quiet.relative[1] = 1.1
    assert place_of_disagreement(quiet) == ""
    none = np.zeros((0, len(REGIMES)))
    assert place_of_disagreement(DisagreementMap((), (), REGIMES, none, None, none, none.astype(int))) == ""


def test_a_calibrated_model_where_nothing_is_missing(dataset: Dataset, tmp_path: Path) -> None:
    gain = {"change": Estimate(0.04, None, None, "1")}
    calibrated = replace(
        diagnosis(),
        found=(),
        equivalent=(),
        calibration=(NamedEffect("actuator_gain", "actuator:knee0", gain, tolerances=0.8),),
    )
    result = save_diagnosis(calibrated, dataset, tmp_path / "run")
    before, after = (m.actuator("knee0").gainprm[0] for m in (dataset.model, mended(tmp_path / "run")))
    assert after == pytest.approx(1.04 * before)
    assert [(one.effect, one.values) for one in found_effects(result)] == [("actuator_gain", {"change": 0.04})]
    details = " ".join(result["details"])
    assert "falls from 4 to 1.2 (1: what noise and the time step make" in details
    assert "mended.xml is the believed model with calibration alone, in which nothing has a name" in details
    assert "usual tolerances: a change of the motor's strength at actuator knee0 (change 4 %)" in details
    rows = pl.read_csv(tmp_path / "run" / "parameters.csv")
    assert rows.filter(pl.col("name").str.starts_with("actuator_gain"))["value"].to_list() == [0.04]
    page = draw_report(tmp_path / "run").read_text(encoding="utf-8")
    assert "It contains calibration." in page


def test_what_predicts_better_is_written_though_it_has_no_name(dataset: Dataset, tmp_path: Path) -> None:
    """Something else is missing beside it: the model is there, and its first line says what it is."""
    rows = (JointError("joint knee0", "rad", 0.25, 0.98, 0.0333, 0.001, None, 1.5),)
    left = replace(diagnosis(), unexplained=("joint hip0: a force that nothing follows",), joint_errors=rows)
    result = save_diagnosis(left, dataset, tmp_path / "run")
    assert (result["verdict"], result["effects"]) == ("unexplained", [])
    assert [one["effect"] for one in result["unnamed"]] == ["load_friction"]
    assert result["mended"]["kind"] == "unnamed"
    first = (tmp_path / "run" / "mended.xml").read_text().splitlines()[0]
    assert first == (
        "<!-- mended.xml is the believed model with numbers that may not be called by name, since something else is "
        "missing beside them: it predicts held-out recordings better (a misfit of 33.3 against 980). -->"
    )
    assert mended(tmp_path / "run").dof_damping[dataset.model.joint("knee0").dofadr[0]] == pytest.approx(0.21)
    assert found_effects(result)[-1].effect == "load_friction"
    assert "unnamed part of a model that predicts better" in (tmp_path / "run" / "parameters.csv").read_text()
    page = draw_report(tmp_path / "run").read_text(encoding="utf-8")
    assert "numbers that may not be called by name" in page


def test_the_verdict_follows_from_the_numbers() -> None:
    """What is predicted down to the noise, and leaves no more than nulls do, leaves nothing."""
    seen, left = (JointError("joint knee0", "rad", 0.25, 0.04, after, 0.01) for after in (0.012, 0.03))
    told = replace(diagnosis(), unexplained=("a force",), joint_errors=(seen,), chi2=Chi2(4.0, 1.0, 1.0))
    assert (told.verdict, told.mended_kind) == ("effect", "explained")
    assert replace(told, found=()).verdict == "none"
    assert replace(told, joint_errors=(seen, left)).verdict == "unexplained"
    assert replace(told, chi2=Chi2(4.0, 1.2, 1.0)).verdict == "unexplained"
    part = replace(told, unexplained=(), joint_errors=(seen, left))
    assert (part.verdict, part.mended_kind) == ("effect", "partly explained")


def mended(folder: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(folder / "mended.xml"))
