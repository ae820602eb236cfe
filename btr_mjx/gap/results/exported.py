"""Named effects, refitted parameters and calibration for other programs."""

from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco

from btr_mjx.exports import Ends, ExportedParameter, field_ends, is_linear, write_exports
from btr_mjx.gap.data import Dataset
from btr_mjx.gap.results.diagnosis import Diagnosis
from btr_mjx.gap.results.mended_model import MendedModel
from btr_mjx.gap.results.records import FoundEffect, NamedEffect

Mend = Callable[[Sequence[FoundEffect]], MendedModel]
"""The believed model with effects, see `mended_model.mend`."""


def export_diagnosis(diagnosis: Diagnosis, dataset: Dataset, folder: Path, mended: Mend) -> None:
    """Write the exports of a diagnosis into its run folder, see `btr_mjx.exports`."""
    paths = {parameter.name: parameter for parameter in dataset.parameters}
    exported = [
        ExportedParameter(
            refit.name, paths[refit.name].unit if refit.name in paths else "", refit.final, None, None, "refitted"
        )
        for refit in diagnosis.believed
    ]
    names = "named effect" if diagnosis.effects else "unnamed part of a model that predicts better"
    every = [(effect, names) for effect in diagnosis.found] + [(one, "calibration") for one in diagnosis.calibration]
    whole = mended([effect.found() for effect in diagnosis.found]) if every else MendedModel("")
    for effect, what in every:
        also = whole.what_else(effect.name, "mended.json")
        for name, one in effect.parameters.items():
            known = one.reach is not None
            origin = f"{what}{'; 90 % interval' if known else ''}{also}"
            ends = _ends(diagnosis.found, effect, name, mended) if known else {}
            low, high = (one.low, one.high) if known else (None, None)
            exported.append(ExportedParameter(f"{effect.name} {name}", one.unit, one.value, low, high, origin, ends))
    write_exports(folder, exported)


def _ends(effects: Sequence[NamedEffect], chosen: NamedEffect, parameter: str, mended: Mend) -> Ends:
    """Numbers of the mended model that a parameter moves within its interval; none where MJCF has no such term."""
    estimate = chosen.parameters[parameter]
    models = []
    assert estimate.low is not None
    assert estimate.high is not None
    for value in (estimate.low, estimate.high, estimate.value):
        made = mended([one.found(**({parameter: value} if one is chosen else {})) for one in effects])
        if chosen.name not in made.native:
            return {}
        try:
            models.append(mujoco.MjModel.from_xml_string(made.xml))
        except ValueError:  # an end of the interval that MuJoCo refuses, such as a negative mass
            return {}
    ends = field_ends(models[0], models[1])
    share = (estimate.value - estimate.low) / (estimate.high - estimate.low) if estimate.high > estimate.low else 0.0
    return ends if is_linear(ends, share, models[0], models[2]) else {}
