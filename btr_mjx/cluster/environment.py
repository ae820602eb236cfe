"""What the last bits of a result depend on: versions, code and processor. All processes of a scan must agree on it."""

import hashlib
import platform
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from btr_mjx.errors import InputError
from btr_mjx.runs import describe_environment

_VECTOR_BITS = (("avx512f", 512), ("avx", 256), ("sse2", 128), ("asimd", 128))
"""Flag in /proc/cpuinfo and the width of the vectors that it stands for."""


class DifferentWorker(InputError):
    """A worker whose results could differ from those of the client in the last bits."""


def numerical_environment(jax_backend: bool) -> Mapping[str, str]:
    """What results depend on in this process.

    Args:
      jax_backend: also the device and precision of JAX, which starts its backend.
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
    """Compare this process with the client.

    Args:
      client: `numerical_environment` of the client.
      where: name of this process for the message.

    Raises:
      DifferentWorker: something differs; all differences are named.
    """
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
    versions = describe_environment([])["versions"]
    found = {name: str(versions[name]) for name in ("btr-mjx", "mujoco", "jax", "jaxlib", "numpy")}
    found["btr-mjx"] += f" (code {_code_digest()})"
    found["python"] = "{}.{}".format(*sys.version_info)
    found["processor"] = f"{platform.machine()} with {processor_vectors(_cpuinfo())}"
    return found


def processor_vectors(cpuinfo: str) -> str:
    """Width of a processor's vectors, from the text of /proc/cpuinfo."""
    flags = next((set(line.split()) for line in cpuinfo.splitlines() if line.startswith(("flags", "Features"))), set())
    return next((f"{bits}-bit vectors" for flag, bits in _VECTOR_BITS if flag in flags), "vectors of unknown width")


def _cpuinfo() -> str:
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _code_digest() -> str:
    """Digest of this package's modules: checkouts of different commits may have the same version."""
    package, total = Path(__file__).parent.parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        total.update(path.relative_to(package).as_posix().encode() + b"\n" + path.read_bytes())
    return total.hexdigest()[:10]
