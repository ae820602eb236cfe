"""Checks of an installation: versions, machine, folders, engines, speed, cache of compiled programs and pictures.

`CHECKS` has one function a check, `run_checks` runs them. What needs JAX, MuJoCo or OpenGL is measured in processes of
their own, so that a broken library is reported like any other fault; nothing of this room imports them.
"""

from btr_mjx.health.checks import CHECKS, HealthSettings, run_checks
from btr_mjx.health.result import CheckResult

__all__ = ["CHECKS", "CheckResult", "HealthSettings", "run_checks"]
