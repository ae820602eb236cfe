"""Commands of motors in another unit, such as amperes: are all forces the same share of what the model believes?

One factor of all commands is fitted to short predictions of the believed model. That one motor is weak is physics; that
all are weak alike, by a factor that no wear has, is more likely a unit. It cannot be told from a wrong gear of all
drives, so that this is a warning.
"""

import mujoco
import numpy as np

from btr_mjx.gap.data import Dataset, Noise, control_columns, listed, quoted, unit_text
from btr_mjx.gap.preflight.alternatives.units import TURNS
from btr_mjx.gap.preflight.comparison import Comparison, compare
from btr_mjx.gap.preflight.findings import Finding
from btr_mjx.gap.preflight.lerobot_tables import toml_lines
from btr_mjx.gap.preflight.predictions import Change, ColumnMap, Predictor, typical_error

_STRETCHES, _SCREENED = 32, 8
"""Stretches that decide, and those of the first look."""

_FEWEST = 5
"""Fewest stretches that can decide."""

_WELL = 5e-4
"""Error variance, as a share of the motion, below which commands are not questioned: 2 % of the motion."""

_OCTAVES = 6
"""Factors are looked for from 2^-6 to 2^6."""

_RATIO = 4.0
"""The factor must halve the error (rms)."""

_NO_MOTION = 1.0
"""Error (rms) of a prediction that nothing moves: with the right factor, the model predicts better than that."""

_OFF, _OFF_ALONE = 1.25, 2.0
"""Smallest factor, or its inverse, of several motors alike: they do not all lose a fifth of their force. A single motor
may: it has to lose half."""

_APART = 1.25
"""One motor that is predicted better with so much more or less than the common factor is not like the others."""


def drive_strength(dataset: Dataset, noise: Noise) -> list[Finding]:
    """A warning where forces of all motors are the same share of the believed ones; of data in sound conventions."""
    model = dataset.model
    moved = np.any([np.ptp(r.ctrl, axis=0) > 0 for r in dataset.recordings], axis=0)
    motors = [a for a in range(model.nu) if moved[a] and _is_motor(model, a)]
    predictor = Predictor(dataset, noise, _STRETCHES)
    if not motors or len(predictor) < _FEWEST:
        return []
    every = range(len(predictor.groups))
    now = typical_error(predictor.errors([Change.none(model)])[0], every)
    if float(np.median(now)) < _WELL:
        return []
    factor = _best_factor(predictor, model, motors)
    off = _OFF if len(motors) > 1 else _OFF_ALONE
    if 1 / off < factor < off:
        return []
    common = np.full(len(motors), factor)
    apart = [
        np.where(np.arange(len(motors)) == i, factor * x, factor)
        for i in range(len(motors))
        for x in (_APART, 1 / _APART)
    ]
    apart = apart if len(motors) > 1 else []
    changes = [_times(model, motors, factors) for factors in (np.zeros(len(motors)), common, *apart)]
    powerless, best, *others = (typical_error(errors, every) for errors in predictor.errors(changes))
    found = compare(now, best)
    if not (found.decisive(_RATIO) and found.after < _NO_MOTION) or not compare(powerless, best).significant:
        return []
    if any(compare(best, other).significant for other in others):
        return []
    return [_finding(dataset, motors, factor, found, predictor.seconds)]


def _is_motor(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the force of an actuator is its command times a constant."""
    fixed = int(model.actuator_gaintype[actuator]) == mujoco.mjtGain.mjGAIN_FIXED
    return fixed and not model.actuator_biasprm[actuator, :3].any()


def _times(model: mujoco.MjModel, motors: list[int], factors: np.ndarray) -> Change:
    """Commands of motors times factors (m,)."""
    ctrl = ColumnMap.affine(model.nu)
    ctrl.scale[motors] = factors
    return Change(ColumnMap.affine(model.nq), ctrl)


def _best_factor(predictor: Predictor, model: mujoco.MjModel, motors: list[int]) -> float:
    """The common factor with the smallest error: a scan in half octaves, then bisection around the best one."""
    every = range(len(predictor.groups))

    def error(powers: np.ndarray, few: Predictor) -> np.ndarray:
        changes = [_times(model, motors, np.full(len(motors), 2.0**power)) for power in powers]
        return np.array([np.mean(np.log(typical_error(errors, every))) for errors in few.errors(changes)])

    powers, step = np.linspace(-_OCTAVES, _OCTAVES, 4 * _OCTAVES + 1), 0.5
    best = float(powers[np.argmin(error(powers, predictor.few(_SCREENED)))])
    while step > 0.02:  # 1.4 %
        step /= 2
        near = best + step * np.array([-1.0, 0.0, 1.0])
        best = float(near[np.argmin(error(near, predictor.few(2 * _SCREENED)))])
    return 2.0**best


def _finding(dataset: Dataset, motors: list[int], factor: float, found: Comparison, seconds: float) -> Finding:
    model, columns = dataset.model, control_columns(dataset.model)
    own = [dataset.sources.get(columns[a], "" if dataset.sources else columns[a]) for a in motors]
    texts = [unit_text(columns[a], factor * dataset.factors.get(columns[a], 1.0), model) for a in motors]
    lines: tuple[str, ...] = ()
    if all(own):
        stated = [f'{quoted(name)} = "{_per_ampere(text)}"' for name, text in zip(own, texts, strict=True)]
        lines = toml_lines(dataset, ["[units]", *stated])
    who = "of all motors alike" if len(motors) == model.nu > 1 else f"of {listed(columns[a][5:] for a in motors)}"
    message = (
        f"the forces {who} seem to be {factor:.3g} times what the model makes of the commands: with that, it predicts "
        f"{seconds:.2g} s ahead with {found.words()}. The commands may have another unit, such as a current (with a "
        f"torque constant of {_per_ampere(texts[0])}); if so, say it in [units]"
    )
    for unit in TURNS:
        if abs(np.log(factor * unit.scale)) < np.log(_OFF) / 2:
            message += f". Positions in {unit.words} would look the same where no weight tells them apart"
    return Finding("warning", "units", message, "state the unit of the commands", found.evidence(), lines)


def _per_ampere(text: str) -> str:
    return f"{text}/A" if text[:1].isdigit() else text
