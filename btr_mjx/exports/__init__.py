"""Files that other programs read: identified parameters as tables, and ranges for domain randomisation.

`ExportedParameter` is one number with its interval, `field_ends` finds the numbers of a compiled model that it moves
(`robot_ends` for a parameter of a robot), `write_exports` writes parameters.csv, parameters.json and
randomisation.json. docs/exports.md describes these files.
"""

from btr_mjx.exports.export_files import ExportedParameter, write_exports
from btr_mjx.exports.moved_numbers import Ends, field_ends, is_linear, robot_ends

__all__ = ["Ends", "ExportedParameter", "field_ends", "is_linear", "robot_ends", "write_exports"]
