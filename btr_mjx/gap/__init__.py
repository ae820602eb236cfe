"""The missing-effect workflow: where simulation and data disagree, which effect is missing, the mended model."""
