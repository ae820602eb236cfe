"""Systems without actuators, tossed, driven at sites or by cables, under torque or velocity control."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from gap_systems import SYSTEMS

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, load, save_dataset
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.experiments import propose
from btr_mjx.gap.inference import identify
from btr_mjx.gap.preflight import preflight
from btr_mjx.gap.results import Diagnosis, save_diagnosis
from btr_mjx.gap.windows import Options

QUICK = Options(steps=3e4, leaders=2, contact_leaders=0)
CONTACT_FREE = [name for name in SYSTEMS if name != "toss"]


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_is_read_and_what_is_missing_can_be_shown(name: str, tmp_path: Path) -> None:
    system = SYSTEMS[name]
    made = system.dataset(fit=1, test=1)
    save_dataset(tmp_path, system.xml, made.recordings)
    found = load(tmp_path)
    assert found.recordings[0].ctrl.shape == (len(found.recordings[0].time), found.model.nu)
    findings = preflight(found)
    assert [finding for finding in findings if finding.level != "note"] == []
    blind = [finding.message for finding in findings if "cannot show" in finding.message]
    assert not any(f"cannot show {system.effect.partition('@')[0]}:" in line for line in blind)
    assert not any("nothing moves" in line for line in blind)


@cache
def small_search(name: str) -> tuple[Dataset, Diagnosis]:
    """A second at most of each recording, and two kinds of effects."""
    system = replace(SYSTEMS[name], seconds=min(SYSTEMS[name].seconds, 1.0))
    kind = system.effect.partition("@")[0]
    library = tuple(e for e in EFFECTS if e.name in (kind, "armature"))
    data = system.dataset(fit=2, test=1)
    return data, identify(data, library, max_effects=1, options=QUICK)


@pytest.mark.parametrize("name", CONTACT_FREE)
def test_a_small_search_names_what_is_missing(name: str) -> None:
    system, (_, found) = SYSTEMS[name], small_search(name)
    (named,) = found.effects
    assert named.name == system.effect
    (estimate,) = named.parameters.values()
    assert estimate.value == pytest.approx(system.value, rel=0.1)


def test_no_command_is_proposed_where_nothing_takes_one(tmp_path: Path) -> None:
    data, found = small_search("free swing")
    assert propose(found, data) is None
    result = save_diagnosis(found, data, tmp_path)
    assert result["next_experiment"] is None
    assert "run the experiment" not in " ".join(result["details"])


def test_a_model_without_joints_is_refused(tmp_path: Path) -> None:
    save_dataset(tmp_path, SYSTEMS["toss"].xml, SYSTEMS["toss"].dataset(1, 1).recordings)
    (tmp_path / "model.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(InputError, match="no joints, so that nothing can move"):
        load(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_what_is_missing_is_named_among_all_effects(name: str) -> None:
    system = SYSTEMS[name]
    found = identify(system.dataset(*(4, 2) if name == "toss" else (3, 2)))
    assert [named.name for named in found.effects] == [system.effect]
    (estimate,) = found.effects[0].parameters.values()
    assert estimate.value == pytest.approx(system.value, rel=0.15)
    assert estimate.low - 0.02 * abs(system.value) <= system.value <= estimate.high + 0.02 * abs(system.value)
    assert np.isfinite(found.chi2.after)
    assert found.chi2.after < found.chi2.before
