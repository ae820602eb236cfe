"""Diagnosis of the gap between a model and recordings of a robot: which physical effect the model lacks.

One folder a stage: `data` (recordings), `preflight` (checks), `effects` (library), `simulate` (batches of worlds),
`forces` (search and decision where a robot touches nothing), `windows` and `inference` (the same for all others, by
multiple shooting), `results`, `report`, `fitness_only`, `experiments`.
`examine` reads and checks recordings, `search_missing` goes through the stages and writes all files of a run.
"""

from btr_mjx.gap.examining import examine, examine_earlier
from btr_mjx.gap.searching import search_missing

__all__ = ["examine", "examine_earlier", "search_missing"]
