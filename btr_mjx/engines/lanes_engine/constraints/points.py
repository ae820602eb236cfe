"""Contact points of links with planes."""

from dataclasses import dataclass

from btr_mjx.engines.lanes_engine.constraints.cones import Cone, ZoneModel
from btr_mjx.engines.lanes_engine.spatial import Block, Spatial, point_block
from btr_mjx.engines.lanes_engine.tree import Link
from btr_mjx.engines.scalars import SIX, Scalar, Vector, cross, full, matmul, matvec, padded, sandwich, transpose, vadd


@dataclass
class Contact:
    """One contact point of one link with the world."""

    link: Link
    x: Vector
    """Contact point relative to the link's origin, world axes [m]."""
    cone: Cone

    def acceleration(self, spatial: Spatial) -> list[Scalar]:
        """Acceleration along the rows of the cone from the spatial acceleration of its link."""
        linear, angular = spatial
        turning = self.cone.frame[: len(self.cone.reference) - 3]
        return [*matvec(self.cone.frame, vadd(linear, cross(angular, self.x))), *matvec(turning, angular)]

    def effect(self, model: ZoneModel) -> tuple[Block, Spatial]:
        """Stiffness block and wrench about the link's origin for a zone."""
        stiffness, force = self.cone.stiffness(model), self.cone.force(model, self.cone.reference)
        across = transpose(self.cone.frame)
        f = matvec(across, force[:3])
        if len(force) == 3:
            return point_block(sandwich(across, stiffness), self.x), (f, cross(self.x, f))
        rows = [padded(row, 6) for row in full(stiffness)]
        rows += [[0.0] * 6] * (6 - len(rows))
        linear, angular = (sandwich(across, [rows[k + i][k + j] for i, j in SIX]) for k in (0, 3))
        mixed = matmul(across, matmul([row[3:] for row in rows[:3]], self.cone.frame))
        torque = vadd(matvec(across, padded(force[3:], 3)), cross(self.x, f))
        return Block(linear, mixed, angular).shifted(self.x), (f, torque)
