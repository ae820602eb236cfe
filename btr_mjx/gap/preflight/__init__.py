"""Checks of a dataset before any fit: units, timing, excitation, noise, stability of the believed model.

`checked` returns the dataset as it is to be searched and `Finding`s, which `save_findings` writes; `refuse_errors`
raises if one of them is an error.
"""

from btr_mjx.gap.preflight.checks import checked, preflight, refuse_errors
from btr_mjx.gap.preflight.findings import Finding, save_findings

__all__ = [
    "Finding",
    "checked",
    "preflight",
    "refuse_errors",
    "save_findings",
]
