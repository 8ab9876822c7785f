"""Compiles kernels side by side, on threads of their own.

Warp compiles a module on the thread that first needs it, one after the other, and most of that time is Clang's, which runs
without the interpreter lock. Here a call says beforehand which kernels it is about to need (`expect`); what the kernel cache
does not have is compiled on all cores, while the caller goes on to the first kernel that it must wait for (`load_modules`).

Clang parses Warp's header before a first module (1.5 to 5 s). Threads and later processes share the result
(`wrt.kernels.compilation.precompiled_header`) where threads of this file compile, so modules are never compiled on the caller's
thread. On CUDA they are, one after the other, as Warp does it.

**Interrupts.** A Ctrl-C drops the modules that no thread has begun. Those under way are completed, so that the cache never has
half a module: Warp renames a finished folder into place, which also lets several processes share one cache.
"""

import atexit
import os
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from queue import SimpleQueue
from weakref import finalize

import warp as wp

from wrt.kernels.compilation import compile_progress, shipped_kernels
from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.compilation.kernel_cache import is_compiled, leave_full_disk, load_compiled, load_module
from wrt.kernels.compilation.precompiled_header import is_cache_new, shared_header

VARIABLE = "WRT_COMPILE_JOBS"

MAX_JOBS = 64
"""Most modules that are compiled at a time."""

TURN_SECONDS = 0.1
"""Longest wait at a time: a Ctrl-C that comes just before a wait has no effect until its end."""

Key = tuple[wp.Module, str, int]
"""A module, the alias of a device, and the number of threads of a block."""

_lock = threading.RLock()
_threads: list[threading.Thread] = []
_queue: SimpleQueue[tuple[Key, Future[None]] | None] = SimpleQueue()
_pending: dict[Key, Future[None]] = {}
_is_exiting = False
_loaded: dict[tuple[wp.Module, str], None] = {}
_compiles: ContextVar[bool] = ContextVar("wrt_compiles", default=True)


class NotCompiledError(RuntimeError):
    """A kernel is not compiled, and `without_compiling` forbids it."""


@contextmanager
def without_compiling() -> Iterator[None]:
    """Inside the `with` block, the calling thread gets a `NotCompiledError` from what would compile a kernel for the CPU."""
    token = _compiles.set(False)
    try:
        yield
    finally:
        _compiles.reset(token)


def compile_jobs() -> int:
    """Number of modules that are compiled at a time: WRT_COMPILE_JOBS, else the number of cores.

    Raises:
        ValueError: WRT_COMPILE_JOBS is not a whole number from 1 to 64.
    """
    text = os.environ.get(VARIABLE, "").strip()
    if not text:
        return min(available_cores(), MAX_JOBS)
    if not text.isdigit() or not 1 <= int(text) <= MAX_JOBS:
        raise ValueError(f"{VARIABLE} is {text!r}; set it to a whole number from 1 to {MAX_JOBS}")
    return int(text)


def expect(modules: Iterable[wp.Module], device: wp.Device, block_dim: int) -> list[Future[None]]:
    """Begins to compile modules that are neither loaded nor in the kernel cache, and does not wait for them.

    Returns:
        What is still to be compiled of them.

    Raises:
        NotCompiledError: inside `without_compiling`, something is.
    """
    if not device.is_cpu:
        return []
    begun, found = [], []
    with _lock:
        for module in dict.fromkeys(modules):
            key = module, device.alias, block_dim
            if key not in _pending:
                if needs_no_compiling(module, device, block_dim):
                    continue
                if not _compiles.get():
                    raise NotCompiledError(f"a module of kernels is not compiled: {module.name}")
                begun.append(key)
                _pending[key] = Future()
            found.append(_pending[key])
    if begun:
        compile_progress.add(len(begun))
        for key in begun:
            _begin(key)
    return found


def needs_no_compiling(module: wp.Module, device: wp.Device, block_dim: int) -> bool:
    """Whether the kernel cache has a module, or it was shipped."""
    return is_compiled(module, device, block_dim) or shipped_kernels.find(module, device, block_dim) is not None


