"""The files of a diagnosis: result.json, tables, arrays and the mended model. The page is drawn from them alone."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset, control_columns
from btr_mjx.gap.effects import KNOWN_EFFECTS, Effect
from btr_mjx.gap.results.exported import export_diagnosis
from btr_mjx.gap.results.mended_model import MendedModel, mend, with_residual
from btr_mjx.gap.results.records import (
    Diagnosis,
    DisagreementMap,
    FoundEffect,
    JointForce,
    NamedEffect,
    NextExperiment,
    Quantity,
)
from btr_mjx.gap.results.words.terms import place_in_words
from btr_mjx.gap.results.words.verdict import detail_sentences, verdict_sentence
from btr_mjx.models import parse_path, part_names
from btr_mjx.runs import atomic_write, write_arrays, write_json, write_table

RESULT = "result.json"
"""File name of the result for scripts."""


def save_diagnosis(
    diagnosis: Diagnosis,
    dataset: Dataset,
    folder: str | Path,
    *,
    effects: Sequence[Effect] = KNOWN_EFFECTS,
    next_experiment: NextExperiment | None = None,
    more: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write a diagnosis.

    Args:
      diagnosis: the outcome of the search.
      dataset: the dataset that was searched.
      folder: folder for result.json, ranking.csv, disagreement.csv, disagreement.npz, overlays.npz, believed.csv;
        where the robot touches nothing, joint_forces.npz; where an effect was named, mended.xml, mended.json,
        parameters.csv, parameters.json and randomisation.json.
      effects: the library that was searched.
      next_experiment: proposal for next_command.csv; None if there is none.
      more: further entries of result.json.

    Returns:
      Content of result.json.

    Raises:
      OSError: the folder cannot be written to.
    """
    folder = Path(folder)
    result = as_result(diagnosis, dataset) | {"next_experiment": None} | dict(more or {})
    if next_experiment is not None:
        result["next_experiment"] = _write_command(next_experiment, dataset.model, folder)
    mended = _mended(diagnosis, dataset, effects)
    if mended is not None:
        _write_text(folder / "mended.xml", mended.xml)
        write_json(folder / "mended.json", mended.as_json())
        result["mended"] = "mended.xml"
    result["sentence"], result["details"] = verdict_sentence(result), detail_sentences(result)
    _write_tables(result, diagnosis.disagreement, folder)
    write_arrays(folder / "disagreement.npz", _map_arrays(diagnosis.disagreement))
    write_arrays(folder / "overlays.npz", _overlay_arrays(diagnosis, dataset.model))
    if diagnosis.joint_forces:
        write_arrays(folder / "joint_forces.npz", _force_arrays(diagnosis.joint_forces))
    found_again = lambda found: _mend(found, diagnosis, dataset, effects)  # noqa: E731
    export_diagnosis(diagnosis, dataset, folder, found_again)
    write_json(folder / RESULT, result)
    return result


def _mean_noise(diagnosis: Diagnosis, model: mujoco.MjModel) -> float | None:
    """Mean absolute error that the sensors' noise alone makes in positions; None where it is not known."""
    sigma = np.asarray(diagnosis.sigma, float)[: model.nv]
    sigma = sigma[np.isfinite(sigma)]
    return float(np.sqrt(2 / np.pi) * sigma.mean()) if len(sigma) else None


def _position_unit(model: mujoco.MjModel) -> str:
    """Unit of a mean over the positions of all degrees of freedom."""
    kinds = set(model.jnt_type.tolist())
    turns = kinds - {int(mujoco.mjtJoint.mjJNT_SLIDE)}
    shifts = kinds & {int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_FREE)}
    return " and ".join((["rad"] if turns else []) + (["m"] if shifts else []))


def as_result(diagnosis: Diagnosis, dataset: Dataset) -> dict[str, Any]:
    """Entries of result.json.

    Args:
      diagnosis: the outcome of the search.
      dataset: the dataset that was searched.

    Returns:
      Entries for JSON, in SI units with angles in rad.
    """
    close = set(diagnosis.equivalent)
    ranking = [
        {
            "effect": row.effect,
            "location": row.location,
            "score": row.score,
            "margin": row.margin,
            "gain": row.gain,
            "held_out": row.held_out,
            "parameters": dict(row.parameters),
            "equivalent": f"{row.effect}@{row.location}" in close and not row.beside,
            "beside": list(row.beside),
        }
        for row in diagnosis.ranking
    ]
    named = [
        _effect_entry(effect)
        | {
            "score": effect.score,
            "held_out": effect.held_out,
            "equivalent": [_entry(name) for name in effect.equivalent],
            "equation": effect.equation,
            **({"latex": effect.latex} if effect.latex else {}),
            "excited_by": effect.excited_by,
            "joint": _driven_joint(dataset.model, effect.location),
        }
        for effect in diagnosis.effects
    ]
    return {
        "verdict": diagnosis.verdict,
        "dataset": dataset.folder.name or str(dataset.folder),
        "interpolation": dataset.interpolation,
        "where": place_of_disagreement(diagnosis.disagreement),
        "effects": named,
        "calibration": [_effect_entry(effect) for effect in diagnosis.calibration],
        "ranking": ranking,
        "equivalent": [_entry(name) for name in diagnosis.equivalent],
        "gap": asdict(diagnosis.gap)
        | {"closed": diagnosis.gap.closed, "unit": "χ² per degree of freedom"}
        | {"open_loop_unit": _position_unit(dataset.model), "open_loop_noise": _mean_noise(diagnosis, dataset.model)},
        "predictions": asdict(diagnosis.predictions) if diagnosis.predictions else None,
        "joint_errors": [asdict(error) for error in diagnosis.joint_errors],
        "unexplained": list(diagnosis.unexplained),
        "residual": [table.joint for table in diagnosis.residual],
        "believed": [asdict(refit) for refit in diagnosis.believed],
        "confounds": [asdict(confound) for confound in diagnosis.confounds],
        "share": diagnosis.share,
        "lack_of_fit": dict(zip(("before", "after"), diagnosis.lack_of_fit, strict=True)),
        "threshold": diagnosis.threshold,
        "dispersion": diagnosis.dispersion,
        "noise": diagnosis.sigma,
        "windows": dict(zip(("fit", "held_out", "samples", "length"), diagnosis.windows, strict=True)),
        "steps": diagnosis.steps,
        "seconds": diagnosis.seconds,
        "notes": [*dataset.notes, *diagnosis.notes],
    }


