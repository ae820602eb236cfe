"""Every number of a model moved a little, one at a time: what native MuJoCo and what `lanes` make of it."""

import copy
from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from lanes_models import QUICK, exact

from btr_mjx.engines import LanesStepper
from btr_mjx.engines.computed import base_field
from btr_mjx.models import write_field

FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
STEPS = 3
SPREADS = (1.0, 0.2, 0.03)
"""How far states are from the reference, and how fast."""
FOLLOWED = 1e-9
"""Largest error of what follows native MuJoCo, and smallest change that counts as one, relative to the state."""

_OPTION = '<option timestep="0.004" {option}><flag midphase="disable"/></option>'

TREE = f"""<mujoco>{_OPTION.format(option='density="900" viscosity="0.3" wind="1 0.5 0.2" {option}')}<worldbody>
<body name="root" pos="0 0 2" gravcomp="0.3"><freejoint/>
<geom type="box" size="0.1 0.15 0.05" mass="2" contype="0" conaffinity="0"/>
<site name="imu"/>
<body name="arm" pos="0.2 0 0.1" euler="10 20 30"><joint name="hinge" axis="0 1 0.3" pos="0.01 0.02 0" range="-10 12"
 margin="0.02" damping="0.3" armature="0.02" frictionloss="0.2" stiffness="3" springref="8" ref="3"
 actuatorfrcrange="-0.8 0.8"/><joint name="yaw" axis="0.2 0 1" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0.05" size="0.03" mass="0.7" contype="0" conaffinity="0"/>
<body name="fixed" pos="0.1 0 0.05" gravcomp="0.5"><geom size="0.05" mass="0.1" contype="0" conaffinity="0"/></body>
<body name="slider" pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0 0.2" range="-0.05 0.06" frictionloss="0.5"
 stiffness="20" springref="0.02" damping="1"/>
<geom type="capsule" fromto="0 0 0 0 0.1 -0.2" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
<body name="hand" pos="0 0.1 -0.2"><joint name="ball" type="ball" damping="0.05" stiffness="0.6" armature="0.003"
 {{ball}}/><geom type="capsule" fromto="0 0 0 0.05 0 -0.2" size="0.02" mass="0.2" contype="0" conaffinity="0"/>
</body></body></body></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="2" gear="1.5"/>
<motor joint="yaw" ctrlrange="-0.2 0.15"/>
<motor jointinparent="slide" gear="0.5"/>
<cylinder joint="hinge" area="0.3" timeconst="0.05" bias="0.1 -1 -0.2"/>
<general joint="yaw" dyntype="filterexact" dynprm="0.05" gaintype="affine" gainprm="2 0.3 0.1" biastype="affine"
 biasprm="0.1 -2 -0.3" actlimited="true" actrange="-0.1 0.1"/>
<motor joint="slide" gear="3" delay="0.006" nsample="4" interp="linear" forcerange="-0.3 0.25"/>
<pid joint="yaw" kp="5" ki="2" kv="0.2" imax="0.05" input="pos"/></actuator>
<sensor><gyro site="imu" noise="0.1" cutoff="3"/></sensor>
<keyframe><key qpos="0 0 2 1 0 0 0 0 0 0 1 0 0 0"/></keyframe></mujoco>"""

TENDONS = f"""<mujoco>{_OPTION.format(option="{option}")}<worldbody>
<body><joint name="a" axis="0 1 0" damping="0.05"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<body pos="0.3 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<body pos="0.3 0 0"><joint name="c" axis="0 0.2 1"/><geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02"/></body>
</body></body></worldbody>
<tendon><fixed name="pull" range="-0.02 0.01" limited="true" margin="0.01" frictionloss="0.2" stiffness="4"
 damping="{{damping}}" springlength="-0.005 0.004"><joint joint="a" coef="1.2"/><joint joint="b" coef="-0.7"/></fixed>
<fixed name="other"><joint joint="b" coef="0.6"/><joint joint="c" coef="1"/></fixed></tendon>
<equality><joint joint1="a" joint2="c" polycoef="0.02 0.8 0.1 0.05 0.02"/>
<tendon tendon1="other" tendon2="pull" polycoef="0.01 0.5 0.1 0 0"/></equality>
<actuator><motor tendon="pull" gear="2"/><position tendon="other" kp="10" gear="0.7" forcerange="-1 1"/></actuator>
</mujoco>"""

