"""What runs on a worker: one call of a function that the client sent. Importing this module must stay cheap."""

import pickle
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from btr_mjx.cluster.environment import check_environment
from btr_mjx.errors import InputError


def call_on_worker(environment: Mapping[str, str], function: bytes, arguments: bytes) -> tuple[str, Any]:
    """Call a function on a worker.

    Args:
      environment: `numerical_environment` of the client.
      function: the pickled function.
      arguments: its pickled arguments, a tuple.

    Returns:
      The worker's address and the function's result.

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
    return worker.address, _function(function)(*pickle.loads(arguments))


@lru_cache(maxsize=4)
def _function(pickled: bytes) -> Any:
    """The same object in every call: programs are compiled once for a robot, and robots are compared by their parts."""
    return pickle.loads(pickled)
