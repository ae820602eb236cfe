"""The model of one simulation: its rendered MJCF, compiled by MuJoCo, with the robot's edits."""

import copy
import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.models.mjcf_checks import check_mjcf
from btr_mjx.models.model_checks import COMPILE_ERRORS, check_model
from btr_mjx.models.path_parameters import PathParameter
from btr_mjx.models.paths import nearest_names
from btr_mjx.robots import Robot
from btr_mjx.runs import content_digest, read_limited


@lru_cache(maxsize=16)
def base_model(robot: Robot) -> mujoco.MjModel:
    """The compiled model of the nominal simulation (shared: do not edit it)."""
    return model_of(robot, robot.nominal_simulation)


def model_of(robot: Robot, simulation: np.ndarray) -> mujoco.MjModel:
    """The model of one simulation (n_s,): its rendered MJCF, compiled, with the robot's edits.

    Raises:
      InputError: a template that does not render, MJCF that MuJoCo does not accept, a number that cannot be set.
    """
    return general_model(robot, simulation) if robot.edits else compile_mjcf(robot, robot.render(simulation))


def general_model(robot: Robot, simulation: np.ndarray) -> mujoco.MjModel:
    """The same, compiled without MuJoCo's short cut for bodies of simple inertia, so that any edit is possible."""
    model = copy.copy(unedited_model(robot, robot.render(simulation)))
    editor_of(robot, model)(model, simulation)
    return model


def unedited_model(robot: Robot, text: str) -> mujoco.MjModel:
    """The model of a rendered text as edits expect it, before them (shared: do not edit it)."""
    inputs = replace(  # what models depend on, as a key of the cache
        robot, edits=(), name="", duration=1.0, speed_limit=1.0, base_body=None, point="", target=(), keyframe=""
    )
    return _general_text(inputs, text)


@lru_cache(maxsize=16)
def _general_text(robot: Robot, text: str) -> mujoco.MjModel:
    return compile_mjcf(robot, text, general=True)


def editor_of(robot: Robot, model: mujoco.MjModel) -> Callable[[mujoco.MjModel, np.ndarray], None]:
    """A function that sets one simulation (n_s,) in place in a model with the parts of `model`.

    It makes the robot's edits, whose paths are looked up once, and lets MuJoCo derive the constants (mj_setConst). The
    model that it is given must hold the numbers that MuJoCo compiled.
    """
    data = mujoco.MjData(model)
    edits = [
        (
            edit.resolved(model) if isinstance(edit, PathParameter) else edit,
            [robot.simulation_box.index(name) for name in edit.parameters],
        )
        for edit in robot.edits
    ]

    def set_simulation(edited: mujoco.MjModel, simulation: np.ndarray) -> None:
        for edit, index in edits:
            edit(edited, simulation[index].tolist())
        mujoco.mj_setConst(edited, data)

    return set_simulation


def start_of(robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The state in which trials start: qpos (nq,), qvel (nv,) and act (na,); None for the model's qpos0 at rest.

    Raises:
      InputError: a keyframe that the model does not have.
    """
    if not robot.keyframe:
        return None
    model = base_model(robot)
    names = [model.key(i).name for i in range(model.nkey)]
    if robot.keyframe not in names:
        raise InputError(f"keyframe {robot.keyframe!r}: the model has {nearest_names(robot.keyframe, names)}")
    i = names.index(robot.keyframe)
    return model.key_qpos[i].copy(), model.key_qvel[i].copy(), model.key_act[i].copy()


def compile_mjcf(robot: Robot, xml: str, general: bool = False) -> mujoco.MjModel:
    """Compile rendered MJCF; if general, no body counts as simple.

    Raises:
      InputError: MuJoCo rejects it; the message has the template's name, the line number and the line's text.
    """
    check_mjcf(xml, robot.template_path, Path(robot.folder or "."))
    try:
        if not robot.folder and not general:
            model = mujoco.MjModel.from_xml_string(xml)
        else:
            spec = mjcf_spec(robot, xml)
            for body in spec.bodies if general else ():
                body.simple = 0
            model = spec.compile()
        check_model(model, robot.template_path)
        return model
    except InputError:
        raise
    except COMPILE_ERRORS as error:
        message = " ".join(str(error).split())
        found = re.search(r"[Ll]ine (?:number=)?(\d+)", message)  # two forms: MuJoCo's own and its XML parser's
        shown = ""
        if found and 0 < int(found[1]) <= len(xml.splitlines()):
            shown = f"; line {found[1]} of the rendered MJCF reads: {xml.splitlines()[int(found[1]) - 1].strip()}"
        raise InputError(f"{robot.template_path}: MuJoCo does not accept the model: {message}{shown}") from None


def mjcf_spec(robot: Robot, xml: str) -> mujoco.MjSpec:
    """The specification of rendered MJCF, with the files that it includes.

    Raises:
      ValueError: MuJoCo rejects it.
    """
    spec = mujoco.MjSpec.from_string(xml, include=_included_files(Path(robot.folder or "."), xml))
    spec.modelfiledir = robot.folder
    return spec


def _included_files(folder: Path, xml: str) -> dict[str, bytes]:
    """Contents of the files that MJCF includes, and of those that these include, by the names it uses for them."""
    found: dict[str, bytes] = {}
    left = [xml]
    while left:
        for name in re.findall(r"<include[^>]*\sfile\s*=\s*[\"']([^\"']+)[\"']", left.pop()):
            if name not in found and (folder / name).is_file():
                found[name] = read_limited(folder / name)
                left.append(found[name].decode("utf-8", "replace"))
    return found


def robot_digest(robot: Robot) -> str:
    """SHA-256, in hex, of a robot and of its compiled model, which holds the files that its MJCF includes.

    Where these files are does not matter, nor where the file of a fitness function is, nor the robot's name.

    Raises:
      InputError: the model cannot be compiled.
    """
    content = replace(robot, name="", template_path="", folder="", fitness=Path(robot.fitness).name)
    return content_digest(content, base_model(robot))
