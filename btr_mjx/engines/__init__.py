"""Physics engines that step chunks of pairs: `lanes` (fast), `mjx` (general, any device), `native` (the reference).

`Stepper` is the interface of engines inside JAX, `Program` the compiled rollout around it; `native.rollout_native` runs
MuJoCo's C code on threads. All agree with native MuJoCo to the tolerance of their precision.
"""

from btr_mjx.engines import native
from btr_mjx.engines.base import Stepper, UnsupportedModel
from btr_mjx.engines.devices import use_all_cores, use_compilation_cache
from btr_mjx.engines.lanes.fields import base_field, influences_motion
from btr_mjx.engines.lanes.stepper import LanesStepper
from btr_mjx.engines.mjx import MjxStepper
from btr_mjx.engines.native import expand
from btr_mjx.engines.program import Layout, Program, Record, rollout

__all__ = [
    "LanesStepper",
    "Layout",
    "MjxStepper",
    "Program",
    "Record",
    "Stepper",
    "UnsupportedModel",
    "base_field",
    "expand",
    "influences_motion",
    "native",
    "rollout",
    "use_all_cores",
    "use_compilation_cache",
]
