"""Checks of an installation: versions, the folder of runs, devices, engines and their speed.

`CHECKS` has one function a check, `run_checks` runs them. Those that load JAX and MuJoCo run in a process of their own,
so that a broken library is reported like any other fault.
"""

from btr_mjx.health.installation_checks import CHECKS, CheckResult, run_checks

__all__ = ["CHECKS", "CheckResult", "run_checks"]