CONTACTS = f"""<mujoco>{_OPTION.format(option='impratio="2" {option}')}<worldbody>
<geom name="floor" type="plane" size="0 0 1" pos="0 0 0.02" friction="0.7 0.02 0.01" solmix="0.8" solref="0.03 0.9"/>
<body name="one" pos="0 0 0.1"><freejoint/><geom name="one" size="0.1" condim="4" margin="0.03" gap="0.01" mass="0.5"
 solimp="0.8 0.95 0.01 0.4 2" solref="0.025 1.1"/></body>
<body name="two" pos="0.19 0 0.12"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
<joint axis="0 1 0"/><geom name="two" type="capsule" size="0.1 0.05" condim="3" mass="0.4" margin="0.02"/></body>
<body name="three" pos="-1 0 0.1"><joint type="slide" axis="0 0 1"/><joint axis="0 1 0"/>
<geom name="three" type="box" size="0.1 0.12 0.1" priority="1"/></body>
<body name="far" pos="5 0 3"><joint type="slide"/><geom name="far" type="box" size="0.1 0.1 0.1"/></body>
<body name="four" pos="1 0 0.12"><joint type="slide" axis="0 0 1"/><joint axis="0.1 1 0"/>
<geom name="four" size="0.11" mass="0.3"/></body></worldbody>
<contact><pair name="own" geom1="four" geom2="floor" condim="6" friction="0.5 0.5 0.02 0.01 0.01" margin="0.03"
 gap="0.01" solref="0.03 0.8" solimp="0.7 0.9 0.01 0.5 2"/><exclude body1="far" body2="one"/></contact></mujoco>"""

CLOSED = f"""<mujoco>{_OPTION.format(option="{option}")}<worldbody>
<body name="a" pos="0 0 1"><joint axis="0 1 0" damping="0.1"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<body name="b" pos="0.3 0 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
<site name="end" pos="0 0 -0.3" euler="5 10 0"/></body></body>
<body name="c" pos="0 0 0.7"><joint axis="0 1 0.1"/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
<site name="tip" pos="0.3 0.02 0" euler="0 12 3"/></body>
<body name="d" pos="0 0.5 1"><freejoint/><geom type="box" size="0.05 0.06 0.07"/></body></worldbody>
<equality><weld site1="end" site2="tip" torquescale="0.7"/>
<connect body1="c" body2="a" anchor="0.3 0.02 0.3" solref="0.03 0.9"/>
<weld body1="d" body2="a" relpose="0.01 0.5 0 1 0.1 0 0" torquescale="0.5"/></equality></mujoco>"""

SWITCHES = f"""<mujoco>{_OPTION.format(option="")}<worldbody><geom name="floor" type="plane" size="0 0 1"/>
<body pos="0 0 0.095"><joint name="up" type="slide" axis="0 0 1" damping="0.3"/>
<joint name="turn" axis="0 1 0" stiffness="2" springref="20" range="-3 -1" limited="true" frictionloss="0.1"/>
<geom size="0.1" pos="0.01 0 0" solref="0.004 1" priority="1"/>
<body pos="0.15 0 0.05"><joint name="swing" axis="0 1 0"/>
<geom size="0.1"/></body></body></worldbody>
<equality><joint joint1="swing" joint2="turn" polycoef="0.1 0.5 0 0 0"/></equality>
<actuator><motor joint="turn" gear="3" ctrlrange="-0.1 0.1"/><velocity joint="swing" kv="0.5"/></actuator></mujoco>"""
"""A model on whose motion every option has its effect."""

MODELS = {
    "tree": TREE.format(option="", ball='frictionloss="0.02"'),
    "tree_fast": TREE.format(option='integrator="implicitfast"', ball='range="0 15" limited="true"'),
    "tendons": TENDONS.format(option="", damping="0.3"),
    "tendons_fast": TENDONS.format(option='integrator="implicitfast"', damping="0"),
    "contacts": CONTACTS.format(option=""),
    "contacts_elliptic": CONTACTS.format(option='cone="elliptic"'),
    "closed": CLOSED.format(option='integrator="implicitfast"'),
}
"""Models that hold together every kind of element of which `lanes` computes something."""


def compiled(text: str) -> mujoco.MjModel:
    """The model with an exact solver, and without MuJoCo's shortcuts, which hold for the unedited model only."""
    spec = mujoco.MjSpec.from_string(text)
    for body in spec.bodies:
        body.simple = 0
    model = exact(spec.compile())
    for shortcut in (model.body_sameframe, model.geom_sameframe, model.site_sameframe):
        shortcut[:] = 0
    model.geom_rbound[model.geom_rbound > 0] += 0.1
    return model


