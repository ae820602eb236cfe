"""Functions mapped over cases on a Dask cluster, whose workers may be killed, hang, or join at any time.

Dask gives what a lost worker had in hand to others; one that sends no sign of life counts as lost after Dask's setting
`distributed.scheduler.worker-ttl`. The client keeps few tasks in flight, so that neither its memory nor the scheduler's
grows with the number of tasks.
"""

import itertools
import queue
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from btr_mjx.cluster.connection import connect
from btr_mjx.cluster.worker_call import call_on_worker, numerical_environment
from btr_mjx.errors import InputError
from btr_mjx.runs import content_digest

_POLL = 1.0
"""Time between two looks at the cluster [s]."""

_LOST = "the Dask scheduler was lost; what had arrived is kept: start the scheduler and go on with --resume"


def map_cases(
    function: Callable[[Any], Any], cases: Iterable[Any], cluster: Any, *, jax_backend: bool = False
) -> Iterator[tuple[Any, Any]]:
    """Map a function over cases on a cluster, or in this process.

    Args:
      function: function of a case; it can be repeated without harm. Its module must be importable on the workers,
        unless it is the main script.
      cases: the cases; equal ones are computed once.
      cluster: see `connect`; None calls the function here.
      jax_backend: whether results depend on JAX, so that its device and precision must be the client's.

    Yields:
      A case and its result, in the order in which they end.

    Raises:
      InputError: see `map_tasks`.
    """
    if cluster is None:
        for case in cases:
            yield case, function(case)
        return
    named = {f"case-{content_digest(case)}": case for case in cases}
    with connect(cluster) as client:
        tasks = ((name, (case,)) for name, case in named.items())
        for name, result in map_tasks(client, function, tasks, jax_backend=jax_backend):
            yield named[name], result


def map_tasks(
    client: Any,
    function: Callable[..., Any],
    tasks: Iterable[tuple[str, tuple[Any, ...]]],
    *,
    jax_backend: bool,
    idle: Callable[[], object] = lambda: None,
) -> Iterator[tuple[str, Any]]:
    """Call a function, which can be repeated without harm, on the workers of a cluster.

    A task is a name, which stands for the content of its arguments and is there once, and these arguments. With
    `jax_backend` results depend on JAX. `idle` is called about once a second while nothing arrives. Yields names and
    results in the order in which they arrive.

    Raises:
      InputError: a worker differs from this process, cannot import this package or the function's module, raises an
        InputError, or is killed again and again by the same task; or the scheduler is lost.
    """
    environment, sent = numerical_environment(jax_backend), _pickled(function)
    digest = content_digest(sent, environment)[:12]
    left, waiting = iter(tasks), dict[str, tuple[str, Any]]()
    answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
    window, looked = 2, 0.0
    with _scheduler_errors(client):
        while True:
            if time.monotonic() - looked > _POLL:
                window, looked = 2 * max(1, len(client.nthreads())), time.monotonic()
            for name, arguments in itertools.islice(left, max(0, window - len(waiting))):
                key = f"{name}-{digest}"
                future = client.submit(call_on_worker, environment, sent, _pickled(arguments), key=key, pure=False)
                waiting[key] = (name, future)  # Dask forgets a task to which no future refers
                future.add_done_callback(answers.put)
            if not waiting:
                return
            try:
                future = answers.get(timeout=_POLL)
            except queue.Empty:
                idle()
                continue
            name, _ = waiting.pop(future.key)
            result = _result(future, name)
            del future, _  # the cluster need not keep the result
            yield name, result


def _result(future: Any, name: str) -> Any:
    """A task's result; raises its error."""
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise InputError(
            f"{name}: its workers were killed again and again, perhaps for lack of memory; see their logs"
        ) from error
    except Exception as error:
        if isinstance(error, ImportError | AttributeError) or "deserializ" in str(error):
            cause = error.__cause__ or error
            raise InputError(
                f"a worker or the scheduler cannot load the task ({type(cause).__name__}: {cause}); install the same "
                "btr-mjx[cluster] there, and put modules of your own on its PYTHONPATH"
            ) from error
        raise


@contextmanager
def _scheduler_errors(client: Any) -> Iterator[None]:
    """A lost scheduler is bad input with one line, not a bug."""
    from concurrent.futures import CancelledError
    from concurrent.futures import TimeoutError as Late

    from distributed.comm import CommClosedError

    try:
        yield
    except (CommClosedError, CancelledError, Late, OSError) as error:
        if client.status == "running" and isinstance(error, OSError) and not isinstance(error, CommClosedError):
            raise  # an error of the disk, not of the cluster
        raise InputError(_LOST) from error


def _pickled(value: Any) -> bytes:
    import cloudpickle

    try:
        return cloudpickle.dumps(value)
    except Exception as error:  # pickle raises errors of many types
        raise InputError(
            f"cannot be sent to a worker: {type(error).__name__}: {error}; use plain data and functions"
        ) from error
