"""The Python half of the thread pool: helper threads, slots of callers, interrupts, fork and exit.

A launch on the CPU is a job of the pool (`wrt.kernels.runtime.job_queue` defines the protocol). Helpers are started when a job
first needs them; each makes one call into compiled code and stays there, so Python does not hand out chunks. Every calling
Python thread has its own slot in the job queue, so jobs of several callers run concurrently. A caller whose slot is in use (a
signal handler that starts a query while its thread runs one) works without helpers.

**Interrupts.** A caller returns to Python every `TURN_NS`. An exception there (KeyboardInterrupt) stops the job: no thread
takes another chunk, and the caller waits for the running ones. If the caller is interrupted again while it waits, the job's
memory is kept in `_interrupted` until the last helper has left.

**Fork.** A child process has none of the helpers; it makes a new pool for its first job. **Exit.** Helpers return before the
interpreter frees compiled code; a running query of a daemon thread then ends with a RuntimeError.

**Limits.** Linux only; elsewhere `wrt.kernels.runtime.launch` hands out chunks in Python (`is_available`).
"""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
import threading
import time
from collections import deque
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.compilation.host_cpu import cpu_features
from wrt.kernels.compilation.module_compiler import load_modules
from wrt.kernels.runtime import job_queue as layout
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.core_pinning import MAX_CORES
from wrt.kernels.runtime.job_queue import Job
from wrt.kernels.runtime.schedules import Schedule

SPIN_SECONDS = 0.001
"""Seconds for which a helper without work spins before it sleeps: more than Python needs from one call to the next in a
loop."""

EXIT_SECONDS = 1.0
"""Greatest time in seconds that the exit of the interpreter waits for threads in compiled code."""


class Slot:
    """A slot of a job queue, for the jobs of one thread.

    Args:
        job_queue: `wrt.kernels.runtime.job_queue`.
        index: number of the slot.
        free: receives the index when the slot is no longer referenced.
    """

    def __init__(self, job_queue: wp.array, index: int, free: deque[int] | None = None) -> None:
        self._index, self._free = index, free
        first = layout.FIRST_SLOT + index * layout.SLOT_WORDS
        self._words = (ctypes.c_int64 * layout.SLOT_WORDS).from_address(job_queue.ptr + 8 * first)
        self._job_queue = job_queue
        self._run = PackedKernel(layout.run_as_caller, [job_queue, index, 0], job_queue.device)
        self._stop = PackedKernel(layout.stop, [job_queue, index], job_queue.device)
        self._run_now = self._run.prepared_call()
        self.is_busy = False
        self.owner_waits = False  # whether the interrupted owner finishes the job itself; only one thread may lead it

    @property
    def is_idle(self) -> bool:
        """Whether the slot has no job and no helper."""
        return self._words[layout.PHASE] == layout.IDLE

    def begin(self, job: Job) -> bool:
        """Begins a job with its first turn; whether that was all, as for most jobs."""
        self._run.arguments.p2 = ctypes.addressof(job)
        self._run_now()
        return self._words[layout.PHASE] == layout.IDLE

    def turn(self) -> bool:
        """Works on the job for at most `TURN_NS`, or until the current chunk is done; whether the slot is idle then."""
        self._run_now()
        return self._words[layout.PHASE] == layout.IDLE

    def stop(self) -> None:
        """Stops the job: no thread takes another chunk."""
        self._stop.call()

    @property
    def has_helpers(self) -> bool:
        """Whether a helper works on the job."""
        return self._words[layout.ACTIVE] != 0

    def __del__(self) -> None:
        if self._free is not None:
            self._free.append(self._index)