def _driven_joint(model: mujoco.MjModel, location: str) -> str:
    """Name of the joint that the actuator of a place drives; "" for other places."""
    kind, _, name = location.partition(":")
    actuators = part_names(model, "actuator")
    if kind != "actuator" or name not in actuators:
        return ""
    number = actuators.index(name)
    drives = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    if model.actuator_trntype[number] not in drives:
        return ""
    return part_names(model, "joint")[model.actuator_trnid[number, 0]]


def before_entry(diagnosis: Diagnosis, dataset: Dataset, before: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What a diagnosis of earlier recordings said, for result.json.

    Args:
      diagnosis: of the earlier recordings.
      dataset: the earlier recordings.
      before: the entry of the recordings before those, if what they say is a change.
    """
    result = as_result(diagnosis, dataset) | {"before": before}
    keys = ("dataset", "verdict", "effects", "calibration", "believed", "unexplained", "equivalent", "notes")
    return {key: result[key] for key in keys} | {
        "sentence": verdict_sentence(result),
        "recordings": len(dataset.recordings),
    }


def save_quantities(folder: Path, quantities: Sequence[Quantity], sets: Sequence[str]) -> None:
    """Write sets.csv: numbers over sets of recordings, a row for each number and set; nothing where there are none.

    Args:
      folder: the run folder.
      quantities: the numbers.
      sets: names of the sets, the oldest first.
    """
    rows = [
        {"set": k, "name": name}
        | {key: getattr(own, key) for key in ("effect", "location", "parameter", "unit")}
        | {key: getattr(own, key)[k] for key in ("value", "low", "high", "named")}
        for own in quantities
        for k, name in enumerate(sets)
    ]
    if rows:
        write_table(folder / "sets.csv", rows)


def _effect_entry(effect: NamedEffect) -> dict[str, Any]:
    """An effect with its numbers."""
    numbers = {name: asdict(estimate) for name, estimate in effect.parameters.items()}
    return {"effect": effect.effect, "location": effect.location, "parameters": numbers}


def _entry(name: str) -> dict[str, str]:
    effect, _, location = name.partition("@")
    return {"effect": effect, "location": location}


_CONTRASTS = (
    ("fast", "slow", "when it moves fast", "when it moves slowly"),
    ("high load", "low load", "under high load", "under low load"),
    ("contact", "air", "in contact", "in the air"),
    ("late", "early", "late in the recordings", "early in the recordings"),
)


def place_of_disagreement(disagreement: DisagreementMap) -> str:
    """The place with the largest disagreement, and the regimes in which it occurs, in words.

    Args:
      disagreement: mean squares of the unknown force by place and regime, in units of the noise.

    Returns:
      Text such as "joint knee, when it moves fast"; empty where the map has no numbers or all are below 1.5.
    """
    value = np.asarray(disagreement.value, float)
    column = {name: i for i, name in enumerate(disagreement.regimes)}
    overall = value[:, column["all"]] if "all" in column else np.nanmean(value, axis=1) if value.size else value
    if not np.isfinite(overall).any() or np.nanmax(overall) < 1.5:
        return ""
    row = int(np.nanargmax(overall))
    words = []
    for more, less, more_in_words, less_in_words in _CONTRASTS:
        if more not in column or less not in column:
            continue
        # Regimes are compared by their excess over the noise floor, which is 1.
        a, b = (max(float(value[row, column[name]]) - 1.0, 0.0) for name in (more, less))
        if a > 2.0 * b + 0.2:
            words.append(more_in_words)
        elif b > 2.0 * a + 0.2:
            words.append(less_in_words)
    return ", ".join([place_in_words(disagreement.places[row]), *words[:1]]) + "".join(f" {w}" for w in words[1:3])


def _mended(diagnosis: Diagnosis, dataset: Dataset, effects: Sequence[Effect] = KNOWN_EFFECTS) -> MendedModel | None:
    """The believed model with named effects, calibration and refitted parameters; None without effects."""
    if not (diagnosis.effects or diagnosis.calibration or diagnosis.residual):
        return None
    mended = _mend([effect.found() for effect in diagnosis.effects], diagnosis, dataset, effects)
    return with_residual(mended, diagnosis.residual)


def _mend(
    found: Sequence[FoundEffect], diagnosis: Diagnosis, dataset: Dataset, effects: Sequence[Effect]
) -> MendedModel:
    """The believed model with refitted parameters, calibration and given effects; where that fails, with a note."""
    final = {refit.name: refit.final for refit in diagnosis.believed if refit.final != refit.believed}
    values: dict[str, float] = {}
    for parameter in dataset.parameters:
        if parameter.name in final:
            for path in parameter.paths:
                factor = parse_path(dataset.model, path).read(dataset.model) if parameter.relative else 1.0
                values[path] = final[parameter.name] * factor
    is_mjcf = dataset.model_file.suffix == ".xml" and dataset.model_file.is_file()
    source = dataset.model_file if is_mjcf else dataset.spec_xml
    try:
        calibration = [effect.found() for effect in diagnosis.calibration]
        return mend(source, [*calibration, *found], believed=values, effects=effects)
    except (InputError, ValueError) as error:
        return MendedModel(dataset.spec_xml, notes=(f"the model could not be mended: {error}",))


def _write_command(proposal: NextExperiment, model: mujoco.MjModel, folder: Path) -> dict[str, Any]:
    """Write the proposed command as a table with the columns of a recording; returns the entry of result.json."""
    columns = {name: proposal.values[:, k] for k, name in enumerate(control_columns(model))}
    write_table(folder / "next_command.csv", {"time": proposal.time} | columns)
    others = np.delete(np.asarray(proposal.others, float), proposal.chosen)
    return {
        "text": f"Send the command in next_command.csv: {proposal.reason}.",
        "file": "next_command.csv",
        "between": [_entry(name) if "@" in name else {"name": name} for name in proposal.between],
        "disagreement": proposal.disagreement,
        "others": {"median": float(np.median(others)) if len(others) else None, "count": len(others)},
    }


def _write_text(path: Path, text: str) -> None:
    with atomic_write(path) as file:
        file.write(text.encode("utf-8"))


def _write_tables(result: Mapping[str, Any], disagreement: DisagreementMap, folder: Path) -> None:
    rows = [
        {key: row[key] for key in ("effect", "location", "score", "margin", "gain", "held_out", "equivalent")}
        | {"parameters": ", ".join(f"{name} = {value:.6g}" for name, value in row["parameters"].items())}
        | {"beside": ", ".join(row["beside"])}
        for row in result["ranking"]
    ]
    if rows:
        write_table(folder / "ranking.csv", rows)
    if result["believed"]:
        write_table(folder / "believed.csv", result["believed"])
    if disagreement.places:
        table: dict[str, Any] = {"place": list(disagreement.places)}
        for j, regime in enumerate(disagreement.regimes):
            table[regime] = np.asarray(disagreement.value, float)[:, j]
            table[f"{regime}: count"] = np.asarray(disagreement.count)[:, j]
        write_table(folder / "disagreement.csv", table)


def _map_arrays(disagreement: DisagreementMap) -> dict[str, np.ndarray]:
    rows = [re.sub(r"^(\w+):", r"\1 ", name) for name in disagreement.places]
    return {
        "rows": np.array(rows, dtype=str),
        "columns": np.array(disagreement.regimes, dtype=str),
        "before": np.asarray(disagreement.value, float),
        "count": np.asarray(disagreement.count),
    }


def _force_arrays(forces: Sequence[JointForce]) -> dict[str, np.ndarray]:
    texts = {
        "joints": [one.joint for one in forces],
        "units": [one.unit for one in forces],
        "follows": [" ".join(one.follows) for one in forces],
    }
    arrays = {name: np.array(values, dtype=str) for name, values in texts.items()}
    for n, one in enumerate(forces):
        for key in ("position", "velocity", "load", "time", "before", "after", "law", "spread"):
            arrays[f"{key}_{n}"] = np.asarray(getattr(one, key), float)
    return arrays


def _overlay_arrays(diagnosis: Diagnosis, model: mujoco.MjModel) -> dict[str, np.ndarray]:
    slides = {
        f"joint:{name}"
        for name, kind in zip(part_names(model, "joint"), model.jnt_type, strict=True)
        if kind == mujoco.mjtJoint.mjJNT_SLIDE
    }
    shown = diagnosis.overlays
    arrays = {
        "recordings": np.array([one.recording for one in shown], dtype=str),
        "names": np.array([place_in_words(one.coordinate) for one in shown], dtype=str),
        "units": np.array(["m" if one.coordinate in slides else "rad" for one in shown], dtype=str),
    }
    for n, one in enumerate(shown):
        for key in ("time", "measured", "before", "after"):
            arrays[f"{key}_{n}"] = np.asarray(getattr(one, key), float)
    return arrays
