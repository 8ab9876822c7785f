"""Tasks of a Dask client as futures of `concurrent.futures`, right also when a worker dies after it has answered.

The executor that Dask makes of a client (`client.get_executor()`) takes a result for an error if the worker that held it died
while the result was on its way: the task is being repeated then, a state that the executor does not expect, and its future
raises "too many values to unpack" (seen in distributed 2026.8).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any


def submit_to_dask(executor: Any, function: Callable[..., Any], *arguments: Any) -> Future:
    """Submits a call to the client of an executor, with the executor's options.

    Args:
        executor: of `client.get_executor()`.
        function: what is called with the other arguments; all can be pickled.

    Raises:
        RuntimeError: the executor was shut down.
    """
    if executor._shutdown:
        raise RuntimeError("the Dask executor was shut down; call client.get_executor() for another one")
    task = executor._client.submit(function, *arguments, **executor._kwargs)
    executor._futures.add(task)  # which it cancels when it is shut down
    future: Future = Future()
    future.add_done_callback(lambda done: task.cancel() if done.cancelled() else None)
    task.add_done_callback(lambda task: deliver(task, future))
    return future


def deliver(task: Any, future: Future) -> None:
    """Gives a future the result of a task that has ended; one that was lost is waited for until it has been computed again.

    Args:
        task: a future of Dask.
        future: what gets its result or error; one that was cancelled gets nothing.
    """
    result = error = None
    try:
        result = task.result()
    except BaseException as raised:  # what the task raised, or that it was cancelled
        error = raised
    if not future.set_running_or_notify_cancel():
        return
    if error is not None:
        future.set_exception(error)
    else:
        future.set_result(result)
