"""Small models for the lanes engine's tests, of all joints, contacts, actuators and options; and comparisons."""

import mujoco
import numpy as np

QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
"""Options with which a program that runs once compiles in a fraction of the time; its bits are not those of users."""

_WORLD = """<mujoco><option timestep="0.002" {option}><flag {flags}/></option>
<default><geom contype="0" conaffinity="1"/></default><worldbody>
<geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="0" friction="0.7" {floor}/>{bodies}</worldbody>
<actuator>{actuators}</actuator></mujoco>"""


def mjcf(bodies: str, *, option: str = "", flags: str = "", floor: str = "", actuators: str = "") -> str:
    """A floor, bodies over it and actuators."""
    return _WORLD.format(bodies=bodies, option=option, flags=flags, floor=floor, actuators=actuators)


def chain(count: int) -> str:
    """A pendulum of `count` links on hinges with skew axes, all with damping and armature, one with a spring."""
    opened = ""
    for i in range(count):
        spring = 'stiffness="3" springref="0.2"' if i == 1 else ""
        opened += (
            f'<body pos="{0.1 if i else 0} 0.05 -0.3"><joint name="p{i}" axis="{i % 2} 1 {0.3 * i}" damping="0.02" '
            f'armature="0.01" {spring}/><geom type="capsule" fromto="0 0 0 0.1 0.05 -0.3" size="0.03" conaffinity="0"/>'
        )
    return opened + "</body>" * count


SERVOS = """<motor joint="p0" gear="3" ctrlrange="-0.1 0.1"/>
<position joint="p1" kp="30" kv="2" forcerange="-1 1" gear="2"/>
<velocity joint="p2" kv="3"/><pid joint="p3" kp="20" ki="4" kv="1" input="pos"/>
<pid joint="p0" kp="5" ki="2" imax="0.05" input="pos"/>"""

GENERAL = """<general joint="p0" dyntype="filter" dynprm="0.1" gainprm="3" biastype="affine" biasprm="1 -2 -0.3"/>
<general joint="p1" dyntype="integrator" gainprm="3" actlimited="true" actrange="-0.05 0.05"/>
<general joint="p2" dyntype="filterexact" dynprm="0.1" gaintype="affine" gainprm="3 1 0.5"/>"""


def spheres_box() -> str:
    """A free box with a sphere on each corner."""
    corners = "".join(
        f'<geom type="sphere" size="0.03" pos="{x} {y} {z}"/>'
        for x in (-0.1, 0.1)
        for y in (-0.15, 0.15)
        for z in (-0.2, 0.2)
    )
    box = '<geom type="box" size="0.1 0.15 0.2" conaffinity="0" pos="0.01 0.02 0"/>'
    return f'<body pos="0 0 1" euler="10 20 30"><freejoint/>{box}{corners}</body>'


def plain_box() -> str:
    """A free box that touches with its corners."""
    return '<body pos="0 0 1" euler="10 20 30"><freejoint/><geom type="box" size="0.1 0.15 0.2"/></body>'


def ball(place: str) -> str:
    """A free ball with an eccentric mass."""
    weight = '<geom type="box" size="0.02 0.05 0.03" pos="0.02 0.01 0.03" conaffinity="0"/>'
    return f'<body pos="{place}"><freejoint/><geom type="sphere" size="0.1"/>{weight}</body>'


def quadruped() -> str:
    """Four alike legs of capsules, with limits, contact margins and solver parameters of their own."""
    legs = ""
    for x in (-0.2, 0.2):
        for y in (-0.1, 0.1):
            legs += f"""<body pos="{x} {y} 0"><joint name="hip{x}{y}" axis="1 0 0"/>
            <joint name="thigh{x}{y}" axis="0 1 0" range="-60 15" limited="true"/>
            <geom type="capsule" fromto="0 0 0 {x} {y} -0.1" size="0.03" margin="0.002" solimp="0.8 0.95 0.01 0.5 1"/>
            <body pos="{x} {y} -0.1"><joint name="knee{x}{y}" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02"/></body></body>"""
    return f'<body pos="0 0 0.5"><freejoint/><geom type="capsule" fromto="-0.2 0 0 0.2 0 0" size="0.07"/>{legs}</body>'


QUADRUPED_SERVOS = "".join(
    f'<position joint="{joint}{x}{y}" kp="20" kv="1"/>'
    for x in (-0.2, 0.2)
    for y in (-0.1, 0.1)
    for joint in ("hip", "thigh", "knee")
)


