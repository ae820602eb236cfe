"""Mass matrix and bias forces of the whole robot from the motion of its links."""

from collections.abc import Sequence

from btr_mjx.engines.lanes.kinematics import Motion
from btr_mjx.engines.lanes.parameters import Parameters
from btr_mjx.engines.lanes.scalars import (
    Scalar,
    cross,
    full,
    is_zero,
    matvec,
    sandwich,
    scale,
    transpose,
    vadd,
)
from btr_mjx.engines.lanes.spatial import Spatial, TreeMatrix, mass_matrix, merge, project
from btr_mjx.engines.lanes.tree import FREE, Joint, Plan


def inertia_and_bias(plan: Plan, parameters: Parameters, motions: Sequence[Motion]) -> tuple[TreeMatrix, list[Scalar]]:
    """Joint-space inertia with armature, and the forces that hold the joint accelerations at zero.

    Returns:
      The mass matrix (angular dofs of free joints in world axes), and Coriolis, centrifugal and gravity forces.
    """
    masses, moments = [], []
    wrenches: list[Spatial] = []
    for link, m in zip(plan.links, motions, strict=True):
        key = f"{link.index}"
        h = matvec(m.turn, parameters[f"{key}/h"])
        inertia = sandwich(m.turn, parameters[f"{key}/inertia"])
        masses.append(parameters.one(f"{key}/subtree_mass"))
        moments.append((h, inertia))
        mass = parameters.one(f"{key}/mass")
        # Newton and Euler about the origin: no need for the centre of mass or the inertia about it.
        force = vadd(scale(mass, m.acceleration), vadd(cross(m.spin_rate, h), cross(m.spin, cross(m.spin, h))))
        torque = vadd(matvec(full(inertia), m.spin_rate), cross(m.spin, matvec(full(inertia), m.spin)))
        wrenches.append((force, vadd(torque, cross(h, m.acceleration))))
    matrix = mass_matrix(plan, motions, masses, moments)
    return merge(matrix, dof_matrix(plan, parameters, motions, "armature")), project(plan, motions, wrenches)


def free_block(joint: Joint, m: Motion, values: Sequence[Scalar]) -> TreeMatrix:
    """Per-dof numbers of a free joint as a matrix; the angular ones live in link axes and are turned to the world."""
    matrix: TreeMatrix = {(k, k): value for k, value in zip(joint.dofs[:3], values[:3], strict=True)}
    if values[3] is values[4] is values[5] or (isinstance(values[3], float) and values[3] == values[4] == values[5]):
        angular = full([values[3]] * 3 + [0.0] * 3)
    else:
        angular = full(sandwich(m.turn, [*values[3:], 0.0, 0.0, 0.0]))
    matrix |= {(joint.dofs[3 + i], joint.dofs[3 + j]): angular[i][j] for i in range(3) for j in range(i + 1)}
    return {key: value for key, value in matrix.items() if not is_zero(value)}


def dof_matrix(plan: Plan, parameters: Parameters, motions: Sequence[Motion], what: str) -> TreeMatrix:
    """A quantity per dof ("armature" or "damping") as a matrix over the dofs of the plan."""
    matrix: TreeMatrix = {}
    for link, m in zip(plan.links, motions, strict=True):
        for n, joint in enumerate(link.joints):
            values = parameters[f"{link.index}/joint{n}/{what}"]
            if joint.kind == FREE:
                matrix |= free_block(joint, m, values)
            elif not is_zero(values[0]):
                matrix[joint.dofs[0], joint.dofs[0]] = values[0]
    return matrix


def to_world(plan: Plan, motions: Sequence[Motion], v: Sequence[Scalar]) -> list[Scalar]:
    """Dof velocities in MuJoCo's convention to the solver's: angular parts of free joints turned to world axes."""
    return _turned(plan, [m.turn for m in motions], v)


def to_local(plan: Plan, motions: Sequence[Motion], v: Sequence[Scalar]) -> list[Scalar]:
    """Inverse of `to_world`."""
    return _turned(plan, [transpose(m.turn) for m in motions], v)


def _turned(plan: Plan, turns: Sequence[Sequence[Sequence[Scalar]]], v: Sequence[Scalar]) -> list[Scalar]:
    result = list(v)
    for link, turn in zip(plan.links, turns, strict=True):
        if link.joints[0].kind == FREE:
            angular = link.joints[0].dofs[3:]
            for k, value in zip(angular, matvec(turn, [v[k] for k in angular]), strict=True):
                result[k] = value
    return result
