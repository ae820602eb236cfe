"""How well the numbers of a good model are known outside a laboratory: calibration, which is no missing effect."""

TIMING = "actuator_delay"
"""Effect that is calibration where all commands share it: the time within a sample at which they act."""

OF_LOG = (TIMING, "torque_constant")
"""Effects that belong to a log where they are calibration, and not to the robot."""

TIME_IN_SAMPLE = 0.29
"""1 sigma of the time at which a command acts, in intervals of commands: anywhere within one."""

_FIELD = 5.0
"""Tolerances outside a laboratory, in units of those of the library. With those of the library five of eight walking
robots that lacked nothing, with faults of data, were said to lack damping, gains or a lag, with these none
(`benchmarks/field_gate.py --robot legged --nulls --cases 8 --seed 2`)."""

_FACTORS = {"viscous_damping": 10.0, "armature": 10.0, "ground_slope": 1.0, "torque_constant": 1.0}
"""The same of what nobody measures (damping, rotor inertia), and of what a spirit level tells."""


def field_tolerance(effect: str, tolerance: float) -> float:
    """1 sigma of a number outside a laboratory.

    Args:
      effect: name of the effect that the number belongs to.
      tolerance: 1 sigma that the library has for it; 0 for none.
    """
    return _FACTORS.get(effect, _FIELD) * tolerance
