"""Joints without an encoder: their states are estimated, or the recording is refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_systems import PASSIVE_ELBOW, SYSTEMS, without_encoder

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, Noise, make_recording, noise_of
from btr_mjx.gap.data.writing import recording_columns
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.inference import identify
from btr_mjx.gap.preflight import preflight
from btr_mjx.gap.windows import Options


def hidden_elbow(fit: int, test: int) -> tuple[Dataset, Dataset]:
    """The same recordings with the elbow's encoder and without it."""
    whole = PASSIVE_ELBOW.dataset(fit, test)
    parts = [
        replace(make_recording(without_encoder(r, "elbow"), whole.model, r.name, r.name), split=r.split)
        for r in whole.recordings
    ]
    return whole, replace(whole, recordings=tuple(parts))


def test_the_motion_is_estimated_from_that_of_the_others() -> None:
    """With the true model, motion that began at rest is found again."""
    system = replace(PASSIVE_ELBOW, change=lambda model: None, sigma=(1e-6, 1e-5))
    recording = system.dataset(1, 1).recordings[0]
    found = make_recording(without_encoder(recording, "elbow"), recording.model, "r", "r")
    assert np.abs(found.qpos[:, 1] - recording.qpos[:, 1]).max() < 0.05 * np.ptp(recording.qpos[:, 1])
    assert found.seen.tolist() == [True, False]
    assert found.qvel_measured.tolist() == [True, False]
    assert set(recording_columns(found)) == set(without_encoder(recording, "elbow"))


def test_a_small_search_names_what_a_hidden_joint_lacks() -> None:
    _, dataset = hidden_elbow(fit=3, test=1)
    assert any("joints without an encoder" in f.message for f in preflight(dataset) if f.level == "warning")
    library = tuple(e for e in EFFECTS if e.name in ("viscous_damping", "armature"))
    found = identify(dataset, library, max_effects=1, options=Options(steps=3e4, leaders=2, contact_leaders=0))
    assert [named.name for named in found.effects] == [PASSIVE_ELBOW.effect]
    assert found.effects[0].parameters["damping"].value == pytest.approx(PASSIVE_ELBOW.value, rel=0.05)
    assert {one.coordinate for one in found.overlays} == {"joint:shoulder"}


def test_noise_that_is_given_is_that_of_sensors() -> None:
    whole, dataset = hidden_elbow(fit=1, test=1)
    given = Noise(np.array([1e-3, 1e-3]), np.array([1e-2, 1e-2]))
    assert noise_of(replace(whole, noise=given)).qpos.tolist() == [1e-3, 1e-3]
    assert noise_of(replace(dataset, noise=given)).qpos.tolist() == [1e-3, 0.01]


@pytest.mark.parametrize(
    ("name", "without", "message"),
    [
        ("drone", "qpos/frame", "no column 'qpos/frame/x': the pose of a free joint cannot be estimated"),
        ("torque control", "qpos/", "no column of a joint's position; expected qpos/shoulder, qpos/elbow"),
        ("torque control", "qpos/elbow", "no column 'qpos/elbow', but one of its velocity"),
    ],
)
def test_what_cannot_be_estimated_is_refused(name: str, without: str, message: str) -> None:
    recording = SYSTEMS[name].dataset(1, 1).recordings[0]
    columns = {n: v for n, v in recording_columns(recording).items() if not n.startswith(without)}
    with pytest.raises(InputError, match=message):
        make_recording(columns, recording.model, "r.csv", "r")


def test_a_motion_that_diverges_is_refused() -> None:
    recording = PASSIVE_ELBOW.dataset(1, 1).recordings[0]
    model = mujoco.MjModel.from_xml_string(PASSIVE_ELBOW.xml)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    model.dof_damping[1] = 100.0
    columns = without_encoder(recording, "elbow")
    with pytest.raises(InputError, match="motion of elbow, without an encoder, cannot be estimated"):
        make_recording(columns, model, "r.csv", "r")
