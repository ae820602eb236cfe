"""The missing effect from fitness alone: which candidate makes Delta_fitness fall, on trials that were held out, too.

Nothing but one number a trial is known, and after a whole trial contacts have mixed up what small causes did. So there
are no windows and no derivatives: candidates are tried at a few sizes on a few trials, the better ones on more trials
and at finer sizes (successive halving), and the leaders are refined by a line search. What comes out is a ranking and
the fall of Delta_fitness; that something outside the library is missing cannot be told from nothing by these data.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from btr_mjx.fitness import Outcome, fitness_function
from btr_mjx.gap.commands import Command
from btr_mjx.gap.diagnosis import Diagnosis, DisagreementMap, Estimate, Gap, Named, Row
from btr_mjx.gap.effect import Candidate, Effect, candidates
from btr_mjx.gap.effects import EFFECTS
from btr_mjx.gap.fitness_table import FitnessTable
from btr_mjx.gap.scales import Scales
from btr_mjx.gap.worlds import Counter, Stretch, World, simulate

SIZES = (4.0, 20.0, -8.0)
"""Sizes at which a candidate is tried first, in finite-difference steps of a parameter."""
FALL = 0.25
"""Share by which Delta_fitness has to fall, on both sides of the split, for a name."""
ROUNDS = ((8, 1.0), (20, 0.1), (10**6, 0.03))
"""Trials that are simulated in each round, and the share of the candidates that get so far."""
REFINED = 6
"""Leaders that are refined."""


@dataclass(frozen=True)
class _Try:
    """A candidate at some values."""

    candidate: Candidate
    values: tuple[float, ...]


class Trials:
    """Simulates the trials of a table in worlds.

    Attributes:
      table: the data.
      counter: simulated steps so far.
    """

    def __init__(self, table: FitnessTable) -> None:
        self.table, self.counter = table, Counter()
        model = table.head.model
        times = np.arange(0.0, table.duration + 0.002, min(0.05 / table.omega, 0.01))
        self._commands = tuple(Command(times, values, "cubic") for values in table.commands(times))
        self._start = np.array(model.qpos0), np.zeros(model.nv)
        joint = int(model.body_jntadr[model.body(table.body).id])
        free = joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
        self._address = int(model.jnt_qposadr[joint]) if free else None
        self._function = fitness_function(table.function)

    def fitness(self, worlds: Sequence[World], rows: np.ndarray, timestep: float | None = None) -> np.ndarray:
        """Fitness (worlds, rows) of some trials; NaN where a simulation diverged."""
        count = len(rows)
        stretch = Stretch(
            np.zeros(count),
            np.tile(self._start[0], (count, 1)),
            np.tile(self._start[1], (count, 1)),
            np.array([self.table.duration]),
            tuple(self._commands[i] for i in rows),
            np.arange(count),
        )
        states = simulate([(world, stretch) for world in worlds], timestep=timestep, counter=self.counter)
        model = self.table.head.model
        start = self._positions(self._start[0][None], model)[0]
        out = []
        for found in states:
            position = self._positions(found[:, 0, : model.nq], model)
            times = np.array([self.table.duration])
            out.append(self._function(Outcome(times, start, position[:, None], np.zeros((count, 1)))))
        return np.array(out)

    def _positions(self, qpos: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
        """Positions (N, 3) of the body in configurations (N, nq)."""
        if self._address is not None:
            return qpos[:, self._address : self._address + 3]
        data, body, out = mujoco.MjData(model), model.body(self.table.body).id, np.full((len(qpos), 3), np.nan)
        for k in np.flatnonzero(np.isfinite(qpos).all(axis=1)):
            data.qpos[:] = qpos[k]
            mujoco.mj_kinematics(model, data)
            out[k] = data.xpos[body]
        return out

    def scales(self, rows: np.ndarray) -> Scales:
        """How large things are in some trials of the believed model."""
        model, states = self.table.head.model, []
        steps = round(self.table.duration / model.opt.timestep)
        for row in rows:
            data = mujoco.MjData(model)
            controls = self._commands[row].at((np.arange(steps) + 0.5) * model.opt.timestep)
            for k in range(steps):
                data.ctrl[:] = controls[k]
                if k % max(1, steps // 100) == 0:
                    states.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.act.copy()))
                mujoco.mj_step(model, data)
        qpos, qvel, ctrl, act = (np.array(column) for column in zip(*states, strict=True))
        return Scales.measured(model, qpos, qvel, ctrl, act if model.na else None)

    def delta(self, tries: Sequence[_Try | None], rows: np.ndarray) -> np.ndarray:
        """Delta_fitness of some tries over some trials; a diverged trial counts as the worst spread of fitness."""
        model = self.table.head.model
        worlds = [World.of(model) if t is None else t.candidate.apply(World.of(model), t.values) for t in tries]
        real = self.table.fitness[rows]
        worst = float(np.ptp(self.table.fitness)) + 1e-12
        return np.nan_to_num(np.abs(self.fitness(worlds, rows) - real), nan=worst).mean(axis=1)


def identify_fitness(
    table: FitnessTable,
    effects: Sequence[Effect] = EFFECTS,
    progress: Callable[[str], None] | None = None,
    rounds: Sequence[tuple[int, float]] = ROUNDS,
) -> Diagnosis:
    """Rank effects by how far they make Delta_fitness fall.

    Args:
      table: the trials.
      effects: the library.
      progress: called with a word on what is being done.
      rounds: see `ROUNDS`.

    Returns:
      A diagnosis; its verdict is "effect" or "none". Its gap is Delta_fitness on the held-out trials [m/s], its noise
      floor what half the time step alone changes.
    """
    begun, note = time.monotonic(), progress or (lambda _: None)
    trials, model = Trials(table), table.head.model
    fit, test = np.flatnonzero(~table.test), np.flatnonzero(table.test)
    scales = trials.scales(fit[:3])
    tries: list[_Try] = [t for c in candidates(model, scales, effects) for t in _starts(c)]
    score: dict[_Try, float] = {}
    for trial_count, share in rounds:
        rows = fit[:trial_count]
        kept = sorted(tries, key=lambda t: score.get(t, 0.0))[: max(REFINED, round(share * len(tries)))]
        note(f"{len(kept)} candidates on {len(rows)} trials")
        before = float(trials.delta([None], rows)[0])
        score = {t: float(d) - before for t, d in zip(kept, trials.delta(kept, rows), strict=True)}
        tries = kept
        if len(rows) == len(fit):
            break
    best: dict[str, _Try] = {}
    for t in sorted(tries, key=score.__getitem__):
        best.setdefault(t.candidate.name, t)
    leaders = list(best.values())[:REFINED]
    note("leaders")
    refined = [_refine(trials, leader, fit) for leader in leaders]
    believed = [float(trials.delta([None], rows)[0]) for rows in (fit, test)]
    found = []
    for t, value in refined:
        held_out = float(trials.delta([t], test)[0])
        found.append((t, value, held_out))
    found.sort(key=lambda item: item[1])
    half = trials.fitness([World.of(model)] * 1, test, 0.5 * float(model.opt.timestep))[0]
    usual = trials.fitness([World.of(model)], test)[0]
    floor = float(np.nanmean(np.abs(half - usual)))
    rest = [(t, believed[0] + score[t], float("nan")) for t in list(best.values())[REFINED:]]
    return _diagnosis(found, rest, believed, floor, trials, time.monotonic() - begun)


def _starts(candidate: Candidate) -> list[_Try]:
    """A candidate at its first sizes, on both sides of its null where it may go there."""
    first = candidate.parameters[0]
    rest = [p.null for p in candidate.parameters[1:]]
    out = []
    vector = len(candidate.parameters) > 1 and not candidate.parameters[1].shape
    axes = range(len(candidate.parameters)) if vector else [0]
    for axis in axes:
        parameter = candidate.parameters[axis]
        for factor in SIZES:
            value = float(np.clip(parameter.null + factor * parameter.step, parameter.low, parameter.high))
            values = [p.null for p in candidate.parameters] if vector else [first.null, *rest]
            values[axis] = value
            if value != parameter.null and _Try(candidate, tuple(values)) not in out:
                out.append(_Try(candidate, tuple(values)))
    return out


def _refine(trials: Trials, start: _Try, rows: np.ndarray, passes: int = 3) -> tuple[_Try, float]:
    """A line search in each parameter by shrinking factors; returns the best try and its Delta_fitness."""
    best, value = start, float(trials.delta([start], rows)[0])
    reach = 2.0
    for _ in range(passes):
        tries = []
        for axis, parameter in enumerate(start.candidate.parameters):
            away = best.values[axis] - parameter.null
            size = away if away else 3.0 * parameter.step
            for factor in (1 / reach, reach) if away else (-1.0, 1.0):
                moved = parameter.null + size * factor
                values = list(best.values)
                values[axis] = float(np.clip(moved, parameter.low, parameter.high))
                tries.append(_Try(start.candidate, tuple(values)))
        found = trials.delta(tries, rows)
        if found.min() < value:
            best, value = tries[int(np.argmin(found))], float(found.min())
        reach = np.sqrt(reach)
    return best, value


def _diagnosis(
    found: Sequence[tuple[_Try, float, float]],
    rest: Sequence[tuple[_Try, float, float]],
    believed: Sequence[float],
    floor: float,
    trials: Trials,
    seconds: float,
) -> Diagnosis:
    rows = []
    for t, fitted, held_out in (*found, *rest):
        parameters = {p.name: v for p, v in zip(t.candidate.parameters, t.values, strict=True)}
        gain, gain_held_out = believed[0] - fitted, believed[1] - held_out
        rows.append(
            Row(
                t.candidate.effect.name,
                t.candidate.place.label,
                100 * gain / believed[0],
                100 * (fitted - found[0][1]) / believed[0],
                gain,
                gain_held_out,
                parameters,
            )
        )
    first, fitted, held_out = found[0]
    named = min(1 - fitted / believed[0], 1 - held_out / believed[1]) >= FALL
    close = tuple(
        f"{t.candidate.effect.name}@{t.candidate.place.label}"
        for t, value, _ in found
        if value <= fitted + 0.25 * (believed[0] - fitted)
    )
    effects: tuple[Named, ...] = ()
    if named:
        nan = float("nan")
        numbers = {
            p.name: Estimate(v, nan, nan, p.unit, p.null)
            for p, v in zip(first.candidate.parameters, first.values, strict=True)
        }
        effect = first.candidate.effect
        same = tuple(name for name in close if name != first.candidate.name)
        effects = (
            Named(
                effect.name,
                first.candidate.place.label,
                numbers,
                rows[0].score,
                rows[0].held_out,
                same,
                effect.excited_by,
                effect.equation,
            ),
        )
    nan = float("nan")
    gap = Gap(believed[1], held_out if named else believed[1], floor, nan, nan, nan, nan)
    notes = (
        "Only fitness was known: scores are per cent of Delta_fitness, the gap is Delta_fitness on held-out trials "
        "[m/s], its noise floor what half the time step changes. Fitness alone does not give intervals, and something "
        "outside the library looks like nothing.",
    )
    return Diagnosis(
        verdict="effect" if named else "none",
        effects=effects,
        ranking=tuple(rows),
        equivalent=close if named else (),
        gap=gap,
        disagreement=DisagreementMap((), (), np.zeros((0, 0)), np.zeros((0, 0), int)),
        unexplained=(),
        believed=(),
        confounds=(),
        overlays=(),
        share=float("nan"),
        lack_of_fit=(float("nan"), float("nan")),
        threshold=100 * FALL,
        dispersion=1.0,
        sigma=np.zeros(0),
        windows=(
            len(trials.table.fitness) - int(trials.table.test.sum()),
            int(trials.table.test.sum()),
            1,
            trials.table.duration,
        ),
        steps=trials.counter.steps,
        seconds=seconds,
        notes=notes,
    )
