"""Which devices a batch runs on, and where compiled programs are kept."""

import logging
import os
from pathlib import Path

import jax
import jaxlib


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


def use_compilation_cache() -> None:
    """Keep compiled programs on disk, unless the user has chosen a folder or switched the cache off.

    The folder is $XDG_CACHE_HOME/btr_mjx/jax-<versions> (~/.cache by default): another jaxlib never reads what this one
    wrote. A cache that cannot be used costs a compilation and nothing else.
    """
    if jax.config.jax_compilation_cache_dir is not None or not jax.config.jax_enable_compilation_cache:
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = home / "btr_mjx" / f"jax-{jax.__version__}-jaxlib-{jaxlib.__version__}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        logging.getLogger(__name__).debug("no compilation cache in %s: %s", folder, error)
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
