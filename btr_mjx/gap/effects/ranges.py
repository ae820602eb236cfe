"""Typical sizes in a model or in data, from which steps, bounds and tolerances of effects are derived."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.gap.effects.places import Place, actuator_count, ground_geoms, joint_of

_DEFAULT_AMPLITUDE = 0.3
"""Amplitude of a joint assumed without data [rad]."""


@dataclass(frozen=True)
class Scales:
    """Typical sizes of forces, motions and inertias of a robot.

    Attributes:
      torque: (nv,) peak generalised force of the actuators at each degree of freedom [N or N m].
      speed: (nv,) peak speed [m/s or rad/s].
      amplitude: (nv,) half the range of motion [m or rad].
      inertia: (nv,) diagonal of the mass matrix [kg or kg m^2].
      force: (n_actuators,) peak force of each actuator [N or N m].
      command_rate: (nu,) peak rate of each command [units of the control per s].
      time: typical ratio of amplitude to speed [s]; 1 / angular frequency for a sine.
      length: half the extent of the model [m].
      mass: total mass of moving bodies [kg].
      touching: (ngeom,) bool: the geom touches the ground in the data (`measured`) or can touch it (`of`).
    """

    torque: np.ndarray
    speed: np.ndarray
    amplitude: np.ndarray
    inertia: np.ndarray
    force: np.ndarray
    command_rate: np.ndarray
    time: float
    length: float
    mass: float
    touching: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel) -> "Scales":
        """Scales estimated from the model alone."""
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        amplitude = np.full(model.nv, _DEFAULT_AMPLITUDE)
        for j in np.flatnonzero(model.jnt_limited):
            if model.jnt_type[j] >= int(mujoco.mjtJoint.mjJNT_SLIDE):
                amplitude[model.jnt_dofadr[j]] = min(_DEFAULT_AMPLITUDE, 0.5 * float(np.ptp(model.jnt_range[j])))
        inertia = np.maximum(model.dof_M0, 1e-12)
        speed = amplitude / 0.1
        force = np.zeros(actuator_count(model))
        torque = np.maximum(np.abs(data.qfrc_bias), inertia * speed / 0.1)
        for a in range(len(force)):
            joint = joint_of(model, a)
            dof = None if joint is None else int(model.jnt_dofadr[joint])
            reach = _DEFAULT_AMPLITUDE if dof is None else amplitude[dof]
            gear = float(np.linalg.norm(model.actuator_gear[a])) or 1.0
            stiffness = abs(float(model.actuator_biasprm[a, 1])) or abs(float(model.actuator_gainprm[a, 0]))
            force[a] = 0.2 * stiffness * reach * gear
            if model.actuator_forcelimited[a]:
                force[a] = min(force[a], float(np.abs(model.actuator_forcerange[a]).max())) or force[a]
            if dof is not None:
                torque[dof] = max(torque[dof], force[a] * gear)
        touching = np.zeros(model.ngeom, bool)
        touching[ground_geoms(model)[0]] = True
        return cls(torque, speed, amplitude, inertia, force, _command_rate(model), 0.1, *_sizes(model), touching)

    @classmethod
    def measured(
        cls,
        model: mujoco.MjModel,
        qpos: np.ndarray,
        qvel: np.ndarray,
        ctrl: np.ndarray,
        act: np.ndarray | None = None,
        command_rate: np.ndarray | None = None,
    ) -> "Scales":
        """Scales of measured states, with the forces of the believed model at these states.

        Args:
          model: the believed model.
          qpos: (N, nq) configurations; a few hundred rows are enough.
          qvel: (N, nv) velocities.
          ctrl: (N, nu) controls at the same times.
          act: (N, na) activation states of actuators; None for zeros.
          command_rate: (nu,) peak rate of each command; None for a guess.
        """
        guess = cls.of(model)
        model = copy.copy(model)
        data = mujoco.MjData(model)
        torque, inertia, force = [], [], []
        touching, ground = np.zeros((2, model.ngeom), bool)
        ground[ground_geoms(model)[1]] = True
        model.geom_margin[:] = np.maximum(model.geom_margin, 0.01 * guess.length)
        model.geom_gap[:] = model.geom_margin  # contacts are detected, but without force
        for k in range(len(qpos)):
            data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[k], qvel[k], ctrl[k]
            if act is not None:
                data.act[:] = act[k]
            mujoco.mj_forward(model, data)
            torque.append(np.abs(data.qfrc_actuator))
            force.append(np.abs(data.actuator_force[: len(guess.force)]))
            if k % 16 == 0:
                full = np.zeros((model.nv, model.nv))
                mujoco.mj_fullM(model, data, full)
                inertia.append(np.diag(full).copy())
            pairs = data.contact.geom[: data.ncon]
            touching[pairs[ground[pairs].any(axis=1)]] = True
        touching &= ~ground
        speed = np.maximum(np.percentile(np.abs(qvel), 99, axis=0), 1e-3 * guess.speed)
        amplitude = _amplitude(model, qpos, guess.amplitude)
        mean_inertia = np.maximum(np.mean(inertia, axis=0), 1e-12)
        driven = np.percentile(torque, 99.5, axis=0)
        passive = mean_inertia * speed**2 / np.maximum(amplitude, 1e-9)
        if has_closed_loops(model) and driven.any():
            passive = np.maximum(passive, float((driven * speed).max()) / speed)
        hinges = driven > 0
        ratio = (amplitude / speed)[hinges if hinges.any() else slice(None)]
        time = float(np.median(ratio)) if ratio.size else guess.time
        return cls(
            np.where(hinges, driven, np.maximum(passive, 1e-9)),
            speed,
            amplitude,
            mean_inertia,
            np.maximum(np.percentile(force, 99.5, axis=0), 1e-6 * guess.force),
            guess.command_rate if command_rate is None else command_rate,
            time,
            guess.length,
            guess.mass,
            touching,
        )


def _command_rate(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) a guess: the range of the control, or two units of it, in a tenth of a second."""
    limited = model.actuator_ctrllimited.astype(bool)
    return np.where(limited, np.ptp(model.actuator_ctrlrange, axis=1), 2.0) / 0.1


