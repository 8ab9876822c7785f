"""Workers: the executor that answers blocks, how many blocks it is given at a time, and each process's threads and device.

An executor is anything with the methods of `concurrent.futures.Executor`: threads, processes, `client.get_executor()` of Dask.
A process finds out by itself how many threads it may use: those that it was told, those of its Dask worker (`nthreads`), or as
many as there are cores. Tasks that run in it at the same time share them.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import Any, NamedTuple

import warp as wp

from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.compilation.target import split_flags
from wrt.kernels.runtime.launch import check_num_threads, get_num_threads, use_threads
from wrt.kernels.validation import as_int, convert_fields
from wrt.query.batches.dask_futures import submit_to_dask

BLOCKS_PER_SLOT = 2
"""Blocks that are submitted for each that an executor runs at a time: one to work on, and one that waits beside it."""

UNKNOWN_SLOTS = 32
"""Blocks that an executor is taken to run at a time if it does not say."""

_lock = threading.Lock()
_running = 0
_assigned: dict[str, Any] = {}
"""What this process was told when it started: "threads" and "device"."""


@dataclass(frozen=True)
class Workers:
    """An executor with options: `executor=wrt.cluster.Workers(executor, ...)` in place of `executor=executor`.

    Attributes:
        executor: a `concurrent.futures.Executor`.
        folder: a folder that the client and all workers see, for the file of the scene. None: a temporary folder of the
            client's machine; Dask workers that do not see it are sent the file, once each.
        threads: threads of each worker process; None for those of its Dask worker, or, for processes of this machine, its share
            of the cores.
        device: the device of each worker, such as "cuda:0". None: that of the process (`ProcessPool`), else "cuda:0" if the
            scene is on a GPU, which for one process a GPU with `CUDA_VISIBLE_DEVICES` is its own, else "cpu".
        window: number of blocks submitted at a time; None for twice as many as the executor runs at a time, and two more.
        retries: how often a block is submitted again after its worker died.

    Raises:
        TypeError: `executor` has no method `submit`, or a number is not an int.
        ValueError: a number is out of range.
    """

    executor: Any
    folder: str | Path | None = None
    threads: int | None = None
    device: str | None = None
    window: int | None = None
    retries: int = 2

    def __post_init__(self) -> None:
        if not callable(getattr(self.executor, "submit", None)):
            kind = type(self.executor).__name__
            hint = "; call client.get_executor()" if hasattr(self.executor, "get_executor") else ""
            raise TypeError(f"executor must be a concurrent.futures.Executor, not {kind}{hint}")
        convert_fields(self)
        if self.threads is not None:
            check_num_threads(self.threads, "threads")
        for name, minimum in (("window", 1), ("retries", 0)):
            if getattr(self, name) is not None:
                as_int(name, getattr(self, name), minimum)

    @property
    def in_this_process(self) -> bool:
        """Whether tasks run in threads of this process, which need no file of the scene."""
        return isinstance(self.executor, ThreadPoolExecutor)

    @property
    def client(self) -> Any:
        """The Dask client of the executor, or None."""
        client = getattr(self.executor, "_client", None)
        return client if hasattr(client, "register_plugin") else None

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """Submits a call to the executor.

        Args:
            function: what is called with the other arguments.
        """
        if self.client is not None:
            return submit_to_dask(self.executor, function, *arguments)
        return self.executor.submit(function, *arguments)

    def slots(self) -> int:
        """Number of tasks that the executor runs at a time."""
        if self.client is not None:
            return max(1, sum(self.client.ncores().values()))
        return getattr(self.executor, "_max_workers", UNKNOWN_SLOTS)

    def window_size(self) -> int:
        """Number of blocks to submit at a time."""
        return self.window or BLOCKS_PER_SLOT * self.slots() + 2

    def threads_each(self) -> int | None:
        """Threads that a process is told to use, if it does not know better."""
        if self.threads is not None or self.client is not None:
            return self.threads
        if isinstance(self.executor, (ProcessPoolExecutor, ProcessPool)):
            return max(1, available_cores() // self.slots())
        return None


def as_workers(executor: Any) -> Workers | None:
    """The workers of the argument `executor`."""
    return executor if executor is None or isinstance(executor, Workers) else Workers(executor)


class ProcessPool(Executor):
    """Processes of this machine. A pool whose process was killed goes on with new ones.

        with wrt.cluster.ProcessPool(4) as pool:
            dark = scene.occluded_blocks(origins, directions, executor=pool).result()

    Processes are spawned, so a script that makes a pool needs `if __name__ == "__main__":`. Ctrl-C interrupts the client and
    not the workers. (A `concurrent.futures.ProcessPoolExecutor` does as well, but ends for good when one of its processes
    dies.)

    Args:
        workers: number of processes; None for one for each device, or each core.
        threads: threads of each; None for its share of the cores.
        devices: names of devices, such as ["cuda:0", "cuda:1"], which processes take in turn: one process for each GPU. None:
            as the scene.

    Raises:
        TypeError: a number is not an int.
        ValueError: a number is not from 1 to 1024.
    """

    def __init__(self, workers: int | None = None, *, threads: int | None = None, devices: Sequence[str] | None = None) -> None:
        number = (len(devices) if devices else available_cores()) if workers is None else workers
        self._max_workers = check_num_threads(number, "workers")
        share = max(1, available_cores() // self._max_workers)
        self._threads = share if threads is None else check_num_threads(threads, "threads")
        self._devices, self._renewing = tuple(devices or ()), threading.Lock()
        self._pool = self._started()

    def __repr__(self) -> str:
        return f"ProcessPool({self._max_workers}, threads={self._threads}, devices={self._devices or None})"

    def _started(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        number = context.Value("i", 0)
        start = (number, self._threads, self._devices, WarpSettings.here())
        return ProcessPoolExecutor(self._max_workers, context, initializer=start_worker, initargs=start)

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future:
        """Submits a call; after a process died, to new ones.

        Args:
            fn: what is called, with the other arguments; it can be pickled, and so can they.
        """
        with self._renewing:
            try:
                return self._pool.submit(fn, *args, **kwargs)
            except BrokenExecutor:
                self._pool.shutdown(wait=False)
                self._pool = self._started()
                return self._pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes. Arguments as in `concurrent.futures.Executor.shutdown`."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)


class WarpSettings(NamedTuple):
    """Settings of Warp that workers take over from their client.

    Attributes:
        flags: for compiling kernels for CPUs, but those for a machine's own CPU: the same kernels, from the same cache.
        log_level: least level of messages.
    """

    flags: tuple[str, ...]
    log_level: int

    @staticmethod
    def here() -> WarpSettings:
        """Those of this process."""
        return WarpSettings(tuple(split_flags(wp.config.cpu_compiler_flags or "")[1]), wp.config.log_level)

    def use(self) -> None:
        """Applies them."""
        wp.config.log_level = max(wp.config.log_level, self.log_level)
        if self.flags != WarpSettings.here().flags:
            own = split_flags(wp.config.cpu_compiler_flags or "-march=native")[0]
            wp.config.cpu_compiler_flags = " ".join([*own, *self.flags])


def start_worker(number: Any, threads: int, devices: tuple[str, ...], settings: WarpSettings) -> None:
    """Starts a process of a pool: it takes its number, and with it its device."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settings.use()
    with number.get_lock():
        own, number.value = number.value, number.value + 1
    _assigned["threads"] = threads
    threading.Thread(target=end_with_client, name="wrt-end-with-client", daemon=True).start()
    if devices:
        _assigned["device"] = devices[own % len(devices)]


