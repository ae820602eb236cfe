"""Before any fit: is this a dataset that an effect could be named from?

`preflight` returns `Finding`s about clocks, excitation, noise and the believed model; `refuse_errors` raises where
one of them is an error.
"""

from btr_mjx.gap.preflight.checks import preflight, refuse_errors
from btr_mjx.gap.preflight.findings import Finding

__all__ = [
    "Finding",
    "preflight",
    "refuse_errors",
]
