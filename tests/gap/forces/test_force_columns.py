"""Columns as forces: what simulated steps say where little is missing, and right where much is."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from gap_arm import LIBRARY, arm
from gap_forces import arm_side, arm_stretches, believed, moved_arm
from gap_models import one

from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.forces.force_columns import force_columns
from btr_mjx.gap.forces.motion import FreeNumber, linearise_motion, responses
from btr_mjx.gap.forces.scan import scan_columns
from btr_mjx.gap.forces.search import _scene, first_variances, start
from btr_mjx.gap.forces.settling import settled
from btr_mjx.gap.simulate import Counter, World


@pytest.mark.parametrize(
    "name", ["viscous_damping@joint:elbow", "dry_friction@joint:shoulder", "actuator_gain@actuator:elbow"]
)
def test_columns_are_what_simulation_says(name: str) -> None:
    stretches = arm_stretches([moved_arm("r0", 0)])
    candidate = one(arm(), name, LIBRARY)
    number = FreeNumber(candidate, 0, tuple(candidate.null), candidate.parameters[0].step)
    linear = linearise_motion(stretches, believed())
    found = force_columns(linear, believed(), [number], Counter())[..., 2:, 0].ravel()
    simulated = responses(stretches, believed(), [number])[..., 2:, 0].ravel()
    assert np.corrcoef(found, simulated)[0, 1] > 0.97
    assert found @ simulated == pytest.approx(simulated @ simulated, rel=0.2)


def test_a_mass_is_seen_beside_a_delay() -> None:
    """A lower arm of twice its mass: a model that lacks it accelerates too much, and its motion says little of it."""
    effects = tuple(e for e in EFFECTS if e.name in ("actuator_delay", "payload"))
    payload, delay = (one(arm(), name, effects) for name in ("payload@body:lower", "actuator_delay@all"))

    def heavy(model: mujoco.MjModel) -> None:
        world = payload.apply(World.of(model), (0.5, 0.3))
        for name in ("body_mass", "body_ipos", "body_inertia", "body_iquat"):
            getattr(model, name)[:] = getattr(world.model, name)

    side = arm_side(arm_stretches([moved_arm(f"r{i}", i, change=heavy, late=-0.05) for i in (0, 1)]), effects)
    point = replace(start(side, believed()).point, named=((delay, (0.05,)),))
    fit = settled(side, point, first_variances(side, point.hypothesis(side.library)))
    scene = _scene(side, fit)
    entries = [e for e in side.library.entries if e.candidate.name == payload.name]
    _, (lead,) = scan_columns(scene.gram, entries, scene.given, scene.calibration, scene.count)
    assert 0.3 < lead.values[0] < 0.6
    assert lead.score > 200
