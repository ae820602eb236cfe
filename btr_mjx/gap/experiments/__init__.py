"""The next experiment: the command on which the surviving hypotheses disagree most.

`propose` returns a `results.NextExperiment` for a diagnosis. `recordings_needed` measures in simulation how many
recordings separate two hypotheses.
"""

from btr_mjx.gap.experiments.next_experiment import DECISIVE_MARGIN, Measurement, propose, recordings_needed
from btr_mjx.gap.experiments.trial_commands import random_commands

__all__ = [
    "DECISIVE_MARGIN",
    "Measurement",
    "propose",
    "random_commands",
    "recordings_needed",
]
