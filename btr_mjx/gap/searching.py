"""The search of a diagnosis in its run folder: by which way it goes, its progress, and the files that it leaves."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from btr_mjx.gap.data import Dataset
    from btr_mjx.gap.effects import Effect
    from btr_mjx.gap.fitness_only import FitnessTable

JOURNAL = "search"
"""Folder of simulation results in a run folder, from which a search is resumed."""


def search_missing(
    dataset: "Dataset | FitnessTable",
    library: "Sequence[Effect]",
    folder: Path,
    *,
    earlier: "Sequence[Dataset]" = (),
    seed: int = 0,
    max_effects: int = 5,
    residual: bool = False,
    code: bytes = b"",
    show: bool = False,
    checkpoint: Callable[[], None] = lambda: None,
) -> None:
    """Search for missing effects, or for what has changed, and write all files from which the report is drawn.

    Args:
      dataset: the recordings, or the table of measured fitness.
      library: effects that may be named.
      folder: the run folder.
      earlier: recordings of the same robot before these, the oldest first.
      seed: of everything random.
      max_effects: effects that are named, at most.
      residual: fit a table of the force that nothing explains.
      code: of user-defined effects, see `custom_effect_code`.
      show: show a progress bar.
      checkpoint: called often; raises Interrupted to stop the search.
    """
    from btr_mjx.gap.effects import of_forces
    from btr_mjx.gap.experiments import propose
    from btr_mjx.gap.fitness_only import FitnessTable, expected_steps, identify_fitness
    from btr_mjx.gap.forces import identify_changes
    from btr_mjx.gap.inference import identify
    from btr_mjx.gap.results import before_entry, save_diagnosis, save_quantities
    from btr_mjx.gap.simulate import followed_search

    total = round(expected_steps(dataset, library)) if isinstance(dataset, FitnessTable) else None
    with followed_search(folder / JOURNAL, checkpoint, total=total, code=code, show=show) as (journal, report_stage):
        more: dict[str, Any] = {"seed": seed, "signal": "trajectory"}
        if isinstance(dataset, FitnessTable):
            diagnosis, data = identify_fitness(dataset, library, report_stage, counter=journal), dataset.head
            more, proposal = {"seed": seed, "signal": "fitness"}, None
        else:
            data = dataset
            if earlier:
                sets = [*earlier, dataset]
                found = identify_changes(sets, library, max_effects, report_stage, journal)
                diagnosis, said = found.diagnoses[-1], list[dict[str, Any]]()
                for one, own in zip(found.diagnoses[:-1], earlier, strict=True):
                    said.append(before_entry(one, own, said[-1] if said else None))
                more |= {"before": said[-1], "sets": said}
                save_quantities(folder, found.quantities, [own.folder.name for own in sets])
            else:
                diagnosis = identify(
                    dataset, library, max_effects, seed, report_stage, counter=journal, residual=residual
                )
            report_stage("next experiment")
            proposal = propose(diagnosis, dataset, seed, counter=journal)
    save_diagnosis(diagnosis, data, folder, effects=sum(of_forces(library), ()), next_experiment=proposal, more=more)
    journal.close()
