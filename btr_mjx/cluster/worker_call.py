"""What runs on a worker: one call of a function, where results are those of the client to the bit.

Importing this module must stay cheap.
"""

import hashlib
import pickle
import platform
from collections.abc import Mapping
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError

_VECTOR_BITS = (("avx512f", 512), ("avx", 256), ("sse2", 128), ("asimd", 128))
"""Flag in /proc/cpuinfo and the width of the vectors that it stands for."""


class DifferentWorker(InputError):
    """A worker whose results could differ from those of the client in the last bits."""


def call_on_worker(environment: Mapping[str, str], function: bytes, arguments: bytes) -> Any:
    """Call a pickled function with a pickled tuple of arguments, in the `numerical_environment` of the client.

    Raises:
      DifferentWorker: the worker's results could differ from the client's.
      InputError: the worker runs several tasks at a time.
    """
    from distributed import get_worker

    worker = get_worker()
    if worker.state.nthreads != 1:
        raise InputError(
            f"worker {worker.address} runs {worker.state.nthreads} tasks at a time, expected 1: a task uses all cores "
            "of its host; start workers with --nthreads 1"
        )
    check_environment(environment, worker.address)
    return _function(function)(*pickle.loads(arguments))


@lru_cache(maxsize=4)
def _function(pickled: bytes) -> Any:
    """The same object in every call: programs are compiled once for a robot, and robots are compared by their parts."""
    return pickle.loads(pickled)


def numerical_environment(jax_backend: bool) -> Mapping[str, str]:
    """What the last bits of a result depend on in this process: versions, code, processor.

    With `jax_backend` also the device and precision of JAX, whose backend starts.
    """
    found = dict(_fixed())
    if jax_backend:
        import jax

        from btr_mjx.engines import use_all_cores

        use_all_cores()
        kind = jax.default_backend()
        device = "cpu" if kind == "cpu" else f"{kind} {jax.devices()[0].device_kind}"
        found["JAX"] = f"{device}, jax_enable_x64 {bool(jax.config.read('jax_enable_x64'))}"
    return found


def check_environment(client: Mapping[str, str], where: str) -> None:
    """DifferentWorker, which names all differences, where this process is not like the client."""
    own = numerical_environment("JAX" in client)
    differ = [f"{name} {own.get(name)} there, {value} here" for name, value in client.items() if own.get(name) != value]
    if differ:
        raise DifferentWorker(
            f"worker {where}: results could differ in the last bits: {'; '.join(differ)}; start it in the same "
            "environment and on the same kind of processor as the client"
        )


@cache
def _fixed() -> Mapping[str, str]:
    """What does not change while a process runs."""
    found = {name: metadata.version(name) for name in ("btr-mjx", "mujoco", "jax", "jaxlib", "numpy")}
    found["btr-mjx"] += f" (code {_code_digest()})"
    found["python"] = ".".join(platform.python_version_tuple()[:2])
    try:
        processor = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        processor = ""
    found["processor"] = f"{platform.machine()} with {processor_vectors(processor)}"
    return found


def processor_vectors(cpuinfo: str) -> str:
    """Width of a processor's vectors, from the text of /proc/cpuinfo."""
    flags = next((set(line.split()) for line in cpuinfo.splitlines() if line.startswith(("flags", "Features"))), set())
    return next((f"{bits}-bit vectors" for flag, bits in _VECTOR_BITS if flag in flags), "vectors of unknown width")


def _code_digest() -> str:
    """Digest of this package's modules: checkouts of different commits may have the same version."""
    package, total = Path(__file__).parent.parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        total.update(path.relative_to(package).as_posix().encode() + b"\n" + path.read_bytes())
    return total.hexdigest()[:10]
