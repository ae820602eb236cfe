"""What the chosen interpolation of commands is worth: `uv run python benchmarks/command_interpolation.py`.

An arm with a motor and friction follows commands of several kinds, which are known at every step of a simulation.
Recorded are its positions and the commands at a lower rate. The same model then simulates the recording open loop with
the commands as straight lines between samples, and as `dataset.toml` without an interpolation has them: cubics where
`bends` finds that they predict left-out samples better. Printed are, for each kind, how often cubics were chosen,
the error of the position with either, the mean of the paired differences with its standard error, and the rotor inertia
that would explain the error, in percent of the arm's own.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro

from btr_mjx.gap.data import Interpolation, bends
from btr_mjx.gap.simulate.commands import Command

ARM = """<mujoco><option timestep="{step}"><flag contact="disable"/></option><worldbody><body>
<joint name="hinge" axis="0 1 0" damping="0.05" frictionloss="0.02" armature="{armature}"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.4"/></body></worldbody>
<actuator><motor joint="hinge" gear="2"/></actuator></mujoco>"""
STEP = 1e-3
"""Time step of the truth and of the simulation [s]: they differ by the command between its samples alone."""


@dataclass(frozen=True)
class Config:
    """Settings; every field is a flag."""

    cases: int = 20
    """Recordings of each kind."""
    duration: float = 4.0
    """Of a recording [s]."""
    rates: tuple[float, ...] = (50.0, 100.0)
    """Sampling rates [Hz], one after the other."""
    json: Path | None = None
    """Also write the numbers to this file."""


def kinds(rng: np.random.Generator, duration: float) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """One random command of each kind, as a function of time."""
    frequencies, phases, sizes = rng.uniform(0.4, 4, 4), rng.uniform(0, 2 * np.pi, 4), rng.uniform(0.1, 0.3, 4)
    knots = np.sort(rng.uniform(0, duration, 9))
    levels = rng.uniform(-0.6, 0.6, len(knots) + 1)

    def sines(t: np.ndarray) -> np.ndarray:
        return np.sin(2 * np.pi * frequencies * t[:, None] + phases) @ sizes

    def moves(t: np.ndarray) -> np.ndarray:
        """From level to level, each move with the least jerk."""
        turn = np.searchsorted(knots, t)
        starts, ends = np.concatenate([[0], knots]), np.concatenate([knots, [duration]])
        s = np.clip((t - starts[turn]) / np.maximum(ends - starts, 1e-9)[turn], 0, 1)
        following = np.concatenate([levels[1:], levels[-1:]])
        return levels[turn] + (following - levels)[turn] * s**3 * (10 - 15 * s + 6 * s**2)

    noise = rng.normal(size=round(duration / 0.01) + 2)
    return {
        "sines": sines,
        "moves": moves,
        "ramps": lambda t: np.interp(t, knots, levels[1:]),
        "clipped sines": lambda t: np.clip(2 * sines(t), -0.3, 0.3),
        "noisy sines": lambda t: sines(t) + 0.05 * noise[np.round(t / 0.01).astype(int)],
    }


def simulate(command: Callable[[np.ndarray], np.ndarray], duration: float, armature: float) -> np.ndarray:
    """Angles at the starts of the steps under commands at the starts of the steps."""
    model = mujoco.MjModel.from_xml_string(ARM.format(step=STEP, armature=armature))
    data, found = mujoco.MjData(model), []
    for value in command(np.arange(round(duration / STEP)) * STEP):
        found.append(data.qpos[0])
        data.ctrl[0] = value
        mujoco.mj_step(model, data)
    return np.array(found)


def errors(
    truth: np.ndarray, times: np.ndarray, values: np.ndarray, interpolation: Interpolation, duration: float
) -> tuple[float, float]:
    """Root mean square error of the angle [rad], and the rotor inertia that explains most of it [kg m^2]."""
    command = Command(times, values[:, None], interpolation)
    every = round((times[1] - times[0]) / STEP)
    own = [simulate(lambda t: command.at(t)[:, 0], duration, a)[::every] for a in (0.0, 1e-4)]
    slope, error = (own[1] - own[0]) / 1e-4, truth - own[0]
    return float(np.sqrt(np.mean(error**2))), float(slope @ error / (slope @ slope))


def main(config: Config) -> None:
    """Print the table."""
    model = mujoco.MjModel.from_xml_string(ARM.format(step=STEP, armature=0))
    inertia = float(model.dof_M0[0])
    table = []
    print(f"{'kind':14s} rate  cubic  error [mrad]: linear  chosen  difference          rotor [%]: linear  chosen")
    for rate in config.rates:
        found: dict[str, list[tuple[float, ...]]] = {}
        for case in range(config.cases):
            for name, function in kinds(np.random.default_rng(case), config.duration).items():
                truth = simulate(function, config.duration, 0.0)[:: round(1 / rate / STEP)]
                times = np.arange(len(truth)) / rate
                values = function(times)
                curved = bends([(times, values[:, None])])
                straight = errors(truth, times, values, "linear", config.duration)
                chosen = errors(truth, times, values, "cubic", config.duration) if curved else straight
                found.setdefault(name, []).append((curved, straight[0], chosen[0], straight[1], chosen[1]))
        for name, rows in found.items():
            share, linear, chosen, rotor, chosen_rotor = np.array(rows).T
            gain = 1e3 * (chosen - linear)
            row = {
                "kind": name,
                "rate": rate,
                "cubic": share.mean(),
                "linear": 1e3 * linear.mean(),
                "chosen": 1e3 * chosen.mean(),
                "difference": gain.mean(),
                "standard error": gain.std(ddof=1) / np.sqrt(len(gain)),
                "rotor linear": 100 * rotor.mean() / inertia,
                "rotor chosen": 100 * chosen_rotor.mean() / inertia,
            }
            table.append(row)
            print(
                f"{name:14s} {rate:4.0f}  {row['cubic']:5.2f}  {row['linear']:20.3f}  {row['chosen']:6.3f}  "
                f"{row['difference']:+.3f} +- {row['standard error']:.3f}  {row['rotor linear']:+18.2f}  "
                f"{row['rotor chosen']:+6.2f}",
                flush=True,
            )
    if config.json:
        config.json.write_text(json.dumps(table, indent=1))


if __name__ == "__main__":
    main(tyro.cli(Config))
