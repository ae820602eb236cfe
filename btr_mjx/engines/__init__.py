"""How a chunk of pairs is stepped: `lanes` (the fast one), `mjx` (general, any device), `native` (the oracle).

`Stepper` is what an engine inside JAX implements, `Program` the compiled rollout around it; `native.rollout_native`
runs MuJoCo's C code on threads. All agree with native MuJoCo to the tolerance of their precision.
"""

from btr_mjx.engines import native
from btr_mjx.engines.base import Stepper, UnsupportedModel
from btr_mjx.engines.devices import use_all_cores, use_compilation_cache
from btr_mjx.engines.lanes.parameters import base_field, matters
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
    "matters",
    "native",
    "rollout",
    "use_all_cores",
    "use_compilation_cache",
]