def end_with_client() -> None:
    """Ends this process when its client has died: a worker that waits for tasks would wait for ever."""
    if (client := multiprocessing.parent_process()) is not None:
        connection.wait([client.sentinel])
        os._exit(1)


@contextmanager
def task_threads(told: int | None) -> Iterator[None]:
    """Gives a task its share of the process's threads: those that are there, divided by the tasks that run now."""
    global _running
    with _lock:
        _running += 1
        share = max(1, process_threads(told) // _running)
    try:
        with use_threads(share):
            yield
    finally:
        with _lock:
            _running -= 1


def process_threads(told: int | None) -> int:
    """Threads of this process: those it was told, those of its Dask worker, or its own number."""
    if told is not None:
        return told
    if "threads" in _assigned:
        return _assigned["threads"]
    if "distributed.worker" in sys.modules and "WRT_NUM_THREADS" not in os.environ:
        with suppress(ValueError, AttributeError):  # no task of Dask
            return max(1, sys.modules["distributed.worker"].get_worker().state.nthreads)
    return get_num_threads()


def process_device(told: str | None, scenes: str) -> str:
    """The device of this process.

    Args:
        told: as `Workers.device`.
        scenes: name of the device of the scene that was saved.
    """
    return told or _assigned.get("device") or ("cuda:0" if scenes.startswith("cuda") else "cpu")