class Pool:
    """Helper threads and the job queue in which they find jobs; thread-safe."""

    def __init__(self) -> None:
        self._job_queue = wp.zeros(layout.JOB_QUEUE_WORDS, dtype=wp.int64, device="cpu")
        words = self._job_queue.numpy()
        words[layout.MAX_SPINNING] = available_cores() - 1
        words[layout.SPIN_NS] = int(SPIN_SECONDS * 1e9)
        words[layout.STAYS] = "hypervisor" in cpu_features() and available_cores() <= MAX_CORES
        self._words = words
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._free = deque(range(layout.SLOTS))
        self._local = threading.local()
        self._interrupted: deque[tuple[Slot, Any]] = deque()
        self.closed = False

    def run(self, job: Job, used: Any) -> None:
        """Runs a job to its end.

        Args:
            job: its addresses must stay valid as long as `used` is alive.
            used: owners of all memory that the job reads or writes.

        Raises:
            RuntimeError: the interpreter is exiting, or the process was forked during the job.
        """
        if self._interrupted:
            self._reap()
        if job.helpers > len(self._threads):
            self._start(job.helpers)
        slot = self._slot()
        slot.is_busy = True
        try:
            is_done = slot.begin(job)
            while not is_done:
                if self.closed:
                    raise RuntimeError("the query was stopped: the interpreter is exiting, or the process was forked")
                is_done = slot.turn()
            slot.is_busy = False
        except BaseException:
            slot.owner_waits = True
            try:
                self._interrupted.append((slot, (job, used)))
                if not self.closed:
                    self._finish(slot)
            finally:
                slot.owner_waits = False
            self._reap()
            raise

    def close(self) -> None:
        """Makes helpers return, and waits for them and for callers, at most `EXIT_SECONDS`."""
        if self.closed:  # or the parent's pool in a forked child
            return
        self.closed = True
        PackedKernel(layout.close, [self._job_queue], self._job_queue.device).call()
        until = time.monotonic() + EXIT_SECONDS
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
        phases = self._words[layout.FIRST_SLOT : layout.SLEEPERS].reshape(layout.SLOTS, layout.SLOT_WORDS)[:, layout.PHASE]
        while phases.any() and time.monotonic() < until:
            time.sleep(0.001)

    def _slot(self) -> Slot:
        """A slot for a job of the calling thread."""
        slot = getattr(self._local, "slot", None)
        if slot is None:
            slot = self._local.slot = self._new_slot()
        return _private_slot() if slot.is_busy else slot

    def _new_slot(self) -> Slot:
        """A free slot of the job queue; if all are taken, a slot of a private job queue, whose jobs get no helpers."""
        try:
            return Slot(self._job_queue, self._free.popleft(), self._free)
        except IndexError:
            return _private_slot()

    @staticmethod
    def _finish(slot: Slot) -> None:
        """Waits for the helpers of a stopped job."""
        slot.stop()
        while not slot.is_idle:
            slot.turn()

    def _reap(self) -> None:
        """Frees the memory of interrupted jobs that all helpers have left."""
        for _ in range(len(self._interrupted)):
            try:
                entry = self._interrupted.popleft()
            except IndexError:  # another thread took the last entry
                return
            slot = entry[0]
            if not slot.is_idle and not slot.owner_waits:
                slot.stop()
                if not slot.has_helpers:
                    slot.turn()
            if slot.is_idle and not slot.owner_waits:
                slot.is_busy = False
            else:
                self._interrupted.append(entry)

    def _start(self, helpers: int) -> None:
        """Starts helpers up to the given number; fewer if the system provides no more threads."""
        with self._lock:
            while len(self._threads) < helpers and not self.closed:
                helper = PackedKernel(layout.run_as_helper, [self._job_queue, len(self._threads)], self._job_queue.device)
                thread = threading.Thread(target=helper.call, name=f"wrt-{len(self._threads)}", daemon=True)
                try:
                    thread.start()
                except RuntimeError:  # no more threads, or the interpreter is exiting
                    return
                self._threads.append(thread)


def _private_slot() -> Slot:
    return Slot(wp.zeros(layout.JOB_QUEUE_WORDS, dtype=wp.int64, device="cpu"), 0)


def is_available() -> bool:
    """Whether this system supports native helpers."""
    return sys.platform == "linux"


def new_job(
    packed: PackedKernel, count: int, *, max_chunk: int, min_chunk: int, threads: int, schedule: Schedule
) -> tuple[Job, Any]:
    """A job, and the owners of the memory that it refers to.

    Args:
        packed: the kernel; its first parameter is the number of the first item.
        count: number of items.
        max_chunk, min_chunk: limits on the items per chunk.
        threads: number of threads that work on it, including the caller's.
        schedule: how they share the items.

    Raises:
        ValueError: the packed arguments exceed `MAX_ARGUMENT_BYTES`.
    """
    size = ctypes.sizeof(packed.arguments)
    if size > layout.MAX_ARGUMENT_BYTES:
        raise ValueError(f"the kernel's arguments take {size} bytes; the pool copies at most {layout.MAX_ARGUMENT_BYTES}")
    queues = np.zeros(threads * layout.CHUNK_QUEUE_WORDS, dtype=np.int64) if schedule.queues else None
    job = Job(
        entry=packed.entry,
        bounds=ctypes.addressof(packed.bounds),
        arguments=ctypes.addressof(packed.arguments),
        argument_bytes=size,
        count=count,
        max_chunk=max_chunk,
        min_chunk=min_chunk,
        divisor=2 * threads,
        helpers=threads - 1,
        schedule=schedule.code,
        queues=0 if queues is None else queues.ctypes.data,
        queue_count=0 if queues is None else threads,
    )
    return job, (packed, queues)


_pool: Pool | None = None
_pool_lock = threading.Lock()


def the_pool() -> Pool:
    """The pool of the process, made on first use."""
    global _pool
    if _pool is None:
        with _pool_lock:
            if _pool is None:
                load_modules([layout.run_as_helper.module], wp.get_device("cpu"), 1)
                pool = Pool()
                atexit.register(pool.close)  # registered after Warp's handler, so called before it
                _pool = pool
    return _pool


def _forget() -> None:
    """Resets the pool in a forked child: it has no helpers, and a thread that does not exist there may hold the lock."""
    global _pool, _pool_lock
    if _pool is not None:
        _pool.closed = True
    _pool, _pool_lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
