"""Catalogue of conventions that logs use instead of MuJoCo's, as changes of columns or of the model's gravity."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import joint_of
from btr_mjx.gap.preflight.findings import DEGREES_REMEDY
from btr_mjx.gap.preflight.orders import joint_orders
from btr_mjx.gap.preflight.predictions import Change, ColumnMap, CoordinateGroup
from btr_mjx.models import part_names

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)

_PLAUSIBLE_ANGLE = 6.0
"""Angles [rad] below which a hinge is not asked for degrees, ticks or per cent: those are large numbers."""

_PLAUSIBLE_LENGTH = 3.0
"""The same for positions of slides and free joints [m]."""

_SWAP_JOINTS = 8
"""Joints, those with the largest errors, of which every pair is tried as swapped."""

_ORDER_JOINTS = 3
"""Fewest joints that are predicted badly for which other orders of all joints are tried."""

_TICKS = 4096
"""Encoder counts a turn that are common (Dynamixel X, AS5600)."""


@dataclass(frozen=True)
class Alternative:
    """A convention that the data may follow.

    Attributes:
      change: what makes data of this convention those of the documented one.
      groups: indices of the groups that it concerns.
      words: what is odd, for messages.
      remedy: what to do.
      topic: kind of convention.
      nuisance: physics instead of a convention: never reported, but a convention must do better.
      elsewhere: only other coordinates may show it: a servo whose positions and commands are wrong alike follows well.
    """

    change: Change
    groups: tuple[int, ...]
    words: str
    remedy: str
    topic: str
    nuisance: bool = False
    elsewhere: bool = False


class Catalogue:
    """Builds alternatives for a dataset."""

    def __init__(self, dataset: Dataset, groups: Sequence[CoordinateGroup]) -> None:
        self._dataset, self._model, self._groups = dataset, dataset.model, groups
        self._joints, self._actuators = part_names(self._model, "joint"), part_names(self._model, "actuator")
        self._drives: dict[int, list[int]] = {}
        for a in range(self._model.nu):
            joint = joint_of(self._model, a)
            if joint is not None:
                self._drives.setdefault(joint, []).append(a)
        rows = [np.abs(np.asarray(r.qpos[:: max(1, len(r.qpos) // 2000)])) for r in dataset.recordings]
        self._reach = np.max([x.max(axis=0) for x in rows], axis=0)
        rows = [np.abs(np.asarray(r.ctrl[:: max(1, len(r.ctrl) // 2000)])) for r in dataset.recordings]
        self._command_reach = np.max([x.max(axis=0) for x in rows], axis=0)

    def alternatives(self, poor: Sequence[int], base: Sequence[int]) -> list[Alternative]:
        """Alternatives for groups that the model does not predict well.

        Args:
          poor: groups whose joints are questioned, largest error first.
          base: groups by which gravity and free and ball joints are questioned.
        """
        out = [*self._whole_robot(), *self._gravity(base), *self._free(base)]
        scalar = [g for g in poor if int(self._model.jnt_type[self._groups[g].joint]) in (_HINGE, _SLIDE)]
        for g, group in enumerate(self._groups):
            if poor and int(self._model.jnt_type[group.joint]) in (_HINGE, _SLIDE):
                signs = list(self._signs(g))
                out += signs if g in scalar else [a for a in signs if a.elsewhere]
                out += [*self._units(g), *self._nuisances(g)]
        if len(scalar) >= _ORDER_JOINTS:
            out += self._orders()
        for g, h in combinations(scalar[:_SWAP_JOINTS], 2):
            out += self._swaps(g, h)
        return out

    def turned(self) -> dict[int, Change]:
        """Changes by which positions and commands of a joint both count the other way round, by id of the joint."""
        return {
            joint: Change(self._scaled([joint], -1.0), self._driven(drives, -1.0))
            for joint, drives in self._drives.items()
        }

    # -- single joints

    def _signs(self, g: int) -> Iterator[Alternative]:
        joint = self._groups[g].joint
        name, drives = self._joints[joint], self._drives.get(joint, [])
        flipped = self._scaled([joint], -1.0)
        yield Alternative(
            Change(flipped, self._no_ctrl()),
            (g,),
            f"qpos/{name} counts the other way round than the model's joint",
            f"negate qpos/{name} (and qvel/{name} with it)",
            "sign",
        )
        if drives:
            commands = self._driven(drives, -1.0)
            names = " and ".join(f"ctrl/{self._actuators[a]}" for a in drives)
            yield Alternative(
                Change(self._no_qpos(), commands),
                (g,),
                f"{names} has the opposite sign of what the model's actuator does",
                f"negate {names}",
                "sign",
            )
            yield Alternative(
                self.turned()[joint],
                (g,),
                f"qpos/{name} and {names} both have the opposite sign of the model's joint",
                f"negate both (and qvel/{name} with them), or turn the joint's axis in the model",
                "sign",
                elsewhere=True,
            )

    def _units(self, g: int) -> Iterator[Alternative]:
        joint = self._groups[g].joint
        name, drives = self._joints[joint], self._drives.get(joint, [])
        q = int(self._model.jnt_qposadr[joint])
        servos = [a for a in drives if self._is_servo(a)]
        for scale, offset, words, remedy in self._position_units(joint):
            large = self._reach[q] > (_PLAUSIBLE_ANGLE if self._model.jnt_type[joint] == _HINGE else _PLAUSIBLE_LENGTH)
            loud = [a for a in servos if self._command_reach[a] > _PLAUSIBLE_ANGLE]
            if large:
                qpos = self._scaled([joint], scale, offset)
                alone = Change(qpos, self._no_ctrl())
                yield Alternative(alone, (g,), f"qpos/{name} {words}", remedy, "units", elsewhere=True)
                if servos:
                    both = Change(qpos, self._driven(servos, scale, offset))
                    text = f"qpos/{name} and ctrl/{self._actuators[servos[0]]} both: {words}"
                    yield Alternative(both, (g,), text, remedy, "units", elsewhere=True)
            if loud:
                ctrl = Change(self._no_qpos(), self._driven(loud, scale, offset))
                yield Alternative(ctrl, (g,), f"ctrl/{self._actuators[loud[0]]} {words}", remedy, "units")
        others = [a for a in drives if a not in servos and self._command_reach[a] > 0]
        for a in others:
            for scale, words, remedy in self._command_units(a):
                ctrl = Change(self._no_qpos(), self._driven([a], scale))
                yield Alternative(ctrl, (g,), f"ctrl/{self._actuators[a]} {words}", remedy, "units")

    def _position_units(self, joint: int) -> Iterator[tuple[float, float, str, str]]:
        """Factor, offset, words and remedy of units of a joint's positions."""
        if self._model.jnt_type[joint] == _SLIDE:
            yield 1e-3, 0.0, "looks like millimetres", "positions of slides are in m: divide by 1000"
            yield 1e-2, 0.0, "looks like centimetres", "positions of slides are in m: divide by 100"
        else:
            yield np.pi / 180, 0.0, "looks like degrees", DEGREES_REMEDY
            yield 2 * np.pi / _TICKS, 0.0, f"looks like encoder counts, {_TICKS} a turn", "multiply by 2 pi / 4096"
            words = f"looks like encoder counts, {_TICKS} a turn with 2048 in the middle"
            yield 2 * np.pi / _TICKS, -np.pi, words, "subtract 2048, then multiply by 2 pi / 4096"
        if self._model.jnt_limited[joint]:
            low, high = self._model.jnt_range[joint]
            ends = f"{low:.4g} to {high:.4g}"
            yield (high - low) / 100, float(low), "looks like per cent of its range", f"0 to 100 is {ends}"
            yield (
                (high - low) / 200,
                float(low + high) / 2,
                "looks like its range counted from -100 to 100",
                f"-100 to 100 is {ends}",
            )

    def _command_units(self, a: int) -> Iterator[tuple[float, str, str]]:
        """Factor, words and remedy of units of a motor's or velocity servo's command."""
        gain = float(self._model.actuator_biasprm[a, 2])
        if gain < 0:
            yield np.pi / 180, "looks like degrees/s", "velocities are in rad/s: divide by 57.3"
            yield 2 * np.pi / 60, "looks like revolutions per minute", "multiply by 0.10472"
        yield 1e-3, "looks like thousandths of its unit (mN m, mN)", "divide by 1000"
        yield 1e-2, "looks like per cent", "divide by 100"
        if self._model.actuator_ctrllimited[a]:
            high = float(np.abs(self._model.actuator_ctrlrange[a]).max())
            if high not in (0.0, 1.0, 100.0) and self._command_reach[a] > 1.5 * high:
                yield high / 100, "looks like per cent of its ctrlrange", f"100 is {high:.4g}"

    def _nuisances(self, g: int) -> Iterator[Alternative]:
        drives = tuple(self._drives.get(self._groups[g].joint, []))
        if drives:
            off = Change(self._no_qpos(), self._no_ctrl(), switched_off=drives)
            yield Alternative(off, (g,), "", "", "", nuisance=True)

    # -- pairs, bases, gravity

    def _swaps(self, g: int, h: int) -> Iterator[Alternative]:
        i, j = self._groups[g].joint, self._groups[h].joint
        if self._model.jnt_type[i] != self._model.jnt_type[j]:
            return
        names = self._joints[i], self._joints[j]
        qpos, ctrl = self._no_qpos(), self._no_ctrl()
        a, b = int(self._model.jnt_qposadr[i]), int(self._model.jnt_qposadr[j])
        qpos.source[[a, b]] = [b, a]
        positions = f"qpos/{names[0]} and qpos/{names[1]}"
        remedy = f"exchange them (and qvel/{names[0]} and qvel/{names[1]} with them)"
        yield Alternative(Change(qpos, self._no_ctrl()), (g, h), f"{positions} are swapped", remedy, "order")
        own, other = self._drives.get(i, []), self._drives.get(j, [])
        if len(own) == 1 and len(other) == 1:
            ctrl.source[[own[0], other[0]]] = [other[0], own[0]]
            commands = f"ctrl/{self._actuators[own[0]]} and ctrl/{self._actuators[other[0]]}"
            yield Alternative(
                Change(self._no_qpos(), ctrl), (g, h), f"{commands} are swapped", "exchange them", "order"
            )
            words = f"joints {names[0]} and {names[1]} are swapped in positions and commands"
            yield Alternative(Change(qpos, ctrl), (g, h), words, "exchange all their columns", "order")

    def _orders(self) -> Iterator[Alternative]:
        """Other orders of all hinges and slides: of numbered columns, or of names that were given to them."""
        groups = {group.joint: g for g, group in enumerate(self._groups)}
        own = [j for j in groups if int(self._model.jnt_type[j]) in (_HINGE, _SLIDE)]
        single = {j: drives[0] for j, drives in self._drives.items() if len(drives) == 1 and j in own}
        driven = sorted(single, key=lambda j: single[j])
        for words, order in joint_orders(self._model, own, driven):
            qpos, ctrl = self._no_qpos(), self._no_ctrl()
            qpos.source[self._model.jnt_qposadr[order]] = self._model.jnt_qposadr[own]
            ctrl.source[[single[j] for j in order if j in single]] = [single[j] for j in driven]
            moved = tuple(groups[j] for j, k in zip(order, own, strict=True) if j != k)
            turned = tuple(groups[j] for j, k in zip((j for j in order if j in single), driven, strict=True) if j != k)
            for what, change, concerned in (
                ("positions and commands", Change(qpos, ctrl), {*moved, *turned}),
                ("positions", Change(qpos, self._no_ctrl()), set(moved)),
                ("commands", Change(self._no_qpos(), ctrl), set(turned)),
            ):
                if concerned and ((moved and turned) or what != "positions and commands"):
                    said = f"columns of {what} are in another order than the joints of the model, {words}"
                    yield Alternative(change, tuple(sorted(concerned)), said, "name them in [columns]", "orders")

    def _whole_robot(self) -> Iterator[Alternative]:
        """Units of all joints at once."""
        hinges = [g for g, group in enumerate(self._groups) if self._model.jnt_type[group.joint] == _HINGE]
        if len(hinges) < 2:
            return
        joints = [self._groups[g].joint for g in hinges]
        if max(self._reach[self._model.jnt_qposadr[joints]]) < _PLAUSIBLE_ANGLE:
            return
        qpos = self._scaled(joints, np.pi / 180)
        servos = [a for j in joints for a in self._drives.get(j, []) if self._is_servo(a)]
        yield Alternative(
            Change(qpos, self._no_ctrl()),
            tuple(hinges),
            "the positions of all hinges look like degrees",
            DEGREES_REMEDY,
            "units",
        )
        if servos:
            both = Change(qpos, self._driven(servos, np.pi / 180))
            words = "the positions and commands of all hinges look like degrees"
            yield Alternative(both, tuple(hinges), words, DEGREES_REMEDY, "units", elsewhere=True)

    def _free(self, poor: Sequence[int]) -> Iterator[Alternative]:
        """Order and meaning of quaternions, and units of positions of free and ball joints."""
        for joint, kind in enumerate(self._model.jnt_type):
            own = tuple(g for g, group in enumerate(self._groups) if group.joint == joint)
            if int(kind) not in (_FREE, _BALL) or not set(own) & set(poor):
                continue
            first, name = int(self._model.jnt_qposadr[joint]), self._joints[joint]
            at = first + (3 if kind == _FREE else 0)
            order = self._no_qpos()
            order.source[at : at + 4] = [at + 3, at, at + 1, at + 2]
            yield Alternative(
                Change(order, self._no_ctrl()),
                own,
                f"the quaternions of qpos/{name} are in the order x, y, z, w",
                "name the columns so that qw is the scalar part",
                "quaternion",
            )
            inverse = self._no_qpos()
            inverse.scale[at + 1 : at + 4] = -1.0
            yield Alternative(
                Change(inverse, self._no_ctrl()),
                own,
                f"the quaternions of qpos/{name} turn the world into the body, not the body into the world",
                "negate qx, qy and qz",
                "quaternion",
            )
            if kind != _FREE:
                continue
            down = self._no_qpos()
            down.scale[[first + 1, first + 2, at + 2, at + 3]] = -1.0
            yield Alternative(
                Change(down, self._no_ctrl()),
                own,
                f"qpos/{name} is in a frame with z down (NED, FRD)",
                "negate y, z, qy and qz (and vy, vz, wy, wz)",
                "frame",
            )
            if self._reach[first : first + 3].max() > _PLAUSIBLE_LENGTH:
                for scale, words in ((1e-3, "millimetres"), (1e-2, "centimetres")):
                    place = self._no_qpos()
                    place.scale[first : first + 3] = scale
                    yield Alternative(
                        Change(place, self._no_ctrl()),
                        own,
                        f"qpos/{name}/x, y, z look like {words}",
                        f"positions are in m: divide by {1 / scale:.0f}",
                        "units",
                    )

    def _gravity(self, poor: Sequence[int]) -> Iterator[Alternative]:
        """Other directions of gravity in the model."""
        if not len(poor):
            return
        now = self._model.opt.gravity
        size = float(np.linalg.norm(now)) or 9.81
        for axis in range(3):
            for sign in (-1.0, 1.0):
                vector = np.zeros(3)
                vector[axis] = sign * size
                if np.linalg.norm(vector - now) > 0.5 * size:
                    chosen = (float(vector[0]), float(vector[1]), float(vector[2]))
                    own, wanted = (" ".join(f"{x:.4g}" for x in vector) for vector in (now, chosen))
                    words = f'the data fit gravity="{wanted}", not the model\'s "{own}"'
                    remedy = "change gravity in <option>, or turn the base in the model or in the data"
                    yield Alternative(
                        Change(self._no_qpos(), self._no_ctrl(), chosen), tuple(poor), words, remedy, "gravity"
                    )

    # -- columns

    def _is_servo(self, a: int) -> bool:
        return float(self._model.actuator_biasprm[a, 1]) < 0

    def _no_qpos(self) -> ColumnMap:
        return ColumnMap.identity(self._model.nq)

    def _no_ctrl(self) -> ColumnMap:
        return ColumnMap.identity(self._model.nu)

    def _scaled(self, joints: Sequence[int], scale: float, offset: float = 0.0) -> ColumnMap:
        columns, out = self._model.jnt_qposadr[list(joints)], self._no_qpos()
        out.scale[columns], out.offset[columns] = scale, offset
        return out

    def _driven(self, actuators: Sequence[int], scale: float, offset: float = 0.0) -> ColumnMap:
        out = self._no_ctrl()
        out.scale[list(actuators)], out.offset[list(actuators)] = scale, offset
        return out
