"""What a robot that touches nothing lacks, from forces: a likelihood of whole recordings, and a search on it.

`prepare_forces` tells whether a dataset is of this kind, `identify_forces` makes a `Diagnosis` of it,
`identify_changes` tells what has changed from one set of recordings to the next. Motion from one
sample to the next is linearised around measured states (`motion`), a Kalman filter with random forces is the likelihood
(`kalman_filter`), and every effect of the library is a column of a least-squares problem (`unknowns`, `scan`,
`points`). What is named is confirmed by recordings that were not fitted (`confirmation`).
"""

from btr_mjx.gap.forces.identify import PreparedForces, identify_forces, prepare_forces, search_forces
from btr_mjx.gap.forces.predictions import (
    horizon_errors,
    joint_errors,
    noise_errors,
    predicts_better,
    predicts_worse,
    step_errors,
)
from btr_mjx.gap.forces.sets.carried import Carried, carried_of
from btr_mjx.gap.forces.sets.changes import Changes, check_same_robot, identify_changes

__all__ = [
    "Carried",
    "Changes",
    "PreparedForces",
    "carried_of",
    "check_same_robot",
    "horizon_errors",
    "identify_changes",
    "identify_forces",
    "joint_errors",
    "noise_errors",
    "predicts_better",
    "predicts_worse",
    "prepare_forces",
    "search_forces",
    "step_errors",
]