def has_closed_loops(model: mujoco.MjModel) -> bool:
    """Whether equality constraints close kinematic loops, so that motors also drive joints without actuators."""
    return bool(model.neq) and bool(model.eq_active0.any())


def _amplitude(model: mujoco.MjModel, qpos: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """(nv,) half the 1-99 % range of motion of hinges and slides; the guess for free and ball joints."""
    out = guess.copy()
    for j in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        low, high = np.percentile(qpos[:, model.jnt_qposadr[j]], [1, 99])
        dof = model.jnt_dofadr[j]
        out[dof] = max(0.5 * (high - low), 1e-3 * guess[dof])
    return out


def _sizes(model: mujoco.MjModel) -> tuple[float, float]:
    moving = model.body_weldid != 0
    geoms = moving[model.geom_bodyid]
    reach = model.geom_rbound[geoms]
    length = max(float(model.stat.extent) / 2, float(reach.max(initial=0)), 1e-6)
    return (min(length, 10 * float(reach.max(initial=length))), max(float(model.body_mass[moving].sum()), 1e-9))


def smallest_believed(model: mujoco.MjModel, field: str, place: Place) -> float:
    """Smallest value of a model field (nv,) over the joints of a place: as large a decrease keeps all positive."""
    return float(np.min(getattr(model, field)[place.dofs(model)]))


def typical_scale(values: np.ndarray, place: Place, model: mujoco.MjModel) -> float:
    """Geometric mean of sizes (nv,), such as those of `Scales`, over the joints of a place."""
    return float(np.exp(np.mean(np.log(np.maximum(values[place.dofs(model)], 1e-300)))))


def unit_of(model: mujoco.MjModel, place: Place, hinge: str, slide: str) -> str:
    """Unit of a parameter at a place: one if all its joints are hinges, else the other."""
    kinds = model.jnt_type[list(place.joints)]
    return hinge if (kinds == int(mujoco.mjtJoint.mjJNT_HINGE)).all() else slide
