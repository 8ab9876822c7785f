"""Tasks beside queries, one after the other on a thread of their own: no caller waits for them.

The thread is no thread of a `ThreadPoolExecutor`: Ctrl-C while one of those starts leaves a thread that the executor does not
know, and for which the interpreter waits at its exit for ever.

A fork waits for the task under way: it may hold locks of Warp, which the child would never get.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import Any

_Queue = SimpleQueue[Callable[[], Any] | None]

_lock = threading.RLock()
_thread: threading.Thread | None = None
_queue: _Queue = SimpleQueue()
_is_exiting = False

_under_way = threading.Lock()
"""Held by a task, and during a fork."""

_is_waited_for = False
"""Whether the fork under way holds it."""

FORK_SECONDS = 10.0
"""How long a fork waits at most: who forks may hold what the task waits for."""


def run_in_background(task: Callable[[], Any]) -> None:
    """Calls a task, some time; what it raises is lost. At its exit the interpreter waits for the task under way and drops those
    that have not begun."""
    global _thread
    with _lock:
        if _is_exiting:
            return
        if _thread is None or not _thread.is_alive():
            _thread = threading.Thread(target=_serve, args=[_queue], name="wrt-background", daemon=True)
            with suppress(RuntimeError):  # no more threads, or the interpreter is exiting: the task waits for another time
                _thread.start()
            atexit.unregister(_close)
            atexit.register(_close)
    _queue.put(task)


def _serve(queue: _Queue) -> None:
    """Calls tasks until there is a None in the queue."""
    while (task := queue.get()) is not None:
        with suppress(BaseException), _under_way:
            if not _is_exiting:
                task()
        del task  # what it holds lives no longer


def _close() -> None:
    """Ends the thread, as it must not outlive Warp."""
    global _is_exiting
    with _lock:
        _is_exiting = True
        thread = _thread
    if thread is not None and thread.is_alive():
        _queue.put(None)
        thread.join()


def _await_task() -> None:
    """Before a fork."""
    global _is_waited_for
    _is_waited_for = _under_way.acquire(timeout=FORK_SECONDS)


def _go_on() -> None:
    """After it, in the parent."""
    if _is_waited_for:
        _under_way.release()


def _forget() -> None:
    """A forked child does not have the thread."""
    global _lock, _queue, _thread, _is_exiting, _under_way
    _lock, _queue, _thread, _is_exiting = threading.RLock(), SimpleQueue(), None, False
    _under_way = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_await_task, after_in_parent=_go_on, after_in_child=_forget)
