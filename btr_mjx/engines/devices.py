"""Configuration of JAX: devices of the CPU backend, compiler options, cache of compiled programs."""

import logging
import os
from pathlib import Path

import jax
import jaxlib

from btr_mjx.runs import COMPILER_OPTIONS, available_cores


def use_all_cores() -> None:
    """Configure XLA's CPU backend for batches of worlds, if it has not started yet: one device per core.

    One XLA device runs a chunk on about one core, so a batch is sharded over as many devices as there are cores. JAX
    fixes the number of devices and the compiler options when its backend starts; afterwards this function does nothing.
    Settings of the user take precedence: a number of devices set by `jax.config` or by
    `--xla_force_host_platform_device_count` in XLA_FLAGS, and `--xla_backend_extra_options` in XLA_FLAGS.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    number = jax.config.jax_num_cpu_devices
    try:
        # JAX has no public test of whether its backend has started, but once started it rejects this change.
        jax.config.update("jax_num_cpu_devices", 2 if number == 1 else 1)
    except RuntimeError:
        logging.getLogger(__name__).debug("JAX is already running on %d devices", jax.device_count())
        return
    counted = number != -1 or "xla_force_host_platform_device_count" in flags
    jax.config.update("jax_num_cpu_devices", number if counted else available_cores())
    if COMPILER_OPTIONS.split("=")[0] not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {COMPILER_OPTIONS}".strip()


def default_chunk(device: jax.Device) -> int:
    """Worlds that are stepped together on such a device; docs/performance.md has the measurements."""
    return 64 if device.platform == "cpu" else 16_384


def use_compilation_cache() -> None:
    """Cache compiled programs on disk, unless the user has chosen a folder or switched the cache off.

    The folder is $XDG_CACHE_HOME/btr_mjx/jax-<versions> (~/.cache by default), one for each version of jaxlib. Without
    a usable cache, programs are compiled again in each process.
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


def uses_doubles() -> bool:
    """Whether JAX computes in double precision by default."""
    return bool(jax.config.read("jax_enable_x64"))