def expect_header(device: wp.Device) -> None:
    """Begins to precompile Warp's header, for which all modules wait, before it is known which modules there will be: where a
    kernel cache is new and no kernels are shipped."""
    key = _no_kernels(), device.alias, shipped_kernels.CPU_BLOCK
    with _lock:
        if device.is_cpu and key not in _pending and is_cache_new() and not shipped_kernels.targets():
            _pending[key] = Future()
            _begin(key)


def _no_kernels() -> wp.Module:
    """The Warp module of this file, which only has the options of others."""
    return wp.get_module(__name__)


def load_modules(modules: Iterable[wp.Module], device: wp.Device, block_dim: int) -> None:
    """Loads modules, once what the kernel cache does not have of them is compiled.

    Raises:
        Exception: whatever Warp raises for a module that cannot be compiled.
        RuntimeError: the interpreter is exiting, and this is not its main thread.
    """
    modules = list(dict.fromkeys(modules))
    try:
        for job in expect(modules, device, block_dim):
            while not job.done():
                wait([job], TURN_SECONDS)
    except KeyboardInterrupt:
        _drop()
        raise
    if _is_exiting and threading.current_thread() is not threading.main_thread():
        raise RuntimeError("no kernel is compiled any more: the interpreter is exiting")
    with _lock:
        for module in modules:
            is_loaded = is_compiled(module, device, block_dim) and load_compiled(module, device, block_dim)
            if not is_loaded and not shipped_kernels.load(module, device, block_dim):
                load_module(module, device, block_dim)
            _loaded[module, device.alias] = None


def loaded_modules(device: wp.Device) -> list[wp.Module]:
    """The modules that this process has loaded on a device by `load_modules`, in the order of their first use."""
    with _lock:
        return [module for module, alias in _loaded if alias == device.alias]


def _begin(key: Key) -> None:
    """Gives a module to the threads that compile; if there can be none, the caller compiles it later."""
    with _lock:
        job = _pending[key]
        if _is_exiting:  # a new thread would take what ends an old one, for which `_close` would wait for ever
            _end(key, job)
            return
        if len(_threads) < compile_jobs():
            if not _threads:
                _close_at_exit()
            thread = threading.Thread(target=_serve, args=[_queue], name=f"wrt-compile-{len(_threads)}", daemon=True)
            try:
                thread.start()
                _threads.append(thread)
            except RuntimeError:  # no more threads, or the interpreter is exiting
                if not _threads:
                    _end(key, job)
                    return
        _queue.put((key, job))


def _serve(queue: SimpleQueue[tuple[Key, Future[None]] | None]) -> None:
    """Compiles modules until there is a None in the queue."""
    while (work := queue.get()) is not None:
        (module, alias, block_dim), job = work
        # An error is left to the caller, who loads the module afterwards and meets the same one.
        with suppress(BaseException):
            if job.set_running_or_notify_cancel():
                leave_full_disk()
                with shared_header(module, block_dim):
                    if module is not _no_kernels():
                        module.load(wp.get_device(alias), block_dim=block_dim)
        _end(work[0], job)
        del work, module, job  # a module lives no longer for having been compiled


def _close_at_exit() -> None:
    """Has `_close` run before the interpreter removes temporary folders, in which compilers write."""
    finalize(_queue, lambda: None)  # what weakref and Warp do at the exit is registered now, so it runs later
    atexit.unregister(_close)
    atexit.register(_close)


def _close() -> None:
    """Drops modules that are no longer needed, and waits for the modules under way, as their threads must not outlive Warp."""
    global _is_exiting
    with _lock:
        _is_exiting = True
        threads = [*_threads]
        _threads.clear()
    _drop()
    for _ in threads:
        _queue.put(None)
    for thread in threads:
        thread.join()


def _end(key: Key, job: Future[None]) -> None:
    with _lock:
        if _pending.get(key) is job:
            del _pending[key]
    if key[0] is not _no_kernels():
        compile_progress.finish()
    if not job.cancelled():
        job.set_result(None)


def _drop() -> None:
    """Drops the modules that no thread has begun."""
    with _lock:
        for key, job in [*_pending.items()]:
            if job.cancel():
                del _pending[key]


def _forget() -> None:
    """A forked child has none of the threads."""
    global _lock, _queue, _is_exiting
    _lock, _queue, _is_exiting = threading.RLock(), SimpleQueue(), False
    _threads.clear()
    _pending.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
