"""Measured data: datasets, recordings, file formats, sensor noise.

`open_dataset` detects the format of a folder, `open_logs` reads a model and logs. Both return a `Dataset`: the believed
(nominal) model, its `Recording`s, the parameters that may be refitted (`models.PathParameter`) and the standard
deviation of the sensor noise. `save_dataset` writes one. A `Reader` adds a format of files, which gives `LogTable`s.

Throughout, `where` says in messages which file or table is meant, and what is found and chosen is appended to `notes`.
"""

from btr_mjx.gap.data.columns.model_columns import (
    control_columns,
    driven_joint,
    sensor_body,
    sensor_columns,
    state_columns,
)
from btr_mjx.gap.data.columns.remedy import Answer, quoted
from btr_mjx.gap.data.columns.units import unit_text
from btr_mjx.gap.data.control import INTERPOLATIONS, Interpolation
from btr_mjx.gap.data.dataset import DATASET_FILE, Dataset, known_of, noise_of, read_header
from btr_mjx.gap.data.files.readers import Reader, read_columns
from btr_mjx.gap.data.files.table import LogTable, log_table
from btr_mjx.gap.data.lists import counted, listed
from btr_mjx.gap.data.loading import load, with_bases, with_imu
from btr_mjx.gap.data.opening import open_dataset, open_logs
from btr_mjx.gap.data.recordings.held import Held, bends, held, stairs
from btr_mjx.gap.data.recordings.noise import Noise, estimate_noise, quantisation_noise, reduced_noise
from btr_mjx.gap.data.recordings.recording import Recording, Split, StateEstimate, base_unmeasured, make_recording
from btr_mjx.gap.data.recordings.wraps import Wrap, find_wraps
from btr_mjx.gap.data.writing import DatasetDescription, Format, save_dataset

__all__ = [
    "DATASET_FILE",
    "INTERPOLATIONS",
    "Answer",
    "Dataset",
    "DatasetDescription",
    "Format",
    "Held",
    "Interpolation",
    "LogTable",
    "Noise",
    "Reader",
    "Recording",
    "Split",
    "StateEstimate",
    "Wrap",
    "base_unmeasured",
    "bends",
    "control_columns",
    "counted",
    "driven_joint",
    "estimate_noise",
    "find_wraps",
    "held",
    "known_of",
    "listed",
    "load",
    "log_table",
    "make_recording",
    "noise_of",
    "open_dataset",
    "open_logs",
    "quantisation_noise",
    "quoted",
    "read_columns",
    "read_header",
    "reduced_noise",
    "save_dataset",
    "sensor_body",
    "sensor_columns",
    "stairs",
    "state_columns",
    "unit_text",
    "with_bases",
    "with_imu",
]
