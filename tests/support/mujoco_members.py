"""Members of MuJoCo's enums in models, and small models with features that the engines inside JAX may lack."""

import copy

import mujoco
from mujoco_walk import SWITCHES, compiled

from btr_mjx.engines.computed import CHOICES, FLAGS, MEMBERS, base_field, not_computed
from btr_mjx.models import write_field

LAST = 23
"""A number, or a bit, beyond all members of the enums that models are made of."""


def members(field: str) -> dict[str, int]:
    """Members of a field's enum in the MuJoCo that is installed, without counters, and one that it does not have."""
    enum = getattr(mujoco, {**FLAGS, **MEMBERS}[field][0])
    known = {name: int(value) for name, value in enum.__members__.items() if "_" in name}
    return known | {"of a later version": 1 << LAST if field in FLAGS else LAST + 2000}


def with_value(model: mujoco.MjModel, field: str, value: int) -> mujoco.MjModel:
    """A copy in which the first element of a field has a value; bits are added."""
    out, values = copy.copy(model), base_field(model, field).copy()
    first = values.reshape(-1)
    first[0] = int(first[0]) | value if field in FLAGS else value
    write_field(out, field, values if values.ndim else first[0])
    return out


SAME_MOTION = (
    *("WARMSTART", "SENSOR", "MIDPHASE", "AUTORESET", "NATIVECCD", "ISLAND", "MULTICCD", "ENERGY", "FWDINV"),
    *("INVDISCRETE", "CG", "DENSE", "SPARSE"),
)
"""Options that have no effect on the motion that an exact solver finds."""


def options() -> list[tuple[str, str, int]]:
    """(field, end of the member's name, value) of options that are computed and not the default."""
    default = compiled(SWITCHES)
    return [
        (field, name.partition("_")[2], value)
        for field in CHOICES
        if field.startswith("opt.")
        for name, value in members(field).items()
        if not not_computed(field, value) and int(base_field(default, field)) != value
    ]


ACTUATORS = {
    "pid": "<pid name='x' joint='j' kp='20' kv='1'/>",
    "pid with feedforward": "<pid name='x' joint='j' kp='20' kv='1' ki='2' input='pos vel ff'/>",
    "pid with a limited slope": "<pid name='x' joint='j' kp='20' ki='3' slewmax='0.5' input='pos'/>",
    "dcmotor": "<dcmotor name='x' joint='j' motorconst='0.05' resistance='2'/>",
    "orientation": "<orientation name='x' joint='b' kp='3'/>",
    "pid on a ball": "<pid name='x' joint='b' kp='3' kv='1'/>",
    "adhesion": "<adhesion name='x' body='foot' gain='20' ctrlrange='0 1'/>",
    "muscle": "<muscle name='x' joint='j' lengthrange='0 1'/>",
    "site": "<general name='x' site='s' gear='0 0 1 0 0 0'/>",
    "slider-crank": "<general name='x' cranksite='s' slidersite='t' cranklength='1'/>",
    "early activation": "<general name='x' joint='j' dyntype='filter' dynprm='0.1' actearly='true'/>",
    "damping of an actuator": "<motor name='x' joint='j' damping='0.5'/>",
    "armature of an actuator": "<motor name='x' joint='j' armature='0.5'/>",
}
OTHERS = {
    "surface velocity": ("geom", "surfacevel='0.5 0 0 0 0 0'"),
    "adhesion of a geom": ("geom", "adhesion='3'"),
    "polynomial damping": ("joint", "damping='0.1 0.2 0.3'"),
    "polynomial stiffness": ("joint", "stiffness='1 20 3'"),
}


def hopper(actuator: str = "", geom: str = "", joint: str = "") -> str:
    return f"""<mujoco><option timestep="0.004"/><default><geom {geom}/><joint {joint}/></default><worldbody>
<geom type="plane" size="0 0 1"/><site name="t" pos="1 0 1"/>
<body name="foot" pos="0 0 0.095"><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/>
<joint name="j" axis="0 1 0"/><geom size="0.1"/><site name="s" pos="0 0.1 0"/></body>
<body pos="2 0 2"><joint name="b" type="ball"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body></worldbody>
<actuator><motor joint="j"/>{actuator}</actuator></mujoco>"""