def biped() -> str:
    """A planar trunk on two slides and a hinge; telescopic legs on springs; frictionless and stiff contacts."""
    legs = ""
    for y in (-0.1, 0.1):
        legs += f"""<body pos="0 {y} 0"><joint name="hip{y}" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.04" conaffinity="0"/>
        <body pos="0 0 -0.3"><joint type="slide" axis="0 0 1" range="-0.1 0.1" limited="true" stiffness="100"
        damping="3"/>
        <geom type="sphere" pos="0 0 -0.6" size="0.05" condim="1"/>
        <geom type="sphere" pos="0.05 0 -0.5" size="0.05" solref="-3000 -50" friction="1.2" priority="1"/>
        </body></body>"""
    return f"""<body pos="0 0 1"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.07" conaffinity="0"/>{legs}</body>"""


def snake(joints: int) -> str:
    """A free chain of spheres that bends in turn sideways and up."""
    links = "".join(
        f'<body pos="0.1 0 0"><joint axis="0 {i % 2} {1 - i % 2}" damping="0.05"/>'
        '<geom type="sphere" pos="0.05 0 0" size="0.03" mass="0.1"/>'
        for i in range(joints)
    )
    head = '<geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.03"/>'
    return f'<body pos="0 0 0.3"><freejoint/>{head}{links}{"</body>" * joints}</body>'


def stops() -> str:
    """Hinges off their body's origin and a slide, with limits, margins and dry friction."""
    rod = '<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" conaffinity="0"/>'
    return f"""<body pos="0 0 1"><joint axis="0 1 0" range="-12 12" frictionloss="0.3" margin="0.05"/>{rod}
    <body pos="0.3 0 0"><joint type="slide" axis="1 0 0.2" range="-0.1 0.1" solreflimit="-500 -20" frictionloss="2"/>
    <joint axis="0 0 1" pos="0.05 0 0.1" frictionloss="0.01" range="-17 6" solimplimit="0.5 0.9 0.05 0.3 3"/>{rod}
    </body></body>"""


def tangle(condim: int = 3, friction: float = 0.0) -> str:
    """Two alike arms and two free bodies, spheres and capsules that touch each other and a fixed capsule."""
    arms = ""
    for x in (-0.2, 0.2):
        arms += f"""<body pos="{x} 0 0.4"><joint name="shoulder{x}" axis="0 1 0.1" frictionloss="{friction}"/>
        <geom type="capsule" fromto="0 0 0 0 0.05 -0.2" size="0.03" condim="{condim}" friction="0.6"/>
        <body pos="0 0.05 -0.2"><joint axis="1 0 0.3" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 {-x} 0 -0.1" size="0.04" condim="{condim}" solmix="0.3"/>
        <geom pos="{-x} 0 0" size="0.03" condim="{condim}" margin="0.01" solref="0.03 0.8" mass="0.1"/>
        </body></body>"""
    beam = f'<geom type="capsule" fromto="-0.1 0.1 0.4 0.1 0 0.45" size="0.04" condim="{condim}" priority="1"/>'
    bodies = f"""{arms}{beam}
    <body pos="0 0 0.3"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <geom size="0.08" condim="{condim}" mass="0.3"/></body>"""
    return bodies.replace("<geom", '<geom contype="1"')


def rolling(bodies: str, condim: int) -> str:
    """The bodies with torsional and, for condim 6, rolling friction, large enough for their feet to stick."""
    return bodies.replace("<geom ", f'<geom condim="{condim}" friction="0.6 0.08 0.03" ')


WATER = 'density="1000" viscosity="0.5" wind="1 2 3"'
FAST = 'integrator="implicitfast"'

TENDON_MOTORS = (
    """<motor tendon="all" gear="3"/><position tendon="first" kp="20" kv="1" gear="0.7" forcerange="-1 1"/>"""
)
TENDON_SERVO = '<position tendon="all" kp="20" gear="0.7"/>'


def tendons(text: str, joints: tuple[str, ...] = ("hip-0.1", "hip0.1"), damping: float = 0.3) -> str:
    """The model with fixed tendons over some of its joints: a spring, a damper, and one without influence."""
    both = "".join(f'<joint joint="{joint}" coef="{1 - 1.7 * i}"/>' for i, joint in enumerate(joints))
    return text.replace(
        "<actuator>",
        f"""<tendon><fixed name="all" stiffness="4" damping="{damping}" springlength="-0.05 0.03">{both}</fixed>
        <fixed name="first" stiffness="3"><joint joint="{joints[0]}" coef="2"/></fixed><fixed name="idle">{both}</fixed>
        </tendon><actuator>""",
    )


