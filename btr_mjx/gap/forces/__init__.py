"""What a robot that touches nothing lacks, from forces: a likelihood of whole recordings, and a search on it.

`prepare_forces` tells whether a dataset is of this kind, `identify_forces` makes a `Diagnosis` of it. Motion from one
sample to the next is linearised around measured states (`motion`), a Kalman filter with random forces is the likelihood
(`filtering`), and every effect of the library is a column of a least-squares problem (`unknowns`, `scan`, `points`).
"""

from btr_mjx.gap.forces.identify import PreparedForces, identify_forces, prepare_forces
from btr_mjx.gap.forces.predictions import horizon_errors, predictions

__all__ = [
    "PreparedForces",
    "horizon_errors",
    "identify_forces",
    "predictions",
    "prepare_forces",
]
