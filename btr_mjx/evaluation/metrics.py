"""Metrics, public as `btr_mjx.metrics`: distances of sensor series, shape of distance curves, bootstrap intervals."""

from btr_mjx.evaluation.bootstrap import Interval, bootstrap_interval
from btr_mjx.evaluation.curve_shape import monotonicity, roughness, side_spearman, spearman
from btr_mjx.evaluation.series_distances import (
    DEFAULT_WINDOW,
    Floats,
    euclidean_metric,
    rolling_mean_metric,
    sensor_scale,
)

__all__ = [
    "DEFAULT_WINDOW",
    "Floats",
    "Interval",
    "bootstrap_interval",
    "euclidean_metric",
    "monotonicity",
    "rolling_mean_metric",
    "roughness",
    "sensor_scale",
    "side_spearman",
    "spearman",
]
