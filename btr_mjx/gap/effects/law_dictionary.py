"""Laws: forces of the state that no physical effect of the library is, as terms of a dictionary.

A law is a sum of terms at a joint, each a few basis functions with coefficients and at most one number within them
(ripples per radian, an angle, a frequency). A term is an effect like any other: its force is simulated, refined and
played by a `Callback`. Forces of basis functions need no simulation, so that a scan tries all of them in seconds.

A term of one's own is one more entry:

    from btr_mjx.gap.effects import LawTerm, law_effect

    mine = law_effect(LawTerm("law_sticky_speed", ("v / (1 + v²)",), (r"v / (1 + v^2)",), ("{f} s/{x}",),
                          lambda at, number: (at.v / (1 + at.v**2),), ("velocity",), "a force that fades"))

    python -m btr_mjx.diagnose robot.xml log.csv --effects all laws.py:mine
"""

import numpy as np

from btr_mjx.gap.effects.effect import Effect
from btr_mjx.gap.effects.law_effects import law_effect
from btr_mjx.gap.effects.law_terms import LawTerm, Tried

_COARSEST, _FINEST = 0.5, 60.0
"""Radians of phase of a ripple over half the range of a joint's motion: the fewest that are tried, which is also the
distance from one to the next, and the most."""

_TEETH = 24.0
"""Ripples per radian that are tried whatever the range of the motion."""

_FASTEST = 2 * np.pi * 25
"""Largest frequency of a law in time [rad/s]."""

_SLOWEST = 2 * np.pi * 0.2
"""Smallest one."""


def _ripples(q: np.ndarray) -> np.ndarray:
    """Ripples per radian or metre, half a radian of phase apart over half the range of motion."""
    reach = max(0.5 * float(np.ptp(q)), 1e-9)
    return np.arange(_COARSEST, max(_FINEST, _TEETH * reach), _COARSEST) / reach


def _frequencies(q: np.ndarray) -> np.ndarray:
    """Frequencies in time, as far apart as some ten seconds can tell."""
    return np.arange(_SLOWEST, _FASTEST, 0.25 * _SLOWEST)


def _corners(q: np.ndarray) -> np.ndarray:
    """Positions at which a spring may begin."""
    return np.quantile(q, np.linspace(0.1, 0.9, 9))


_PER_POSITION = Tried(
    "ripples", "1/{x}", _ripples, lambda reach: (0.5 * _COARSEST / reach, 2 * max(_FINEST / reach, _TEETH))
)

LAWS: tuple[LawTerm, ...] = (
    LawTerm(
        "law_ripple",
        ("sin({n} q)", "cos({n} q)"),
        (r"\sin({n} q)", r"\cos({n} q)"),
        ("{f}", "{f}"),
        lambda at, n: (np.sin(n * at.q), np.cos(n * at.q)),
        ("position",),
        "a ripple",
        _PER_POSITION,
    ),
    LawTerm(
        "law_uneven_friction",
        ("sin({n} q)", "cos({n} q)"),
        (r"\sin({n} q)", r"\cos({n} q)"),
        ("{f}", "{f}"),
        lambda at, n: (np.sin(n * at.q), np.cos(n * at.q)),
        ("position", "velocity"),
        "friction that differs with the position",
        _PER_POSITION,
        friction=True,
    ),
    LawTerm(
        "law_periodic",
        ("sin({n} t)", "cos({n} t)"),
        (r"\sin({n} t)", r"\cos({n} t)"),
        ("{f}", "{f}"),
        lambda at, n: (np.sin(n * at.time), np.cos(n * at.time)),
        ("time",),
        "a force that is periodic in time",
        Tried("frequency", "rad/s", _frequencies, lambda reach: (0.5 * _SLOWEST, 2 * _FASTEST)),
    ),
    LawTerm(
        "law_corner_spring",
        ("max(q − {n}, 0)", "min(q − {n}, 0)"),
        (r"\max(q - {n}, 0)", r"\min(q - {n}, 0)"),
        ("{f}/{x}", "{f}/{x}"),
        lambda at, n: (np.maximum(at.q - n, 0.0), np.minimum(at.q - n, 0.0)),
        ("position",),
        "a spring with a corner",
        Tried("corner", "{x}", _corners, lambda reach: (-1e3, 1e3)),
    ),
    LawTerm(
        "law_square_position",
        ("q²",),
        ("q^2",),
        ("{f}/{x}^2",),
        lambda at, n: (at.q**2,),
        ("position",),
        "a force of the squared position",
    ),
    LawTerm(
        "law_cubic_position",
        ("q³",),
        ("q^3",),
        ("{f}/{x}^3",),
        lambda at, n: (at.q**3,),
        ("position",),
        "a force of the cubed position",
    ),
    LawTerm(
        "law_quadratic_drag",
        ("|v| v",),
        ("|v| v",),
        ("{f} s^2/{x}^2",),
        lambda at, n: (np.abs(at.v) * at.v,),
        ("velocity",),
        "quadratic drag",
    ),
    LawTerm(
        "law_speed_position",
        ("q v",),
        ("q v",),
        ("{f} s/{x}^2",),
        lambda at, n: (at.q * at.v,),
        ("velocity", "position"),
        "damping that differs with the position",
    ),
    LawTerm(
        "law_load_position",
        ("q τ_m",),
        (r"q \tau_m",),
        ("1/{x}",),
        lambda at, n: (at.q * at.load,),
        ("load", "position"),
        "a motor whose strength differs with the position",
    ),
    LawTerm(
        "law_load_square",
        ("|τ_m| τ_m",),
        (r"|\tau_m| \tau_m",),
        ("1/({f})",),
        lambda at, n: (np.abs(at.load) * at.load,),
        ("load",),
        "a motor that is not linear",
    ),
    LawTerm(
        "law_load_drift",
        ("t τ_m",),
        (r"t \tau_m",),
        ("1/s",),
        lambda at, n: (at.time * at.load,),
        ("load", "time"),
        "a motor whose strength drifts",
    ),
    LawTerm("law_drift", ("t",), ("t",), ("{f}/s",), lambda at, n: (at.time,), ("time",), "a force that drifts"),
    LawTerm(
        "law_coupling",
        ("q_{o}",),
        (r"q_\mathrm{{{o}}}",),
        ("{f}/{x}",),
        lambda at, n: (at.other_q,),
        (),
        "a force that follows another joint",
        coupled=True,
    ),
    LawTerm(
        "law_coupled_speed",
        ("v_{o}",),
        (r"v_\mathrm{{{o}}}",),
        ("{f} s/{x}",),
        lambda at, n: (at.other_v,),
        (),
        "a force that follows the speed of another joint",
        coupled=True,
    ),
)
"""The dictionary."""

LAW_EFFECTS: tuple[Effect, ...] = tuple(law_effect(law) for law in LAWS)
"""Its terms as effects."""