CASES = {
    "tangle": mjcf(tangle(), option=FAST),
    "tangle_condim1_rk4": mjcf(tangle(condim=1), option='integrator="RK4"'),
    "tangle_elliptic": mjcf(tangle(), option='cone="elliptic" impratio="3"'),
    "tangle_friction": mjcf(tangle(friction=0.2)),
    "pendulum_euler": mjcf(chain(4), actuators=SERVOS),
    "pendulum_implicitfast": mjcf(chain(4), option=FAST, actuators=SERVOS),
    "pendulum_states": mjcf(chain(3), option='gravity="1 -2 -9"', flags='eulerdamp="disable"', actuators=GENERAL),
    "pendulum_in_water": mjcf(chain(3), option=f"{FAST} {WATER}"),
    "spheres_box": mjcf(spheres_box(), option=FAST),
    "spheres_box_in_water": mjcf(spheres_box(), option=f"{FAST} {WATER}"),
    "spheres_box_elliptic_slope": mjcf(
        spheres_box(), option='cone="elliptic" impratio="2"', floor='euler="10 -15 20" pos="0 0 0.2"'
    ),
    "box_corners": mjcf(plain_box()),
    "two_balls": mjcf(ball("-1 0 1") + ball("1 0 1"), option=FAST),
    "quadruped": mjcf(quadruped(), option=FAST, actuators=QUADRUPED_SERVOS),
    "quadruped_elliptic": mjcf(quadruped(), option=f'{FAST} cone="elliptic"', actuators=QUADRUPED_SERVOS),
    "box_corners_condim4": mjcf(rolling(plain_box(), 4)),
    "spheres_box_condim6": mjcf(rolling(spheres_box(), 6), option='impratio="3"'),
    "two_balls_condim4_elliptic": mjcf(
        rolling(ball("-1 0 1") + ball("1 0 1"), 4), option='cone="elliptic"', floor='euler="10 -15 20" pos="0 0 0.2"'
    ),
    "quadruped_condim4": mjcf(rolling(quadruped(), 4), option='integrator="RK4"', actuators=QUADRUPED_SERVOS),
    "capsule_condim6_elliptic": mjcf(
        rolling(plain_box().replace("box", "capsule"), 6), option=f'{FAST} cone="elliptic" impratio="3"'
    ),
    "cylinder_condim6": mjcf(rolling(plain_box().replace('type="box"', 'type="cylinder"'), 6)),
    "ellipsoid_condim6_elliptic": mjcf(
        rolling(plain_box().replace('type="box"', 'type="ellipsoid"'), 6), option='cone="elliptic"'
    ),
    "tangle_condim6": mjcf(rolling(tangle().replace('condim="3"', "").replace('friction="0.6"', ""), 6)),
    "biped": mjcf(biped(), actuators='<motor joint="hip-0.1"/><motor joint="hip0.1"/>'),
    "snake": mjcf(snake(20)),
    "stops": mjcf(stops()),
    "cylinder": mjcf(plain_box().replace('type="box"', 'type="cylinder"')),
    "cylinder_slope": mjcf(
        plain_box().replace('type="box"', 'type="cylinder"'),
        option='cone="elliptic"',
        floor='euler="10 -15 20" pos="0 0 0.2"',
    ),
    "ellipsoid": mjcf(plain_box().replace('type="box"', 'type="ellipsoid"'), floor='euler="10 -15 20" pos="0 0 0.2"'),
    "tendons": tendons(mjcf(biped(), actuators='<motor joint="hip-0.1"/>' + TENDON_MOTORS)),
    "tendons_implicitfast": tendons(mjcf(biped(), option=FAST, actuators=TENDON_SERVO), damping=0),
    "pendulum_tendons_rk4": tendons(
        mjcf(chain(4), option='integrator="RK4"', actuators=TENDON_MOTORS), ("p0", "p1", "p3")
    ),
    "quadruped_rk4": mjcf(quadruped(), option='integrator="RK4"', actuators=QUADRUPED_SERVOS),
    "spheres_box_in_water_rk4": mjcf(spheres_box(), option=f'integrator="RK4" cone="elliptic" {WATER}'),
    "pendulum_rk4": mjcf(chain(4), option='integrator="RK4"', actuators='<motor joint="p0" gear="3"/>'),
}


def columns(states: list[mujoco.MjData], *names: str) -> list[np.ndarray]:
    """Fields of some states, one state a column: (width, count) each."""
    return [np.stack([getattr(d, name) for d in states], axis=1) for name in names]


def exact(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with a solver that goes on until it is exact."""
    model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 100, 0
    return model


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance of a column from what is expected, relative to its size."""
    return float((np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0).clip(1e-3)).max())
