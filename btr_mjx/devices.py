"""Which devices a batch runs on."""

import logging
import os

import jax


def use_all_cores() -> None:
    """Give JAX one CPU device per core, if it has not started yet and nobody has chosen a number.

    One XLA device runs a chunk on about one core, so a batch is sharded over as many devices as there are cores. JAX
    fixes the number when it first touches a device; afterwards this does nothing. A number set by the user, by
    `jax.config` or by `--xla_force_host_platform_device_count` in XLA_FLAGS, is left alone.
    """
    if "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    try:
        if jax.config.jax_num_cpu_devices == -1:
            jax.config.update("jax_num_cpu_devices", available_cores())
    except RuntimeError:  # JAX has started: its devices stay as they are
        logging.getLogger(__name__).debug("JAX is already running on %d devices", jax.device_count())


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
