"""The believed model's MJCF, read as a file that may come from anybody."""

from pathlib import Path

import mujoco

from btr_mjx.errors import InputError, one_line
from btr_mjx.models import COMPILE_ERRORS, check_mjcf, check_model, refuse_several_controls, with_light_meshes
from btr_mjx.runs import read_text


def load_model(path: Path, inside: Path) -> tuple[mujoco.MjModel, str]:
    """Compile an MJCF file, which may not name files outside of the folder `inside`; also returns its text.

    Raises:
      InputError: the file is absent, MuJoCo rejects it, its numbers cannot be simulated, the model has no joint, or an
        actuator has several controls.
      DamagedFile: it is not UTF-8.
    """
    if not path.is_file():
        raise InputError(f"{path}: there is no such model file")
    text = read_text(path)
    check_mjcf(text, str(path), path.parent, inside)
    try:
        model = _compiled(path)
        mujoco.MjData(model)  # its memory can be taken
    except COMPILE_ERRORS as error:
        raise InputError(f"{path}: MuJoCo does not load this model: {one_line(error)}") from None
    if model.njnt == 0:
        raise InputError(f"{path}: the model has no joints, so that nothing can move; expected at least one")
    check_model(model, str(path))
    refuse_several_controls(model, str(path))
    return model, text


def _compiled(path: Path) -> mujoco.MjModel:
    """Compile with body_simple = 0: effects edit inertia, which MuJoCo's simple bodies do not allow."""
    model = mujoco.MjModel.from_xml_path(str(path))
    if model.body_simple[1:].any():
        spec = mujoco.MjSpec.from_file(str(path))
        for body in spec.bodies:
            body.simple = 0
        model = spec.compile()
    return with_light_meshes(path, model)
