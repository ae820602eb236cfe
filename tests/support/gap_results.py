"""Results of a diagnosis, written by hand: as a search gives them, and as result.json holds them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from btr_mjx.gap.results import (
    Chi2,
    Confound,
    Diagnosis,
    DisagreementMap,
    Estimate,
    JointError,
    NamedEffect,
    OpenLoop,
    Overlay,
    RankedCandidate,
    misfit_of,
)

TIME = np.linspace(0, 1, 20)
NAMED = NamedEffect("dry_friction", "joint:servo", {"torque": Estimate(0.031, 0.028, 0.034, "N m")}, 80.0, 30.0)
FOUND = Diagnosis(
    found=(NAMED,),
    ranking=(
        RankedCandidate("dry_friction", "joint:servo", 80.0, 0.0, 55.0, 30.0, {"torque": 0.031}),
        RankedCandidate("viscous_damping", "joint:servo", 20.0, 60.0, 18.0, 7.0, {"damping": 0.004}),
    ),
    steps=1000,
    seconds=1.0,
    joint_errors=(JointError("joint servo", "rad", 0.25, 0.03, 0.011, 0.01, 0.001, 0.1),),
    open_loop=OpenLoop(0.05, 0.02),
    chi2=Chi2(3.0, 1.2, 1.0),
    equivalent=("dry_friction@joint:servo",),
    disagreement=DisagreementMap(
        ("joint:servo",),
        ("N m",),
        ("all", "fast"),
        np.array([[0.3, 0.5]]),
        None,
        np.array([[3.0, 5.0]]),
        np.array([[40, 20]]),
    ),
    confounds=(Confound("dry_friction@joint:servo", "viscous_damping@joint:servo", 0.93, "More viscous damping."),),
    overlays=(Overlay("behaviour_09", "joint:servo", TIME, np.sin(TIME), np.cos(TIME), np.sin(TIME) + 0.01),),
    share=0.9,
    lack_of_fit=(12.0, 0.5),
    threshold=15.0,
    dispersion=1.0,
    sigma=np.ones(2),
    windows=(40, 20, 10, 0.04),
)


def misfit_entry(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Entry `misfit` of result.json, of rows of `joint_errors`."""
    misfit = misfit_of([JointError(**{key: value for key, value in row.items() if key != "floor"}) for row in rows])
    if misfit is None:
        return None
    return asdict(misfit) | {"noise_reached": misfit.noise_reached, "explained": misfit.explained}


ERRORS: list[dict[str, Any]] = [
    {"joint": joint, "unit": unit, "horizon": 0.25, "before": before, "after": after, "noise": noise, "floor": noise}
    for joint, unit, before, after, noise in (
        ("joint knee1", "rad", 0.2, 0.19, 0.002),
        ("joint knee0", "rad", 0.07, 0.01, 0.002),
        ("position of body torso", "m", 4e-3, 1e-3, 2e-4),
    )
]

RESULT: dict[str, Any] = {
    "verdict": "effect",
    "dataset": "quadruped <left>",
    "where": "joint knee0, when it moves fast under load",
    "effects": [
        {
            "effect": "load_friction",
            "location": "joint:knee0",
            "parameters": {"coefficient": {"value": 0.312, "low": 0.283, "high": 0.343, "unit": "1"}},
        }
    ],
    "ranking": [
        {"effect": "load_friction", "location": "joint:knee0", "score": 812.0, "margin": 0.0},
        {"effect": "load_friction", "location": "subtree:thigh0", "score": 800.0, "margin": 12.0, "equivalent": True},
        {"effect": "dry_friction", "location": "joint:knee0", "score": 402.0, "margin": 410.0},
        {"effect": "payload", "location": "body:torso", "score": -3.0, "margin": 815.0},
    ],
    "equivalent": [
        {"effect": "load_friction", "location": "joint:knee0"},
        {"effect": "load_friction", "location": "subtree:thigh0"},
    ],
    "misfit": misfit_entry(ERRORS),
    "joint_errors": ERRORS,
    "mended": {"file": "mended.xml", "kind": "partly explained"},
    "believed": [
        {"name": "knee damping", "path": "joint:knee0/damping", "before": 0.2, "after": 0.21, "unit": "N m s/rad"}
    ],
    "confounds": [
        {
            "effect": "load_friction@joint:knee",
            "other": "dry_friction@joint:knee",
            "correlation": 0.93,
            "text": "dry friction of the same joint explains half of it",
        }
    ],
    "next_experiment": {"text": "Drive knee0 at twice the speed under the same load."},
    "steps": 712000,
    "seconds": 9.4,
    "seed": 0,
}
