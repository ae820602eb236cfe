"""Files that other programs read: identified parameters, ranges for domain randomisation, recordings for viewers.

`ExportedParameter` is one number with its interval, `field_ends` finds the numbers of a compiled model that it moves
(`robot_ends` for a parameter of a robot), `write_exports` writes parameters.csv, parameters.json and
randomisation.json. `write_rerun` and `write_mcap` write curves and poses of bodies. docs/exports.md describes these
files.
"""

from btr_mjx.exports.export_files import ExportedParameter, write_exports
from btr_mjx.exports.mcap_file import write_mcap
from btr_mjx.exports.moved_numbers import Ends, field_ends, is_linear, robot_ends
from btr_mjx.exports.recorded import RecordedCurves, RecordedPoses, recorded_poses
from btr_mjx.exports.rerun_file import write_rerun

__all__ = [
    "Ends",
    "ExportedParameter",
    "RecordedCurves",
    "RecordedPoses",
    "field_ends",
    "is_linear",
    "recorded_poses",
    "robot_ends",
    "write_exports",
    "write_mcap",
    "write_rerun",
]
