"""Fields of a MuJoCo model by name: arrays of MjModel, numbers of its options and of its statistics."""

import mujoco
import numpy as np

STATISTICS = ("meaninertia", "meanmass", "meansize", "extent", "center")
"""Fields of `MjModel.stat`, called "stat.<name>" in a batch."""

OPTIONS = ("timestep", "gravity", "wind", "density", "viscosity", "impratio", "tolerance", "ls_tolerance")
"""Numeric fields of `MjModel.opt` that a batch can carry, called "opt.<name>"."""

PHYSICS = ("body_", "jnt_", "dof_", "geom_", "actuator_", "eq_", "tendon_", "opt.", "qpos")
"""Prefixes of the names of fields that can influence motion; the others concern visuals and names."""


def field_names(model: mujoco.MjModel) -> list[str]:
    """Every array field of a model, and those of its options and statistics that are numbers."""
    arrays = [name for name in dir(model) if not name.startswith("_") and isinstance(getattr(model, name), np.ndarray)]
    return arrays + [f"opt.{name}" for name in OPTIONS] + [f"stat.{name}" for name in STATISTICS]


def read_field(model: mujoco.MjModel, name: str) -> np.ndarray:
    """A copy of one field of a model, by its name in a batch."""
    owner, _, field = name.rpartition(".")
    return np.array(getattr(getattr(model, owner) if owner else model, field))


def write_field(model: mujoco.MjModel, name: str, value: np.ndarray) -> None:
    """Set one field of a model by its name in a batch."""
    owner, _, field = name.rpartition(".")
    target = getattr(model, owner) if owner else model
    current = getattr(target, field)
    if isinstance(current, np.ndarray):
        current[...] = value
    else:
        setattr(target, field, type(current)(value))
