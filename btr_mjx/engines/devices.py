"""Which devices a batch runs on, and where compiled programs are kept."""

import logging
import os
from pathlib import Path

import jax
import jaxlib

from btr_mjx.runs import available_cores

_COMPILER_FLAG = "--xla_backend_extra_options="
_COMPILER_OPTIONS = "xla_slp_vectorizer_disabled,xla_cpu_disable_loop_unrolling"
"""A step of `lanes` is one function of hundreds of short loops that are vectors already: unrolling them and looking for
more vectors doubles the machine code and the time to compile it, and runs slower for want of instruction cache."""


def use_all_cores() -> None:
    """Set XLA's CPU backend up for batches of worlds, if it has not started yet: one device per core, compact code.

    One XLA device runs a chunk on about one core, so a batch is sharded over as many devices as there are cores. JAX
    fixes their number and its compiler's options when it first touches a device; afterwards this does nothing. What the
    user has chosen is left alone: a number of devices set by `jax.config` or by
    `--xla_force_host_platform_device_count` in XLA_FLAGS, and `--xla_backend_extra_options` there.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    number = jax.config.jax_num_cpu_devices
    try:
        # JAX has no way to ask whether it has started, but once it has it refuses to change this number.
        jax.config.update("jax_num_cpu_devices", 2 if number == 1 else 1)
    except RuntimeError:
        logging.getLogger(__name__).debug("JAX is already running on %d devices", jax.device_count())
        return
    counted = number != -1 or "xla_force_host_platform_device_count" in flags
    jax.config.update("jax_num_cpu_devices", number if counted else available_cores())
    if _COMPILER_FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_COMPILER_FLAG}{_COMPILER_OPTIONS}".strip()


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
