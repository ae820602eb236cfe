"""Hidden cases: recordings of a simulated reality that differs from the believed model, drawn from a seed.

Drawn are the missing effects (one, two, none, or one outside the library) with their places and sizes, the noise of the
sensors and their sampling rate. In every case, nulls included, reality also has small errors of calibration everywhere.
Reality is simulated in native MuJoCo, float64, with a time step of 1e-4 s and the implicit integrator.

    truth = make_case("folder", seed=7)         # writes a dataset and returns the truth

The truth is not written into the folder.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import DatasetDescription, Format, Recording, save_dataset
from btr_mjx.gap.results import Verdict
from hidden_cases.case_sampling import Draw, Missing, add_effects, draw_background
from hidden_cases.motion import Restart, peak_loads, simulate_reality
from hidden_cases.outside import OUTSIDE, possible_outside
from hidden_cases.physics import HiddenReality
from hidden_cases.robots import case_robot

RATES = (200, 250, 400, 500)
"""Sampling rates [1/s]."""
SHARES: Mapping[Verdict, float] = {"none": 0.22, "unexplained": 0.18, "effect": 0.60}
"""Probabilities of the kinds of cases."""


@dataclass(frozen=True)
class Truth:
    """The truth of a case.

    Attributes:
      robot: name of the case robot.
      seed: seed of the case.
      verdict: the correct verdict.
      effects: missing effects of the library.
      outside: name and place of a missing effect outside the library, "" for none.
      rate: samples per second.
      noise: factor on the sensors' noise.
      visible: chi^2 of the change of motion that the missing effect causes within 40 ms, in units of the noise, after a
        fit of starting position and velocity, summed over all windows of the recordings to fit; 0 for no effect. A
        rough measure of detectability.
    """

    robot: str
    seed: int
    verdict: Verdict
    effects: tuple[Missing, ...]
    outside: str
    rate: int
    noise: float
    visible: float = 0.0


@dataclass(frozen=True)
class CaseSettings:
    """Settings of a case; a setting that is None is drawn from the seed.

    Attributes:
      verdict: kind of case.
      effects: number of missing effects, or their names.
      outside: name of the effect outside the library.
      each: joint effects have a number of their own for every joint.
      rate: samples per second; drawn from `RATES`.
      noise: factor on the robot's sensor noise; drawn from 1 to 3.
      recordings: numbers of recordings to fit and held out.
      duration: duration of a recording [s]; None for the robot's own.
      background: factor on the small errors of calibration.
      file_format: format of the recordings.
    """

    verdict: Verdict | None = None
    effects: Sequence[str] | int = 1
    outside: str | None = None
    each: bool = False
    rate: int | None = None
    noise: float | None = None
    recordings: tuple[int, int] = (8, 4)
    duration: float | None = None
    background: float = 1.0
    file_format: Format = "npz"


def make_case(folder: str | Path, seed: int, robot: str = "hexapod", settings: CaseSettings = CaseSettings()) -> Truth:
    """Draw a case and write its dataset.

    Args:
      folder: folder of the dataset.
      seed: seed of everything that is drawn.
      robot: name of a case robot.
      settings: settings that are not drawn.

    Returns:
      The truth.

    Raises:
      InputError: a robot, an effect or a verdict that does not exist, or an effect that the robot cannot have.
    """
    machine = case_robot(robot)
    if settings.duration is not None:
        machine = replace(machine, duration=settings.duration)
    rng = np.random.default_rng([seed, 17])
    chosen: Verdict = _drawn_verdict(rng) if settings.verdict is None else settings.verdict
    drawn_rate, drawn_noise = int(rng.choice(RATES)), float(np.exp(rng.uniform(0, np.log(3))))
    rate, noise = settings.rate or drawn_rate, drawn_noise if settings.noise is None else settings.noise
    motions = [machine.draw_motion(rng) for _ in range(sum(settings.recordings))]
    draw = Draw(machine, rng, motions, peak_loads(machine, motions[:3]), settings.each)
    reality, missing, where = draw_reality(draw, chosen, settings.effects, settings.outside, settings.background)
    rows = [simulate_reality(reality, motion, machine.duration, rate) for motion in motions]
    visible = 0.0 if chosen == "none" else _visible(draw, rows[: settings.recordings[0]], rate, noise)
    _write(folder, draw, rows, noise, settings)
    return Truth(robot, seed, chosen, missing, where, rate, noise, visible)


def draw_reality(
    draw: Draw, verdict: Verdict, effects: Sequence[str] | int, outside: str | None, background: float
) -> tuple[HiddenReality, tuple[Missing, ...], str]:
    """Draw a reality with small errors of calibration and with the missing effects.

    Args:
      draw: the case; the small errors are added to its background.
      verdict: kind of case.
      effects: number of missing effects, or their names.
      outside: name of the effect outside the library; None draws it.
      background: factor on the small errors.

    Returns:
      The reality, the missing effects of the library, and name and place of a missing effect outside it.

    Raises:
      InputError: see `make_case`.
    """
    disturb = draw_background(draw, background)
    disturb(draw.background)
    reality = HiddenReality.of(draw.robot)
    disturb(reality)
    if verdict == "effect":
        return reality, add_effects(draw, reality, effects), ""
    if verdict == "none":
        return reality, (), ""
    if verdict != "unexplained":
        raise InputError(f"verdict {verdict!r}: expected 'effect', 'none' or 'unexplained'")
    names = possible_outside(reality)
    name = str(draw.rng.choice(names)) if outside is None else outside
    if name not in names:
        raise InputError(f"effect outside the library {name!r}: {draw.robot.name} can have {', '.join(names)}")
    place = OUTSIDE[name](reality, list(draw.loads.torque), draw.loads, draw.rng)
    return reality, (), f"{name} at {place}"


def _drawn_verdict(rng: np.random.Generator) -> Verdict:
    names: list[Verdict] = list(SHARES)
    return names[int(rng.choice(len(names), p=list(SHARES.values())))]


def _visible(draw: Draw, rows: Sequence[Mapping[str, np.ndarray]], rate: int, noise: float) -> float:
    """`Truth.visible`: reality against a reality with the small errors alone, both from the same states every 40 ms."""
    model = draw.robot.model
    sigma_q, sigma_v = (noise * s for s in draw.robot.sigma(model))
    samples, total = max(4, round(0.04 * rate)), 0.0
    used = min(2, len(rows))
    for motion, row in zip(draw.motions[:used], rows, strict=False):
        without = simulate_reality(draw.background, motion, draw.robot.duration, rate, restart=Restart(row, samples))
        count = len(row["time"]) // samples * samples
        moves = np.zeros((count, model.nv))
        for k in range(count):
            mujoco.mj_differentiatePos(model, moves[k], 1.0, without["qpos"][k], row["qpos"][k])
        speeds = (row["qvel"] - without["qvel"])[:count]
        both = np.stack([moves / sigma_q, speeds / sigma_v], 1).reshape(-1, samples, 2, model.nv)
        time = np.arange(samples) / rate
        # Columns of a fit of starting position and velocity: positions shift, or drift with a constant velocity.
        shift = np.stack([np.ones(samples) / sigma_q[:, None], np.zeros((model.nv, samples))], 1)
        drift = np.stack([time / sigma_q[:, None], np.ones(samples) / sigma_v[:, None]], 1)
        for joint in range(model.nv):
            basis = np.linalg.qr(np.stack([shift[joint].ravel(), drift[joint].ravel()], 1))[0]
            signal = both[:, :, :, joint].transpose(0, 2, 1).reshape(len(both), -1)
            total += float(np.sum((signal - signal @ basis @ basis.T) ** 2))
    return total * len(rows) / used


def _write(
    folder: str | Path,
    draw: Draw,
    rows: Sequence[Mapping[str, np.ndarray]],
    noise: float,
    settings: CaseSettings,
) -> None:
    model, rng = draw.robot.model, draw.rng
    sigma_q, sigma_v = (noise * s for s in draw.robot.sigma(model))
    recordings = []
    for i, (motion, row) in enumerate(zip(draw.motions, rows, strict=True)):
        qpos = row["qpos"].copy()
        for k, error in enumerate(rng.normal(size=row["qvel"].shape) * sigma_q):
            mujoco.mj_integratePos(model, qpos[k], error, 1.0)
        recordings.append(
            Recording(
                name=f"behaviour_{i + 1:02d}",
                time=row["time"],
                ctrl=motion(row["time"]),
                qpos=qpos,
                qvel=row["qvel"] + rng.normal(size=row["qvel"].shape) * sigma_v,
                qvel_measured=np.ones(model.nv, bool),
                split="fit" if i < settings.recordings[0] else "test",
                model=model,
            )
        )
    save_dataset(
        folder, draw.robot.xml, recordings, DatasetDescription(interpolation="cubic"), file_format=settings.file_format
    )
