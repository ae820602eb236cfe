"""The cluster that --cluster names: workers on this machine, or the scheduler at an address or in a scheduler file."""

import importlib.util
import json
import logging
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from btr_mjx.errors import InputError
from btr_mjx.runs import note

CONNECT_TIMEOUT = 30.0
"""Time within which a scheduler must answer [s]."""

_FORMS = "local:N, tcp://HOST:PORT or file:SCHEDULER.json"


def check_cluster(cluster: str) -> tuple[str, str]:
    """Read the text of --cluster and check that Dask is installed.

    Args:
      cluster: "local:N" for N workers on this machine, which share its cores; "tcp://HOST:PORT" (or tls://) of a
        running scheduler; "file:PATH" of the file that `dask scheduler --scheduler-file PATH` writes.

    Returns:
      The kind, "local", "address" or "file", and its value.

    Raises:
      InputError: another text, or Dask is not installed.
    """
    kind, _, value = cluster.partition(":")
    if kind == "local" and re.fullmatch(r"[1-9]\d{0,3}", value):
        found = ("local", value)
    elif re.fullmatch(r"(tcp|tls)://[^\s/:]+:\d{1,5}|(tcp|tls)://\[[0-9a-fA-F:]+\]:\d{1,5}", cluster):
        found = ("address", cluster)
    elif kind == "file" and value:
        found = ("file", value)
    else:
        raise InputError(f"--cluster: got {cluster!r}, expected {_FORMS}")
    if importlib.util.find_spec("distributed") is None:
        raise InputError('--cluster needs Dask, which is not installed: pip install "btr-mjx[cluster]"')
    return found


@contextmanager
def connect(cluster: Any, timeout: float = CONNECT_TIMEOUT) -> Iterator[Any]:
    """Connect to a cluster; prints the address of Dask's dashboard.

    Scripts that use "local:N" need the guard `if __name__ == "__main__":`, since workers are new processes that import
    the script.

    Args:
      cluster: a text as of `check_cluster`, or a `distributed.Client`, which stays open.
      timeout: time within which the scheduler must answer [s].

    Yields:
      A `distributed.Client`.

    Raises:
      InputError: a text of another form, no Dask, or a scheduler that does not answer.
    """
    if not isinstance(cluster, str):
        yield cluster
        return
    kind, value = check_cluster(cluster)
    with _local_client(int(value)) if kind == "local" else _remote_client(cluster, kind, value, timeout) as client:
        note(f"cluster {cluster}: dashboard at {client.dashboard_link or '(off)'}")
        if not client.nthreads():
            note(f"cluster {cluster} has no workers yet: waiting for the first")
        yield client


@contextmanager
def _local_client(workers: int) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    from btr_mjx.cluster.local_worker import LocalWorker

    settings = {"distributed.scheduler.allowed-failures": 10, "distributed.worker.multiprocessing-method": "spawn"}
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,  # what JAX compiles would count, and blocks are small
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,  # lost workers are expected, and reported in one line where they matter
        ) as local,
        Client(local) as client,
    ):
        client.register_plugin(LocalWorker(workers))
        yield client


@contextmanager
def _remote_client(cluster: str, kind: str, value: str, timeout: float) -> Iterator[Any]:
    from distributed import Client

    address = value if kind == "address" else _address_in(Path(value), timeout)
    try:
        client = Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise InputError(
            f"--cluster {cluster}: no scheduler answers at {address} within {timeout:g} s; start one with "
            f"`dask scheduler`, or check host and port ({type(error).__name__})"
        ) from error
    with client:
        yield client


def _address_in(path: Path, timeout: float) -> str:
    """The address in a scheduler file, which a scheduler that has just been started may still have to write."""
    until = time.monotonic() + timeout
    while not path.is_file():
        if time.monotonic() > until:
            raise InputError(
                f"--cluster file:{path}: there is no such file after {timeout:g} s; "
                f"`dask scheduler --scheduler-file {path}` writes it"
            )
        time.sleep(0.1)
    try:
        return str(json.loads(path.read_bytes())["address"])
    except (ValueError, KeyError, TypeError):
        raise InputError(f'--cluster file:{path}: not a scheduler file, expected JSON with an "address"') from None
