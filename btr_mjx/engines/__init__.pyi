from . import native
from .base import Stepper, UnsupportedModel
from .computed import base_field, influences_motion
from .controlled import ControlledProgram
from .devices import default_chunk, use_all_cores, use_compilation_cache, uses_doubles
from .lanes_engine.stepper import LanesStepper
from .lanes_engine.support import possible_contacts, refusals, require_supported
from .lanes_engine.worlds import require_same_structure
from .mjx import MjxStepper
from .native import expand
from .program import Layout, Program, rollout_chunk
from .record import Record

__all__ = [
    "ControlledProgram",
    "LanesStepper",
    "Layout",
    "MjxStepper",
    "Program",
    "Record",
    "Stepper",
    "UnsupportedModel",
    "base_field",
    "default_chunk",
    "expand",
    "influences_motion",
    "native",
    "possible_contacts",
    "refusals",
    "require_same_structure",
    "require_supported",
    "rollout_chunk",
    "use_all_cores",
    "use_compilation_cache",
    "uses_doubles",
]
