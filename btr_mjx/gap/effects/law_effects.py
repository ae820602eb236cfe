"""Laws as effects: a term of the dictionary at a joint, with ranges of its numbers, and as a force in a simulation."""

from collections.abc import Sequence

import mujoco
import numpy as np

from btr_mjx.gap.effects.effect import Candidate, Effect, Parameter
from btr_mjx.gap.effects.law_terms import LawState, LawTerm
from btr_mjx.gap.effects.places import Place, joint_places
from btr_mjx.gap.effects.ranges import Scales
from btr_mjx.gap.simulate import Rows, StateLaw, World

_FROM = " from "
"""Between the names of two joints, in the label of a place."""

_LARGEST = 3.0
"""Largest force of a law, in peak torques of the joint."""

_STEP = 0.05
"""Step of a coefficient, in the same unit."""


def _add_law(rows: Rows, law: LawTerm, joint: int, other: int, values: tuple[float, ...]) -> None:
    """Add a law at a joint, which may depend on another one, to its force, or to its friction loss."""
    (q, other_q), (v, other_v) = rows.model.jnt_qposadr[[joint, other]], rows.model.jnt_dofadr[[joint, other]]
    load, partner = rows.qfrc_actuator[:, v], (rows.qpos[:, other_q], rows.qvel[:, other_v])
    at = LawState(rows.qpos[:, q], rows.qvel[:, v], load, rows.time, *partner)
    with np.errstate(over="ignore", invalid="ignore"):  # a simulation that diverges is told elsewhere
        added = law.force(at, values)
    if law.friction:
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
        is_hinge = model.jnt_type[place.joints[0]] == mujoco.mjtJoint.mjJNT_HINGE
        force, length = ("N m", "rad") if is_hinge else ("N", "m")
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
            number, unit = float(np.sqrt(low * high)) if low > 0 else 0.0, law.tried.unit.format(x=length)
            step = 0.02 * (1.0 if unit == "rad/s" else reach if low < 0 else 1 / max(reach, 1e-9))
            within.append(Parameter(law.tried.name, unit, low, high, step, null=number, shape=True))
        units = [unit.format(f=force, x=length) for unit in law.units]
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
        numbers = law, place.joints[0], place.joints[-1], tuple(float(v) for v in values)
        world.laws.append(StateLaw(_add_law, numbers, ("dof_frictionloss",) if law.friction else ()))

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
