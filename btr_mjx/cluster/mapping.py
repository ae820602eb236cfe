"""Tasks on a Dask cluster whose workers may be killed, hang, or join at any time.

Tasks are idempotent: each may be given to several workers, and its first answer counts. The client keeps few tasks in
flight, so that neither its memory nor the scheduler's grows with the number of tasks.
"""

import itertools
import queue
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from btr_mjx.cluster.connection import connect
from btr_mjx.cluster.environment import numerical_environment
from btr_mjx.cluster.worker_call import call_on_worker
from btr_mjx.errors import InputError
from btr_mjx.runs import content_digest, note

_POLL = 1.0
"""Time between two looks at the cluster [s]."""

_FETCH_TIMEOUT = 60.0
"""Time within which a finished result must arrive from its worker [s]; it may have hung just then."""

_ATTEMPTS = 4
"""Number of times that a task is sent; each time Dask itself tries again after `allowed-failures` lost workers."""


@dataclass
class _Task:
    arguments: bytes
    sent: int = 0
    """Number of attempts."""
    futures: dict[str, Any] = field(default_factory=dict)
    """Key of an attempt that has not failed -> its future."""
    begun: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Key of an attempt -> the worker that has it, and since when [s]."""


def map_cases(
    function: Callable[[Any], Any],
    cases: Iterable[Any],
    cluster: Any,
    *,
    limit: float | None = None,
    jax_backend: bool = False,
) -> Iterator[tuple[Any, Any]]:
    """Map a function over cases on a cluster, or in this process.

    Args:
      function: function of a case; it can be repeated without harm. Its module must be importable on the workers,
        unless it is the main script.
      cases: the cases; equal ones are computed once.
      cluster: see `connect`; None calls the function here.
      limit: time after which a case is given to another worker as well [s]; None for no limit.
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
        for name, result in map_tasks(client, function, tasks, limit=limit, jax_backend=jax_backend):
            yield named[name], result


def map_tasks(
    client: Any,
    function: Callable[..., Any],
    tasks: Iterable[tuple[str, tuple[Any, ...]]],
    *,
    limit: float | None,
    jax_backend: bool,
    idle: Callable[[], object] = lambda: None,
) -> Iterator[tuple[str, Any]]:
    """Call a function on the workers of a cluster.

    Args:
      client: a `distributed.Client`.
      function: the function.
      tasks: names and arguments; a name stands for the content of its arguments.
      limit: time on a worker after which a task is given to another worker as well [s]; None for no limit.
      jax_backend: whether results depend on JAX.
      idle: called about once a second while nothing arrives.

    Yields:
      Name and result of each task once, in the order in which they arrive.

    Raises:
      InputError: a worker differs from this process, cannot import this package or the function's module, raises an
        InputError, or is killed again and again by the same task; or the scheduler is lost.
    """
    call = _Calls(client, function, jax_backend)
    left, waiting, names = iter(tasks), dict[str, _Task](), dict[str, str]()
    answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
    window, looked, suspects = 2, 0.0, set[str]()

    def send(name: str, workers: list[str] | None = None) -> None:
        task = waiting[name]
        key = f"{name}-{call.digest}-{task.sent}"
        names[key], task.sent = name, task.sent + 1
        task.futures[key] = call.submit(key, task.arguments, workers)
        task.futures[key].add_done_callback(answers.put)

    with _scheduler_errors(client):
        while True:
            for name, arguments in itertools.islice(left, max(0, window - len(waiting))):
                waiting[name] = _Task(_pickled(arguments))
                send(name)
            if not waiting:
                return
            try:
                future = answers.get(timeout=_POLL)
            except queue.Empty:
                idle()
                future = None
            if time.monotonic() - looked > _POLL:
                window = _look(client, waiting, suspects, limit, send)
                looked = time.monotonic()
            name = names.pop(future.key) if future is not None else ""
            if name not in waiting:
                continue  # nothing, or a later answer
            task = waiting[name]
            del task.futures[future.key]
            answer = _answer(future, name, task.sent)
            if answer is None:
                if not task.futures:
                    send(name)
                continue
            worker, result = answer
            suspects.discard(worker)
            del waiting[name]
            for other in task.futures.values():
                other.cancel()
            del future, task, answer  # the cluster need not keep the result
            yield name, result


def _look(
    client: Any, waiting: dict[str, _Task], suspects: set[str], limit: float | None, send: Callable[..., None]
) -> int:
    """Give overdue tasks to other workers; returns the number of tasks that should be in flight."""
    workers = client.nthreads()
    if not workers:
        return 2
    now, on_worker = time.monotonic(), dict[str, str]()
    for worker, keys in client.processing().items():
        on_worker |= dict.fromkeys(keys, worker)
    for name, task in waiting.items():
        seen = {key: on_worker[key] for key in task.futures if key in on_worker}
        begun = {key: (worker, now) for key, worker in seen.items()}
        task.begun = {key: old if (old := task.begun.get(key)) and old[0] == seen[key] else begun[key] for key in seen}
        slow = {
            worker
            for worker, since in task.begun.values()
            if worker in suspects or (limit is not None and now - since > limit)
        }
        # Where every attempt is on a slow worker, one more is worth it.
        if slow and len(seen) == len(task.futures) and slow == set(seen.values()):
            new = sorted(slow - suspects)
            suspects |= slow
            if new:
                note(f"warning: no answer from {', '.join(new)} for {limit:g} s: others get its work, too")
            if others := sorted(set(workers) - suspects):
                send(name, others)
    return 2 * len(workers)


class _Calls:
    """Submits calls of one function."""

    def __init__(self, client: Any, function: Callable[..., Any], jax_backend: bool) -> None:
        self._client, self._function = client, _pickled(function)
        self._environment: Mapping[str, str] = numerical_environment(jax_backend)
        self.digest = content_digest(self._function, self._environment)[:12]

    def submit(self, key: str, arguments: bytes, workers: list[str] | None) -> Any:
        where: dict[str, Any] = {} if workers is None else {"workers": workers, "allow_other_workers": True}
        return self._client.submit(
            call_on_worker, self._environment, self._function, arguments, key=key, pure=False, **where
        )


def _answer(future: Any, name: str, attempts: int) -> tuple[str, Any] | None:
    """A worker's address and its result; None where the task should be sent again. Raises a task's error."""
    from distributed import KilledWorker

    if future.status == "finished":
        try:
            return future.result(timeout=_FETCH_TIMEOUT)
        except TimeoutError:
            return None
    if future.status != "error":
        raise InputError(_LOST)
    error = future.exception()
    if isinstance(error, KilledWorker):
        if attempts < _ATTEMPTS:
            return None
        raise InputError(
            f"{name}: its workers were killed {attempts} times, perhaps for lack of memory; see their logs"
        )
    if isinstance(error, ImportError | AttributeError) or "deserializ" in str(error):
        cause = error.__cause__ or error
        raise InputError(
            f"a worker or the scheduler cannot load the task ({type(cause).__name__}: {cause}); install the same "
            "btr-mjx[cluster] there, and put modules of your own on its PYTHONPATH"
        ) from error
    raise error


_LOST = "the Dask scheduler was lost; what had arrived is kept: start the scheduler and go on with --resume"


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
