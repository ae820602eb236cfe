"""Measured data: datasets, recordings, one file per format, noise.

`open_dataset` recognises a folder's form and returns a `Dataset`: the believed model, its `Recording`s, what may be
refitted (`Believed`) and the noise of the sensors. `save_dataset` writes one.
"""

from btr_mjx.gap.data.believed import Believed
from btr_mjx.gap.data.columns import control_columns
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, Interpolation, load, noise_of, read_head
from btr_mjx.gap.data.noise import Noise, estimate_noise, quieter
from btr_mjx.gap.data.recording import Recording
from btr_mjx.gap.data.sources import open_dataset
from btr_mjx.gap.data.toml_tables import check_keys, file_name, is_number, toml_section
from btr_mjx.gap.data.writing import DatasetDescription, Format, save_dataset

__all__ = [
    "DATASET_FILE",
    "Believed",
    "Dataset",
    "DatasetDescription",
    "Format",
    "Interpolation",
    "Noise",
    "Recording",
    "check_keys",
    "control_columns",
    "estimate_noise",
    "file_name",
    "is_number",
    "load",
    "noise_of",
    "open_dataset",
    "quieter",
    "read_head",
    "save_dataset",
    "toml_section",
]
