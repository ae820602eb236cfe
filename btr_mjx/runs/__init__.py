"""Run folders: everything a run needs to be read, repeated, killed and resumed.

A `RunFolder` holds config.json, environment.json and checkpoints under a lock. Files are written to a temporary name,
flushed and renamed, so that a file is either complete or absent. Long work reports through `progress` and stops through
`graceful_interrupt`.
"""

from btr_mjx.runs.atomic import atomic_write, write_text
from btr_mjx.runs.bounded_files import (
    MAX_TABLE_BYTES,
    MAX_TEXT_BYTES,
    check_regular,
    parse_json,
    read_limited,
    read_text,
)
from btr_mjx.runs.checkpoints import read_checkpoint
from btr_mjx.runs.checksums import check_listed, check_sums
from btr_mjx.runs.command_words import parsed
from btr_mjx.runs.config_json import CONFIG_NAME, config_to_json, differences, read_config, read_config_json
from btr_mjx.runs.digests import content_digest
from btr_mjx.runs.environment import COMPILER_OPTIONS, available_cores, describe_environment, package_version
from btr_mjx.runs.files import (
    read_arrays,
    read_json,
    read_table,
    to_plain,
    write_arrays,
    write_figure,
    write_json,
    write_table,
)
from btr_mjx.runs.out_place import check_file_place, writing_to
from btr_mjx.runs.progress_bar import StopRequest, graceful_interrupt, note, progress, say_progress
from btr_mjx.runs.python_files import installed_objects, load_object
from btr_mjx.runs.resume_check import check_inputs, claimed_folder, is_unused
from btr_mjx.runs.run_folder import IGNORED_FIELDS, RunFolder
from btr_mjx.runs.toml_lines import naming_lines
from btr_mjx.runs.toml_tables import check_keys, file_inside, file_name, is_number, read_toml, toml_rows, toml_section

__all__ = [
    "COMPILER_OPTIONS",
    "CONFIG_NAME",
    "IGNORED_FIELDS",
    "MAX_TABLE_BYTES",
    "MAX_TEXT_BYTES",
    "RunFolder",
    "StopRequest",
    "atomic_write",
    "available_cores",
    "check_file_place",
    "check_inputs",
    "check_keys",
    "check_listed",
    "check_regular",
    "check_sums",
    "claimed_folder",
    "config_to_json",
    "content_digest",
    "describe_environment",
    "differences",
    "file_inside",
    "file_name",
    "graceful_interrupt",
    "installed_objects",
    "is_number",
    "is_unused",
    "load_object",
    "naming_lines",
    "note",
    "package_version",
    "parse_json",
    "parsed",
    "progress",
    "read_arrays",
    "read_checkpoint",
    "read_config",
    "read_config_json",
    "read_json",
    "read_limited",
    "read_table",
    "read_text",
    "read_toml",
    "say_progress",
    "to_plain",
    "toml_rows",
    "toml_section",
    "write_arrays",
    "write_figure",
    "write_json",
    "write_table",
    "write_text",
    "writing_to",
]
