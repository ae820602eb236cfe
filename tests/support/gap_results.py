"""The result of a diagnosis, written by hand."""

from typing import Any

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
    "gap": {"before": 0.054, "after": 0.027, "noise_floor": 0.02, "unit": "rad"},
    "joint_errors": [
        {"joint": "joint knee1", "unit": "rad", "horizon": 0.25, "before": 0.2, "after": 0.19, "noise": 0.002},
        {"joint": "joint knee0", "unit": "rad", "horizon": 0.25, "before": 0.07, "after": 0.01, "noise": 0.002},
        {"joint": "position of body torso", "unit": "m", "horizon": 0.25, "before": 4e-3, "after": 1e-3, "noise": 2e-4},
    ],
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
