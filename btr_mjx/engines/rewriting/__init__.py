"""`retrace`: a JAX transformation that rewrites a traced program so that XLA computes each expensive value once."""

from btr_mjx.engines.rewriting.retrace import retrace

__all__ = ["retrace"]
