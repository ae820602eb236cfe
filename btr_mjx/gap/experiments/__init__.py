"""The next experiment: the command on which the surviving hypotheses disagree most.

`propose` returns a `results.NextExperiment` for a diagnosis.
"""

from btr_mjx.gap.experiments.next_experiment import DECISIVE_MARGIN, propose
from btr_mjx.gap.experiments.trial_commands import random_commands

__all__ = [
    "DECISIVE_MARGIN",
    "propose",
    "random_commands",
]
