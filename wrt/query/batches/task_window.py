"""A bounded window of submitted tasks: a limited number at a time, repeated if a worker dies, answered in any order.

Three million tasks submitted at once take minutes until the first one starts and gigabytes in a scheduler. With a window, what
is submitted and what waits for the client does not depend on the number of blocks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from time import monotonic
from typing import Any, NamedTuple, TypeVar

from wrt.query.batches.workers import Workers

Task = TypeVar("Task")

LOST = ("KilledWorker", "CommClosedError", "FutureCancelledError", "WorkerDiedError", "RayActorError", "WorkerCrashedError")
"""Names of errors of executors by which they say that a worker was lost."""

REFRESH = 5.0
"""Seconds after which the executor is asked again how many tasks it runs at a time: clusters grow."""


class Submitted(NamedTuple):
    """A task under way.

    Attributes:
        number: in the order of submission.
        task: what was submitted.
        tries: how often.
    """

    number: int
    task: Any
    tries: int


def run_tasks(
    tasks: Iterable[Task], submit: Callable[[Task], Future], workers: Workers, ordered: bool
) -> Iterator[tuple[Task, Any]]:
    """The tasks with their results.

    Args:
        tasks: read as far as the window reaches.
        submit: submits a task to the executor.
        workers: the size of the window, and how often a lost task is submitted again.
        ordered: whether results come in the order of the tasks; the window then also bounds those that wait for an earlier one.

    Raises:
        RuntimeError: a task was lost more often than `workers.retries`.
        Exception: what a task raised. Tasks under way are cancelled first.
    """
    under_way: dict[Future, Submitted] = {}
    ready: dict[int, tuple[Task, Any]] = {}
    source, first, number = iter(tasks), 0, 0
    size, asked, is_more = workers.window_size(), monotonic(), True
    finished: deque[Future] = deque()
    try:
        while True:
            if monotonic() - asked > REFRESH:
                size, asked = workers.window_size(), monotonic()
            while is_more and len(under_way) < size and (not ordered or number - first < 2 * size):
                task = next(source, None)
                if task is None:
                    is_more = False
                    break
                under_way[submit(task)] = Submitted(number, task, 1)
                number += 1
            if not under_way:
                return
            if not finished:
                finished.extend(wait(under_way, return_when=FIRST_COMPLETED).done)
            future = finished.popleft()
            one = under_way.pop(future)
            try:
                result = future.result()
            except BaseException as error:
                if not is_lost(error):
                    raise
                if one.tries > workers.retries:
                    raise RuntimeError(lost_message(one, workers, error)) from error
                try:
                    under_way[submit(one.task)] = one._replace(tries=one.tries + 1)
                except BrokenExecutor:
                    raise RuntimeError(lost_message(one, workers, error)) from error
                continue
            if not ordered:
                yield one.task, result
                continue
            ready[one.number] = (one.task, result)
            while first in ready:
                yield ready.pop(first)
                first += 1
    finally:
        for future in under_way:
            future.cancel()


def is_lost(error: BaseException) -> bool:
    """Whether an error says that a worker died, and nothing about the task."""
    return isinstance(error, (BrokenExecutor, CancelledError)) or type(error).__name__ in LOST


def lost_message(one: Submitted, workers: Workers, error: BaseException) -> str:
    """What to do about a task whose workers died each time."""
    kind = type(workers.executor).__name__
    if isinstance(error, BrokenExecutor):
        return f"a worker process died, and {kind} does not replace it ({error}); use wrt.cluster.ProcessPool"
    return (
        f"the workers that took block {one.number} died {one.tries} times ({type(error).__name__}: {error}); if they ran out "
        "of memory, lower `memory`, which bounds a block, or run fewer tasks in a process"
    )
