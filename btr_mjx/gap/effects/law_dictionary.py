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

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Candidate, Effect, Parameter
from btr_mjx.gap.effects.law_terms import LawState, LawTerm, Tried
from btr_mjx.gap.effects.places import Place, joint_places
from btr_mjx.gap.effects.ranges import Scales, unit_of
from btr_mjx.gap.simulate import Rows, World

_FROM = " from "
"""Between the names of two joints, in the label of a place."""

_LARGEST = 3.0
"""Largest force of a law, in peak torques of the joint."""

_STEP = 0.05
"""Step of a coefficient, in the same unit."""

_COARSEST, _FINEST = 0.5, 60.0
"""Radians of phase of a ripple over half the range of a joint's motion: the fewest that are tried, which is also the
distance from one to the next, and the most."""

_TEETH = 24.0
"""Ripples per radian that are tried whatever the range of the motion."""

_FASTEST = 2 * np.pi * 25
"""Largest frequency of a law in time [rad/s]."""

_SLOWEST = 2 * np.pi * 0.2
"""Smallest one."""


@dataclass(frozen=True)
class LawForce:
    """A law in a simulation.

    Attributes:
      law: the term.
      joint: id of the joint where it acts.
      other: id of the other joint.
      values: coefficients, and the number within.
    """

    law: LawTerm
    joint: int
    other: int
    values: tuple[float, ...]

    @property
    def fields(self) -> tuple[str, ...]:
        """The friction loss, of a friction torque."""
        return ("dof_frictionloss",) if self.law.friction else ()

    def __call__(self, rows: Rows) -> None:
        """Add to the force, or to the friction loss, of the next step."""
        model = rows.model
        (q, other_q), (v, other_v) = (
            (int(of[self.joint]), int(of[self.other])) for of in (model.jnt_qposadr, model.jnt_dofadr)
        )
        at = LawState(
            rows.qpos[:, q],
            rows.qvel[:, v],
            rows.qfrc_actuator[:, v],
            rows.time,
            rows.qpos[:, other_q],
            rows.qvel[:, other_v],
        )
        with np.errstate(over="ignore", invalid="ignore"):  # a simulation that diverges is told elsewhere
            added = self.law.force(at, self.values)
        if self.law.friction:
            loss = rows.field("dof_frictionloss")
            loss[:, v] = np.maximum(loss[:, v] + added, 0.0)
        else:
            rows.qfrc_applied[:, v] += added


def law_effect(law: LawTerm) -> Effect:
    """A term as an effect at every joint, or at every joint beside every other one.

    Args:
      law: the term.
    """

    def places(model: mujoco.MjModel) -> list[Place]:
        singles = [place for place in joint_places(model) if not place.members]
        if not law.coupled:
            return singles
        return [
            Place(f"{own.label}{_FROM}{other.label.partition(':')[2]}", joints=(*own.joints, *other.joints))
            for own in singles
            for other in singles
            if own is not other
        ]

    def parameters(model: mujoco.MjModel, scales: Scales, place: Place) -> tuple[Parameter, ...]:
        own = Place(place.label, joints=place.joints[:1])
        dof, other = (int(model.jnt_dofadr[j]) for j in (place.joints[0], place.joints[-1]))
        torque, speed, reach = (float(of[dof]) for of in (scales.torque, scales.speed, scales.amplitude))
        ends = np.array([-1.0, 1.0, -1.0, 1.0, 0.5, 0.5])
        turn = np.array([1.0, 1.0, -1.0, -1.0, 0.5, 1.0])
        at = LawState(
            reach * ends,
            speed * turn,
            torque * turn,
            ends + 1,
            scales.amplitude[other] * ends,
            scales.speed[other] * turn,
        )
        number, within = 0.0, list[Parameter]()
        if law.tried is not None:
            low, high = law.tried.bounds(reach)
            number, unit = float(np.sqrt(low * high)) if low > 0 else 0.0, unit_of(model, own, "rad", "m")
            step = 0.02 * (1.0 if law.tried.unit == "rad/s" else reach if low < 0 else 1 / max(reach, 1e-9))
            within.append(
                Parameter(law.tried.name, law.tried.unit.format(x=unit), low, high, step, null=number, shape=True)
            )
        units = [u.format(f=unit_of(model, own, "N m", "N"), x=unit_of(model, own, "rad", "m")) for u in law.units]
        peaks = [max(float(np.abs(f).max()), 1e-9) for f in law.basis(at, number)]
        if law.tried is not None:
            peaks = [max(peaks)] * len(peaks)
        sizes = [torque / peak for peak in peaks]
        return (
            *(
                Parameter(name, unit, -_LARGEST * size, _LARGEST * size, _STEP * size)
                for name, unit, size in zip(law.coefficients, units, sizes, strict=True)
            ),
            *within,
        )

    def apply(world: World, place: Place, values: np.ndarray) -> None:
        """Add the term to the laws of a world."""
        world.laws.append(LawForce(law, place.joints[0], place.joints[-1], tuple(float(v) for v in values)))

    kind = "Δf = " if law.friction else "τ = "
    return Effect(
        law.name,
        places,
        parameters,
        apply,
        excited_by="the whole range of positions and speeds",
        equation=kind + " + ".join(f"{c} {t}" for c, t in zip(law.coefficients, law.text, strict=True)),
        law=law,
    )


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


def equation_of(candidate: Candidate, values: Sequence[float] | np.ndarray, latex: bool = False) -> str:
    """The equation of an effect, of a law with its numbers.

    Args:
      candidate: the effect at its place.
      values: of its parameters.
      latex: whether in LaTeX, which only laws have.
    """
    law = candidate.effect.law
    if law is None:
        return "" if latex else candidate.effect.equation
    return law.equation(values, candidate.place.label.partition(_FROM)[2], latex)
