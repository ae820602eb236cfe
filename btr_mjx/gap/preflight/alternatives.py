"""Catalogue of conventions that logs use instead of MuJoCo's, as changes of columns or of the model's gravity."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import joint_of
from btr_mjx.gap.preflight.findings import DEGREES_REMEDY
from btr_mjx.gap.preflight.joint_orders import joint_orders
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
            if (joint := joint_of(self._model, a)) is not None:
                self._drives.setdefault(joint, []).append(a)
        self._reach, self._command_reach = (
            np.max([np.abs(x[:: max(1, len(x) // 2000)]).max(axis=0) for x in columns], axis=0)
            for columns in ([r.qpos for r in dataset.recordings], [r.ctrl for r in dataset.recordings])
        )

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
        return [*out, self._weightless()] if out else []

    def turned(self) -> dict[int, Change]:
        """Changes by which positions and commands of a joint both count the other way round, by id of the joint."""
        return {
            joint: Change(self._joints_times([joint], -1.0), self._ctrl(drives, -1.0))
            for joint, drives in self._drives.items()
        }

    # -- single joints

    def _signs(self, g: int) -> Iterator[Alternative]:
        joint = self._groups[g].joint
        name, drives = self._joints[joint], self._drives.get(joint, [])
        words = f"qpos/{name} counts the other way round than the model's joint"
        remedy = f"negate qpos/{name} (and qvel/{name} with it)"
        yield Alternative(Change(self._joints_times([joint], -1.0), self._ctrl()), (g,), words, remedy, "sign")
        if drives:
            names = " and ".join(f"ctrl/{self._actuators[a]}" for a in drives)
            words = f"{names} has the opposite sign of what the model's actuator does"
            commands = Change(self._qpos(), self._ctrl(drives, -1.0))
            yield Alternative(commands, (g,), words, f"negate {names}", "sign")
            words = f"qpos/{name} and {names} both have the opposite sign of the model's joint"
            remedy = f"negate both (and qvel/{name} with them), or turn the joint's axis in the model"
            yield Alternative(self.turned()[joint], (g,), words, remedy, "sign", elsewhere=True)

    def _units(self, g: int) -> Iterator[Alternative]:
        joint = self._groups[g].joint
        name, drives = self._joints[joint], self._drives.get(joint, [])
        servos = [a for a in drives if self._is_servo(a)]
        loud = [a for a in servos if self._command_reach[a] > _PLAUSIBLE_ANGLE]
        plausible = _PLAUSIBLE_ANGLE if self._model.jnt_type[joint] == _HINGE else _PLAUSIBLE_LENGTH
        for scale, offset, words, remedy in self._position_units(joint):
            if self._reach[int(self._model.jnt_qposadr[joint])] > plausible:
                qpos = self._joints_times([joint], scale, offset)
                alone = Change(qpos, self._ctrl())
                yield Alternative(alone, (g,), f"qpos/{name} {words}", remedy, "units", elsewhere=True)
                if servos:
                    both = Change(qpos, self._ctrl(servos, scale, offset))
                    text = f"qpos/{name} and ctrl/{self._actuators[servos[0]]} both: {words}"
                    yield Alternative(both, (g,), text, remedy, "units", elsewhere=True)
            if loud:
                ctrl = Change(self._qpos(), self._ctrl(loud, scale, offset))
                yield Alternative(ctrl, (g,), f"ctrl/{self._actuators[loud[0]]} {words}", remedy, "units")
        for a in drives:
            if a not in servos and self._command_reach[a] > 0:
                for scale, words, remedy in self._command_units(a):
                    ctrl = Change(self._qpos(), self._ctrl([a], scale))
                    yield Alternative(ctrl, (g,), f"ctrl/{self._actuators[a]} {words}", remedy, "units")

    def _position_units(self, joint: int) -> Iterator[tuple[float, float, str, str]]:
        """Factor, offset, words and remedy of units of a joint's positions."""
        if self._model.jnt_type[joint] == _SLIDE:
            yield 1e-3, 0.0, "looks like millimetres", "positions of slides are in m: divide by 1000"
            yield 1e-2, 0.0, "looks like centimetres", "positions of slides are in m: divide by 100"
        else:
            yield np.pi / 180, 0.0, "looks like degrees", DEGREES_REMEDY
            words = f"looks like encoder counts, {_TICKS} a turn"
            yield 2 * np.pi / _TICKS, 0.0, words, "multiply by 2 pi / 4096"
            words += " with 2048 in the middle"
            yield 2 * np.pi / _TICKS, -np.pi, words, "subtract 2048, then multiply by 2 pi / 4096"
        if self._model.jnt_limited[joint]:
            low, high = map(float, self._model.jnt_range[joint])
            ends = f"{low:.4g} to {high:.4g}"
            yield (high - low) / 100, low, "looks like per cent of its range", f"0 to 100 is {ends}"
            words = "looks like its range counted from -100 to 100"
            yield (high - low) / 200, (low + high) / 2, words, f"-100 to 100 is {ends}"

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
            off = Change(self._qpos(), self._ctrl(), switched_off=drives)
            yield Alternative(off, (g,), "", "", "", nuisance=True)

    # -- pairs, bases, gravity

    def _swaps(self, g: int, h: int) -> Iterator[Alternative]:
        i, j = self._groups[g].joint, self._groups[h].joint
        if self._model.jnt_type[i] != self._model.jnt_type[j]:
            return
        (first, second), qpos, ctrl = (self._joints[i], self._joints[j]), self._qpos(), self._ctrl()
        a, b = self._model.jnt_qposadr[[i, j]]
        qpos.source[[a, b]] = [b, a]
        words, remedy = f"qpos/{first} and qpos/{second}", f"(and qvel/{first} and qvel/{second} with them)"
        positions = Change(qpos, self._ctrl())
        yield Alternative(positions, (g, h), f"{words} are swapped", f"exchange them {remedy}", "order")
        own, other = self._drives.get(i, []), self._drives.get(j, [])
        if len(own) == 1 and len(other) == 1:
            ctrl.source[[own[0], other[0]]] = [other[0], own[0]]
            words = f"ctrl/{self._actuators[own[0]]} and ctrl/{self._actuators[other[0]]} are swapped"
            yield Alternative(Change(self._qpos(), ctrl), (g, h), words, "exchange them", "order")
            words = f"joints {first} and {second} are swapped in positions and commands"
            yield Alternative(Change(qpos, ctrl), (g, h), words, "exchange all their columns", "order")

    def _orders(self) -> Iterator[Alternative]:
        """Other orders of all hinges and slides: of numbered columns, or of names that were given to them."""
        groups = {group.joint: g for g, group in enumerate(self._groups)}
        own = [j for j in groups if int(self._model.jnt_type[j]) in (_HINGE, _SLIDE)]
        single = {j: drives[0] for j, drives in self._drives.items() if len(drives) == 1 and j in own}
        driven = sorted(single, key=lambda j: single[j])
        for words, order in joint_orders(self._model, own, driven):
            qpos, ctrl, driven_order = self._qpos(), self._ctrl(), [j for j in order if j in single]
            qpos.source[self._model.jnt_qposadr[order]] = self._model.jnt_qposadr[own]
            ctrl.source[[single[j] for j in driven_order]] = [single[j] for j in driven]
            moved = {groups[j] for j, k in zip(order, own, strict=True) if j != k}
            turned = {groups[j] for j, k in zip(driven_order, driven, strict=True) if j != k}
            tried = [("positions", Change(qpos, self._ctrl()), moved), ("commands", Change(self._qpos(), ctrl), turned)]
            if moved and turned:
                tried.insert(0, ("positions and commands", Change(qpos, ctrl), moved | turned))
            for what, change, concerned in tried:
                if concerned:
                    said = f"columns of {what} are in another order than the joints of the model, {words}"
                    yield Alternative(change, tuple(sorted(concerned)), said, "name them in [columns]", "orders")

    def _whole_robot(self) -> Iterator[Alternative]:
        """Units of all joints at once."""
        hinges = tuple(g for g, group in enumerate(self._groups) if self._model.jnt_type[group.joint] == _HINGE)
        joints = [self._groups[g].joint for g in hinges]
        if len(hinges) < 2 or max(self._reach[self._model.jnt_qposadr[joints]]) < _PLAUSIBLE_ANGLE:
            return
        qpos, words = self._joints_times(joints, np.pi / 180), "of all hinges look like degrees"
        servos = [a for j in joints for a in self._drives.get(j, []) if self._is_servo(a)]
        yield Alternative(Change(qpos, self._ctrl()), hinges, f"the positions {words}", DEGREES_REMEDY, "units")
        if servos:
            both, words = Change(qpos, self._ctrl(servos, np.pi / 180)), f"the positions and commands {words}"
            yield Alternative(both, hinges, words, DEGREES_REMEDY, "units", elsewhere=True)

    def _free(self, poor: Sequence[int]) -> Iterator[Alternative]:
        """Order and meaning of quaternions, and units of positions of free and ball joints."""
        for joint, kind in enumerate(self._model.jnt_type):
            own = tuple(g for g, group in enumerate(self._groups) if group.joint == joint)
            if int(kind) not in (_FREE, _BALL) or not set(own) & set(poor):
                continue
            first, name = int(self._model.jnt_qposadr[joint]), self._joints[joint]
            at, quaternions = first + (3 if kind == _FREE else 0), f"the quaternions of qpos/{name}"
            order = self._qpos()
            order.source[at : at + 4] = [at + 3, at, at + 1, at + 2]
            words, remedy = "are in the order x, y, z, w", "name the columns so that qw is the scalar part"
            yield Alternative(Change(order, self._ctrl()), own, f"{quaternions} {words}", remedy, "quaternion")
            inverse = Change(self._qpos([at + 1, at + 2, at + 3], -1.0), self._ctrl())
            words = f"{quaternions} turn the world into the body, not the body into the world"
            yield Alternative(inverse, own, words, "negate qx, qy and qz", "quaternion")
            if kind != _FREE:
                continue
            down = Change(self._qpos([first + 1, first + 2, at + 2, at + 3], -1.0), self._ctrl())
            remedy = "negate y, z, qy and qz (and vy, vz, wy, wz)"
            yield Alternative(down, own, f"qpos/{name} is in a frame with z down (NED, FRD)", remedy, "frame")
            place = range(first, first + 3)
            if self._reach[place].max() > _PLAUSIBLE_LENGTH:
                for scale, unit in ((1e-3, "millimetres"), (1e-2, "centimetres")):
                    words, remedy = f"qpos/{name}/x, y, z look like {unit}", f"divide by {1 / scale:.0f}"
                    change = Change(self._qpos(place, scale), self._ctrl())
                    yield Alternative(change, own, words, f"positions are in m: {remedy}", "units")

    def _gravity(self, poor: Sequence[int]) -> Iterator[Alternative]:
        """Other directions of gravity in the model."""
        now = self._model.opt.gravity
        size = float(np.linalg.norm(now)) or 9.81
        for axis, sign in product(range(3), (-1.0, 1.0)) if poor else ():
            vector = np.zeros(3)
            vector[axis] = sign * size
            if np.linalg.norm(vector - now) > 0.5 * size:
                chosen = (float(vector[0]), float(vector[1]), float(vector[2]))
                own, wanted = (" ".join(f"{x:.4g}" for x in vector) for vector in (now, chosen))
                words = f'the data fit gravity="{wanted}", not the model\'s "{own}"'
                remedy = "change gravity in <option>, or turn the base in the model or in the data"
                change = Change(self._qpos(), self._ctrl(), chosen)
                yield Alternative(change, tuple(poor), words, remedy, "gravity")

    def _weightless(self) -> Alternative:
        """Forces that the model lacks hold the robot: motors of its joints, or ground that it stands on deeper."""
        change = Change(self._qpos(), self._ctrl(), (0.0, 0.0, 0.0))
        return Alternative(change, tuple(range(len(self._groups))), "", "", "", nuisance=True)

    # -- columns

    def _is_servo(self, a: int) -> bool:
        return float(self._model.actuator_biasprm[a, 1]) < 0

    def _qpos(self, columns: Sequence[int] | np.ndarray = (), scale: float = 1.0, offset: float = 0.0) -> ColumnMap:
        return ColumnMap.affine(self._model.nq, columns, scale, offset)

    def _ctrl(self, actuators: Sequence[int] = (), scale: float = 1.0, offset: float = 0.0) -> ColumnMap:
        return ColumnMap.affine(self._model.nu, actuators, scale, offset)

    def _joints_times(self, joints: Sequence[int], scale: float, offset: float = 0.0) -> ColumnMap:
        return self._qpos(self._model.jnt_qposadr[list(joints)], scale, offset)