@dataclass(frozen=True)
class Starts:
    """States and controls from which models are stepped, one a row."""

    qpos: np.ndarray
    qvel: np.ndarray
    act: np.ndarray
    ctrl: np.ndarray


def starts(model: mujoco.MjModel, rng: np.random.Generator) -> Starts:
    """States near the reference, in which bodies that rest on each other in it still touch."""
    reach = 0.2 if not model.nexclude else 0.02
    found: tuple[list[np.ndarray], ...] = ([], [], [], [])
    for spread in SPREADS:
        qpos = np.array(model.qpos0)
        mujoco.mj_integratePos(model, qpos, rng.normal(size=model.nv), reach * spread)
        rows = qpos, spread * rng.normal(size=model.nv), 0.1 * rng.normal(size=model.na), rng.uniform(-1, 1, model.nu)
        for column, row in zip(found, rows, strict=True):
            column.append(row)
    return Starts(*map(np.stack, found))


def native(model: mujoco.MjModel, begin: Starts) -> np.ndarray:
    """States (rows, nq + nv + na) after some steps of native MuJoCo; controls change in every step."""
    out = []
    for qpos, qvel, act, ctrl in zip(begin.qpos, begin.qvel, begin.act, begin.ctrl, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.act[:] = qpos, qvel, act
        for step in range(STEPS):
            data.ctrl[:] = ctrl * (1 - 0.5 * step)
            mujoco.mj_step(model, data)
        out.append(np.concatenate([data.qpos, data.qvel, data.act]))
    return np.stack(out)


def by_lanes(
    model: mujoco.MjModel, begin: Starts, leaves: dict[str, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The same by `lanes`, and which rows its guards leave to native MuJoCo; leaves are (rows, *field shape)."""
    with jax.enable_x64(True):
        stepper = LanesStepper(model, frozenset(leaves or {}), guards=True)
        packed = stepper.pack({name: values[None] for name, values in (leaves or {}).items()})
        params = jax.tree.map(lambda x: x[0], packed)
        step = jax.jit(stepper.step, compiler_options=QUICK)
        state = stepper.state(begin.qpos.T, begin.qvel.T, begin.act.T)
        for k in range(STEPS):
            state = step(params, state, jnp.asarray(begin.ctrl.T * (1 - 0.5 * k)))
        parts = [np.asarray(read(state)) for read in (stepper.qpos, stepper.qvel, stepper.act)]
        return np.concatenate(parts).T, np.asarray(stepper.tripped(state))


def difference(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Distance of every row from what is expected, relative to its size."""
    return np.linalg.norm(found - expected, axis=-1) / np.maximum(np.linalg.norm(expected, axis=-1), 1e-3)


def float_fields(model: mujoco.MjModel) -> Iterator[str]:
    """Names of all arrays and options of a model that hold real numbers."""
    for name in sorted(dir(model)):
        value = None if name.startswith("_") else getattr(model, name)
        if isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
            yield name
    for name in sorted(dir(model.opt)):
        if not name.startswith("_") and isinstance(getattr(model.opt, name), float | np.ndarray):
            yield f"opt.{name}"


def moved(model: mujoco.MjModel, field: str, element: int) -> mujoco.MjModel:
    """A copy of which one element (row) of a field is a little larger; what is a direction keeps its length."""
    values = base_field(model, field).copy()
    rows = values.reshape(len(values), -1) if values.ndim else values.reshape(1, 1)
    wobble = 1 + 0.3 * np.sin(1 + np.arange(rows.shape[1]))
    rows[element] += np.where(rows[element] == 0, 0.006, 0.04 * np.abs(rows[element])) * wobble
    if field.endswith("quat") or field == "jnt_axis":
        rows[element] /= np.linalg.norm(rows[element])
    if field == "eq_data" and model.eq_type[element] == mujoco.mjtEq.mjEQ_WELD:
        rows[element, 6:10] /= np.linalg.norm(rows[element, 6:10])
    out = copy.copy(model)
    if field in ("qpos0", "qpos_spring"):
        for joint in np.flatnonzero(np.isin(model.jnt_type, (FREE, BALL))):
            first = model.jnt_qposadr[joint] + (3 if model.jnt_type[joint] == FREE else 0)
            values[first : first + 4] /= np.linalg.norm(values[first : first + 4])
    write_field(out, field, values if values.ndim else rows[0, 0])
    return out


def elements(model: mujoco.MjModel, field: str) -> range:
    """Rows of a field; of long ones the first few."""
    values = base_field(model, field)
    return range(min(len(values), 40) if values.ndim else 1)
