"""What has changed between sets of recordings of one robot: each set is searched around what the one before it said.

    found = identify_changes([open_dataset("spring"), open_dataset("autumn")])
    found.diagnoses[-1].effects  # the change from spring to autumn

What is wrong with the model in both sets, and what calibration leaves open in both, cancels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

from threadpoolctl import threadpool_limits

from btr_mjx.errors import InputError
from btr_mjx.gap.data import Dataset
from btr_mjx.gap.effects import EFFECTS, Effect, Parameter
from btr_mjx.gap.forces.identify import prepare_forces, search_forces
from btr_mjx.gap.forces.points import QUANTILE
from btr_mjx.gap.forces.sets.carried import Carried, carried_of
from btr_mjx.gap.results import Diagnosis, Estimate, Quantity
from btr_mjx.gap.simulate import Counter
from btr_mjx.models import part_names

_KINDS = ("joint", "actuator", "body")
"""Parts that two models of one robot share."""


@dataclass(frozen=True, eq=False)
class Changes:
    """What sets of recordings say, each beside the one before it.

    Attributes:
      diagnoses: of each set: of the first what the believed model lacks, of the others what has changed since.
      quantities: numbers that were named in any set, and their values in all of them.
    """

    diagnoses: tuple[Diagnosis, ...]
    quantities: tuple[Quantity, ...]


def check_same_robot(before: Dataset, after: Dataset) -> None:
    """Check that two datasets are of one robot.

    Raises:
      InputError: their models have other joints, actuators or bodies, or they declare other parameters to refit.
    """
    for kind in _KINDS:
        theirs, own = (part_names(dataset.model, kind) for dataset in (before, after))
        if list(theirs) != list(own):
            apart = [name for name in (*theirs, *own) if (name in theirs) != (name in own)]
            what = f"{', '.join(apart[:4])} is in one of them only" if apart else "their order differs"
            raise InputError(
                f"{before.model_file} and {after.model_file}: not the same robot, {kind} {what}; compare recordings of "
                f"one robot, with the same joints, actuators and bodies in both models"
            )
    theirs, own = (sorted(p.name for p in dataset.parameters) for dataset in (before, after))
    if theirs != own:
        raise InputError(
            f"{before.folder} and {after.folder}: [[parameter]] of their dataset.toml differ "
            f"({', '.join(theirs) or 'none'} and {', '.join(own) or 'none'}); declare the same ones in both"
        )


def identify_changes(
    sets: Sequence[Dataset],
    effects: Sequence[Effect] = EFFECTS,
    max_effects: int = 5,
    progress: Callable[[str], None] | None = None,
    counter: Counter | None = None,
) -> Changes:
    """Find what has changed from each set of recordings to the next.

    Args:
      sets: recordings of one robot, the oldest first; motions, rates and numbers of recordings may differ.
      effects: the library of effects.
      max_effects: largest number of effects that are named at a time.
      progress: called with a word on what is being done.
      counter: adds up the simulated steps.

    Returns:
      A diagnosis for each set, and how numbers went.

    Raises:
      InputError: fewer than two sets, another robot, or one that touches the world.
    """
    if len(sets) < 2:
        raise InputError(f"sets: got {len(sets)}, expected recordings from before a change and from after it")
    for before, after in pairwise(sets):
        check_same_robot(before, after)
    note, counter = progress or (lambda _: None), counter or Counter()
    known: Carried | None = None
    diagnoses: list[Diagnosis] = []
    carried: list[Carried] = []
    with threadpool_limits(1, "blas"):
        ready = [prepare_forces(dataset) for dataset in sets]
        for dataset, prepared in zip(sets, ready, strict=True):
            if prepared is None:
                raise InputError(
                    f"{dataset.folder}: changes are found for robots that touch nothing, without closed loops and with "
                    "every joint measured; diagnose both sets without --before and compare their mended models"
                )
            which = f"{len(diagnoses) + 1} of {len(sets)}: "
            diagnosis, found = search_forces(
                prepared, effects, max_effects, partial(_noted, note, which), counter, known
            )
            diagnoses.append(_with_note(diagnosis, dataset, sets[len(diagnoses) - 1] if diagnoses else dataset))
            known = carried_of(found)
            carried.append(known)
    return Changes(tuple(diagnoses), _quantities(diagnoses, carried))


def _noted(note: Callable[[str], None], which: str, word: str) -> None:
    note(f"{which}{word}")


def _with_note(diagnosis: Diagnosis, dataset: Dataset, before: Dataset) -> Diagnosis:
    """A diagnosis with a note where the believed models differ: what differs is no change that is found."""
    if dataset.spec_xml == before.spec_xml:
        return diagnosis
    said = (
        f"{before.model_file} and {dataset.model_file} differ: each set is explained with its own model, and what "
        "differs between the two models is not part of the change."
    )
    return replace(diagnosis, notes=(*diagnosis.notes, said))


def _quantities(diagnoses: Sequence[Diagnosis], carried: Sequence[Carried]) -> tuple[Quantity, ...]:
    """Numbers that were named in any set, at single places, over all of them."""
    out = []
    for candidate in {c.name: c for own in carried for c, _ in own.effects}.values():
        for i, parameter in enumerate(candidate.parameters):
            named = tuple(_is_named(one, candidate.effect.name, candidate.place.label) for one in diagnoses)
            if parameter.shape or not any(named):
                continue
            # A load is beside the mass of its body, at another place of it.
            last = [v[i] - parameter.null for c, v in carried[-1].effects if c.name == candidate.name]
            values = [parameter.null + sum(last)]
            # What later sets say of the calibration holds for earlier ones, too: only changes lie between them.
            for one in diagnoses[:0:-1]:
                values.insert(0, values[0] - _change(one, candidate.effect.name, candidate.place.label, parameter))
            halves = [QUANTILE * own.spread((candidate.name, i)) for own in carried]
            out.append(
                Quantity(
                    candidate.effect.name,
                    candidate.place.label,
                    parameter.name,
                    parameter.unit,
                    tuple(float(v) for v in values),
                    tuple(v - h for v, h in zip(values, halves, strict=True)),
                    tuple(v + h for v, h in zip(values, halves, strict=True)),
                    named,
                )
            )
    return tuple(out)


def _numbers_of(diagnosis: Diagnosis, effect: str, label: str) -> list[dict[str, Estimate]]:
    """Numbers of an effect that was named at a place, alone or as a member of a group with numbers of their own."""
    end = f"[{label.partition(':')[2]}]"
    out = []
    for own in (own for own in diagnosis.effects if own.effect == effect):
        if own.location == label:
            out.append(dict(own.parameters))
        elif found := {k.removesuffix(end): v for k, v in own.parameters.items() if k.endswith(end)}:
            out.append(found)
    return out


def _is_named(diagnosis: Diagnosis, effect: str, label: str) -> bool:
    """Whether an effect was named at a place."""
    return bool(_numbers_of(diagnosis, effect, label))


def _change(diagnosis: Diagnosis, effect: str, label: str, parameter: Parameter) -> float:
    """Named change of a number at a place; 0 where there is none."""
    found = [own[parameter.name].value for own in _numbers_of(diagnosis, effect, label) if parameter.name in own]
    return sum(value - parameter.null for value in found)
