"""From parameters s to MuJoCo models: one base `MjModel` and the stacked fields that differ between simulations.

`compile_models` prepares a batch; templates that only do arithmetic are evaluated without compiling each model. The
room also holds names and paths of a model's parts (`parse_path`) and differences of configurations (`difference`).
"""

from btr_mjx.models.batch import Models, base_model, compile_mjcf, compile_models, varying_fields, why_compiled
from btr_mjx.models.fields import read_field
from btr_mjx.models.paths import nearest_names, parse_path, part_names, set_values
from btr_mjx.models.tangent import between, difference, integrate

__all__ = [
    "Models",
    "base_model",
    "between",
    "compile_mjcf",
    "compile_models",
    "difference",
    "integrate",
    "nearest_names",
    "parse_path",
    "part_names",
    "read_field",
    "set_values",
    "varying_fields",
    "why_compiled",
]
