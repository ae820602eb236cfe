from . import native
from .base import Stepper, UnsupportedModel
from .devices import use_all_cores, use_compilation_cache
from .lanes.fields import base_field, influences_motion
from .lanes.stepper import LanesStepper
from .mjx import MjxStepper
from .native import expand
from .program import Layout, Program, rollout_chunk
from .record import Record

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
    "rollout_chunk",
    "use_all_cores",
    "use_compilation_cache",
]
