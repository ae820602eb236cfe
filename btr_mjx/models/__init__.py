"""From parameters s to MuJoCo models: one base `MjModel` and the stacked fields that differ between simulations.

`compile_models` prepares a batch with MuJoCo's compiler. The room also holds names and paths of a model's parts
(`parse_path`) and differences of configurations (`difference`).
"""

from btr_mjx.models.compilation import (
    base_model,
    compile_mjcf,
    general_model,
    mjcf_spec,
    model_of,
    robot_digest,
    start_of,
)
from btr_mjx.models.file_copies import files_of_model, files_of_robot, keep_files, kept_files
from btr_mjx.models.light_meshes import with_light_meshes
from btr_mjx.models.mjcf_checks import check_mjcf
from btr_mjx.models.model_batch import Models, compile_models, varying_fields
from btr_mjx.models.model_checks import COMPILE_ERRORS, check_model
from btr_mjx.models.model_fields import read_field, write_field
from btr_mjx.models.path_parameters import PathParameter, read_path_parameter
from btr_mjx.models.paths import (
    control_names,
    dof_places,
    nearest_names,
    parse_path,
    part_names,
    refuse_several_controls,
    set_values,
)
from btr_mjx.models.robot_checks import base_address, check_robot
from btr_mjx.models.robot_file import chosen_robot, load_robot
from btr_mjx.models.tangent import between, difference, integrate, sign_flips

__all__ = [
    "COMPILE_ERRORS",
    "Models",
    "PathParameter",
    "base_address",
    "base_model",
    "between",
    "check_mjcf",
    "check_model",
    "check_robot",
    "chosen_robot",
    "compile_mjcf",
    "compile_models",
    "control_names",
    "difference",
    "dof_places",
    "files_of_model",
    "files_of_robot",
    "general_model",
    "integrate",
    "keep_files",
    "kept_files",
    "load_robot",
    "mjcf_spec",
    "model_of",
    "nearest_names",
    "parse_path",
    "part_names",
    "read_field",
    "read_path_parameter",
    "refuse_several_controls",
    "robot_digest",
    "set_values",
    "sign_flips",
    "start_of",
    "varying_fields",
    "with_light_meshes",
    "write_field",
]
