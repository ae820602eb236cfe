"""Catalogue of conventions that logs use instead of MuJoCo's, as changes of columns or of the model's gravity."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset
from btr_mjx.gap.preflight.alternatives.alternative import HINGE_TYPE, SLIDE_TYPE, Alternative, LoggedColumns
from btr_mjx.gap.preflight.alternatives.joint_orders import joint_orders
from btr_mjx.gap.preflight.alternatives.units import LARGE_LENGTH, joint_units, robot_units
from btr_mjx.gap.preflight.predictions import Change, CoordinateGroup

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)

_SWAP_JOINTS = 8
"""Joints, those with the largest errors, of which every pair is tried as swapped."""

_ORDER_JOINTS = 3
"""Fewest joints that are predicted badly for which other orders of all joints are tried."""


class Catalogue:
    """Builds alternatives for a dataset."""

    def __init__(self, dataset: Dataset, groups: Sequence[CoordinateGroup]) -> None:
        self._columns, self._model, self._groups = LoggedColumns.of(dataset), dataset.model, groups
        self._joints, self._actuators = self._columns.joints, self._columns.actuators
        self._drives = self._columns.drives

    def alternatives(self, poor: Sequence[int], base: Sequence[int]) -> list[Alternative]:
        """Alternatives for groups that the model does not predict well.

        Args:
          poor: groups whose joints are questioned, largest error first.
          base: groups by which gravity and free and ball joints are questioned.
        """
        kinds = [int(self._model.jnt_type[group.joint]) for group in self._groups]
        hinges = {group.joint: g for g, group in enumerate(self._groups) if kinds[g] == HINGE_TYPE}
        out = list(robot_units(self._columns, hinges)) if hinges else []
        out += [*self._gravity(base), *self._free(base)]
        scalar = [g for g in poor if kinds[g] in (HINGE_TYPE, SLIDE_TYPE)]
        for g, group in enumerate(self._groups):
            if poor and kinds[g] in (HINGE_TYPE, SLIDE_TYPE):
                signs = list(self._signs(g))
                out += signs if g in scalar else [a for a in signs if a.elsewhere]
                single = g in scalar and len(hinges) > 1  # the only hinge is the whole robot
                out += [*joint_units(self._columns, group.joint, g, single), *self._nuisances(g)]
        if len(scalar) >= _ORDER_JOINTS:
            out += self._orders()
        for g, h in combinations(scalar[:_SWAP_JOINTS], 2):
            out += self._swaps(g, h)
        return [*out, *self._forceless()] if out else []

    def turned(self) -> dict[int, Change]:
        """Changes by which positions and commands of a joint both count the other way round, by id of the joint."""
        return {
            joint: Change(self._columns.joints_times([joint], -1.0), self._columns.ctrl(drives, -1.0))
            for joint, drives in self._drives.items()
        }

    # -- single joints

    def _signs(self, g: int) -> Iterator[Alternative]:
        joint = self._groups[g].joint
        name, drives = self._joints[joint], self._drives.get(joint, [])
        words = f"qpos/{name} counts the other way round than the model's joint"
        remedy = f"negate qpos/{name} (and qvel/{name} with it)"
        yield Alternative(self._columns.changed(self._columns.joints_times([joint], -1.0)), (g,), words, remedy, "sign")
        if drives:
            names = " and ".join(f"ctrl/{self._actuators[a]}" for a in drives)
            words = f"{names} has the opposite sign of what the model's actuator does"
            commands = self._columns.changed(ctrl=self._columns.ctrl(drives, -1.0))
            yield Alternative(commands, (g,), words, f"negate {names}", "sign")
            words = f"qpos/{name} and {names} both have the opposite sign of the model's joint"
            remedy = f"negate both (and qvel/{name} with them), or turn the joint's axis in the model"
            yield Alternative(self.turned()[joint], (g,), words, remedy, "sign", elsewhere=True)

    def _nuisances(self, g: int) -> Iterator[Alternative]:
        drives = tuple(self._drives.get(self._groups[g].joint, []))
        if drives:
            off = Change(self._columns.qpos(), self._columns.ctrl(), switched_off=drives)
            yield Alternative(off, (g,), "", "", "", nuisance=True)

    # -- pairs, bases, gravity

    def _swaps(self, g: int, h: int) -> Iterator[Alternative]:
        i, j = self._groups[g].joint, self._groups[h].joint
        if self._model.jnt_type[i] != self._model.jnt_type[j]:
            return
        (first, second), qpos, ctrl = (self._joints[i], self._joints[j]), self._columns.qpos(), self._columns.ctrl()
        a, b = self._model.jnt_qposadr[[i, j]]
        qpos.source[[a, b]] = [b, a]
        words, remedy = f"qpos/{first} and qpos/{second}", f"(and qvel/{first} and qvel/{second} with them)"
        positions = self._columns.changed(qpos)
        yield Alternative(positions, (g, h), f"{words} are swapped", f"exchange them {remedy}", "order")
        own, other = self._drives.get(i, []), self._drives.get(j, [])
        if len(own) == 1 and len(other) == 1:
            ctrl.source[[own[0], other[0]]] = [other[0], own[0]]
            words = f"ctrl/{self._actuators[own[0]]} and ctrl/{self._actuators[other[0]]} are swapped"
            yield Alternative(self._columns.changed(ctrl=ctrl), (g, h), words, "exchange them", "order")
            words = f"joints {first} and {second} are swapped in positions and commands"
            yield Alternative(Change(qpos, ctrl), (g, h), words, "exchange all their columns", "order")

    def _orders(self) -> Iterator[Alternative]:
        """Other orders of all hinges and slides: of numbered columns, or of names that were given to them."""
        groups = {group.joint: g for g, group in enumerate(self._groups)}
        own = [j for j in groups if int(self._model.jnt_type[j]) in (HINGE_TYPE, SLIDE_TYPE)]
        single = {j: drives[0] for j, drives in self._drives.items() if len(drives) == 1 and j in own}
        driven = sorted(single, key=lambda j: single[j])
        for words, order in joint_orders(self._model, own, driven):
            qpos, ctrl, driven_order = self._columns.qpos(), self._columns.ctrl(), [j for j in order if j in single]
            qpos.source[self._model.jnt_qposadr[order]] = self._model.jnt_qposadr[own]
            ctrl.source[[single[j] for j in driven_order]] = [single[j] for j in driven]
            moved = {groups[j] for j, k in zip(order, own, strict=True) if j != k}
            turned = {groups[j] for j, k in zip(driven_order, driven, strict=True) if j != k}
            tried = [
                ("positions", self._columns.changed(qpos), moved),
                ("commands", self._columns.changed(ctrl=ctrl), turned),
            ]
            if moved and turned:
                tried.insert(0, ("positions and commands", Change(qpos, ctrl), moved | turned))
            for what, change, concerned in tried:
                if concerned:
                    said = f"columns of {what} are in another order than the joints of the model, {words}"
                    yield Alternative(change, tuple(sorted(concerned)), said, "name them in [columns]", "orders")

    def _free(self, poor: Sequence[int]) -> Iterator[Alternative]:
        """Order and meaning of quaternions, and units of positions of free and ball joints."""
        for joint, kind in enumerate(self._model.jnt_type):
            own = tuple(g for g, group in enumerate(self._groups) if group.joint == joint)
            if int(kind) not in (_FREE, _BALL) or not set(own) & set(poor):
                continue
            first, name = int(self._model.jnt_qposadr[joint]), self._joints[joint]
            at, quaternions = first + (3 if kind == _FREE else 0), f"the quaternions of qpos/{name}"
            order = self._columns.qpos()
            order.source[at : at + 4] = [at + 3, at, at + 1, at + 2]
            words, remedy = "are in the order x, y, z, w", "name the columns so that qw is the scalar part"
            yield Alternative(self._columns.changed(order), own, f"{quaternions} {words}", remedy, "quaternion")
            inverse = self._columns.changed(self._columns.qpos([at + 1, at + 2, at + 3], -1.0))
            words = f"{quaternions} turn the world into the body, not the body into the world"
            yield Alternative(inverse, own, words, "negate qx, qy and qz", "quaternion")
            if kind != _FREE:
                continue
            down = self._columns.changed(self._columns.qpos([first + 1, first + 2, at + 2, at + 3], -1.0))
            remedy = "negate y, z, qy and qz (and vy, vz, wy, wz)"
            yield Alternative(down, own, f"qpos/{name} is in a frame with z down (NED, FRD)", remedy, "frame")
            place = range(first, first + 3)
            if np.abs([self._columns.low[place], self._columns.high[place]]).max() > LARGE_LENGTH:
                for scale, unit in ((1e-3, "millimetres"), (1e-2, "centimetres")):
                    words, remedy = f"qpos/{name}/x, y, z look like {unit}", f"divide by {1 / scale:.0f}"
                    change = self._columns.changed(self._columns.qpos(place, scale))
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
                change = Change(self._columns.qpos(), self._columns.ctrl(), chosen)
                yield Alternative(change, tuple(poor), words, remedy, "gravity")

    def _forceless(self) -> Iterator[Alternative]:
        """Forces that the model lacks hold the robot (motors, ground that it stands on deeper); or it has no friction.

        Beside smaller forces, a motion looks as if it were larger.
        """
        every, same = tuple(range(len(self._groups))), self._columns.changed()
        for change in (replace(same, gravity=(0.0, 0.0, 0.0)), replace(same, frictionless=True)):
            yield Alternative(change, every, "", "", "", nuisance=True)
