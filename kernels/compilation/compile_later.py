"""Kernels that make calls faster and are not needed: compiled by processes of their own, while calls do without.

A thread that runs Clang cannot be stopped, and the interpreter would wait for it at its exit. So such a kernel is compiled by
another process, of the lowest priority, into the same kernel cache. It goes on when this process ends, and the next one finds
the kernel. Warp renames a finished folder into place: a process that is killed leaves nothing that another would use.

It is a process group of its own, so that Ctrl-C is not for it, but in the session of the caller: where Linux shares cores out
among sessions ("autogroup"), a process of another session gets as much time as all of this one, whatever its priority.

That process makes the kernel by the same factory and compiles it if its module has the same hash, so nothing is compiled for a
program whose flags or files it does not have.

WRT_COMPILE_LATER=0 leaves no kernel for later. Where Python is embedded in another program, which cannot be started as an
interpreter, none is left either.
"""

from __future__ import annotations

import atexit
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import warp as wp

from wrt.kernels.compilation import compile_progress
from wrt.kernels.compilation.kernel_cache import init_warp
from wrt.kernels.compilation.module_compiler import compile_jobs, load_modules
from wrt.kernels.compilation.shipped_kernels import CPU_BLOCK

VARIABLE = "WRT_COMPILE_LATER"

BEGIN_SECONDS = 0.05
"""Seconds of calls without a kernel before it is compiled: what takes less gains nothing that a user would notice."""

PATIENCE_SECONDS = 8.0
"""Seconds of calls without a kernel after which they wait for it, twice as long as most take to compile: on a machine that is
busy, a process of the lowest priority may have no time at all."""

LOWEST_PRIORITY = 19

PROGRAM = """import os, sys
if hasattr(os, "nice"): os.setpgid(0, 0), os.nice({priority})
sys.path[:] = {path!r}
from wrt.kernels.compilation.compile_later import serve
serve()
"""
"""What the processes run: it takes its priority before its imports."""

_lock = threading.Lock()
_missing: dict[wp.Module, MissingKernel] = {}
_processes: list[subprocess.Popen[bytes]] = []


class MissingKernel:
    """A kernel that calls do without.

    Args:
        factory: makes it of `config`; both can be pickled.
        config: its configuration.
        kernel: the same.

    Attributes:
        spent: seconds of calls without it.
    """

    def __init__(self, factory: Callable[[Any], wp.Kernel], config: Any, kernel: wp.Kernel) -> None:
        self._told = factory, config
        self._module = kernel.module
        self._process: subprocess.Popen[bytes] | None = None
        self.spent = 0.0

    def spend(self, seconds: float) -> bool:
        """Notes what a call without the kernel took; whether the next one is to have it, as it is compiled, cannot be compiled
        later, or has been missed for so long that waiting for it costs no more."""
        if not _lock.acquire(blocking=False):  # another thread, or what this signal handler interrupts, notes something
            return False
        try:
            self.spent += seconds
            if self._process is not None and self._process.poll() is not None:
                return True
            if self.spent >= PATIENCE_SECONDS:
                self._stop()
                return True
            return self._process is None and self.spent >= BEGIN_SECONDS and not self._begin()
        finally:
            _lock.release()

    def _begin(self) -> bool:
        """Begins to compile it, unless as many processes do as may compile at a time; False if that is not possible."""
        _processes[:] = [process for process in _processes if process.poll() is None]
        if len(_processes) >= compile_jobs():
            return True
        identifier = self._module.get_module_identifier(CPU_BLOCK)
        settings = os.path.abspath(wp.config.kernel_cache_dir), wp.config.cpu_compiler_flags, identifier
        try:
            told = pickle.dumps((*settings, pickle.dumps(self._told)))
            self._process = _start(told)
        except (OSError, pickle.PicklingError, AttributeError, TypeError):
            return False
        _processes.append(self._process)
        return True

    def _stop(self) -> None:
        if self._process is not None:
            end(self._process)


def missing_kernel(factory: Callable[[Any], wp.Kernel], config: Any, kernel: wp.Kernel) -> MissingKernel:
    """What is known of a kernel that is not compiled; arguments as in the class."""
    return _missing.setdefault(kernel.module, MissingKernel(factory, config, kernel))


def is_possible() -> bool:
    """Whether kernels can be compiled later.

    Raises:
        ValueError: WRT_COMPILE_LATER is neither 0 nor 1.
    """
    text = os.environ.get(VARIABLE, "").strip()
    if text not in ("", "0", "1"):
        raise ValueError(f"{VARIABLE} is {text!r}; set it to 0 (wait for all kernels) or 1 (the default)")
    name = os.path.basename(sys.executable or "").lower()
    return text != "0" and name.startswith("python") and not hasattr(sys, "frozen")


def _start(told: bytes) -> subprocess.Popen[bytes]:
    """A process that compiles what it is told.

    Raises:
        OSError: it cannot be started.
    """
    program = PROGRAM.format(path=[os.path.abspath(place) for place in sys.path], priority=LOWEST_PRIORITY)
    options: dict[str, Any] = {}
    if sys.platform == "win32":
        options = {"creationflags": subprocess.IDLE_PRIORITY_CLASS | subprocess.CREATE_NO_WINDOW}
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=tempfile.gettempdir(),  # keeps no folder of the caller in use
        **options,
    )
    assert process.stdin is not None
    with suppress(OSError), process.stdin:  # one that has ended already says so by its result
        process.stdin.write(told)
    if len(_processes) == 0:
        atexit.unregister(_leave)
        atexit.register(_leave)
    return process


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a process, and waits until it has."""
    process.kill()
    process.wait()


def stop() -> None:
    """Ends all processes that compile for this one: whoever removes the kernel cache calls this before."""
    for process in _processes:
        end(process)
    _processes.clear()


def serve() -> None:
    """Compiles a kernel, as told on stdin: what the processes do."""
    compile_progress.show_compiling(False)
    folder, flags, identifier, kernel = pickle.load(sys.stdin.buffer)
    wp.config.log_level, wp.config.cpu_compiler_flags = wp.LOG_ERROR, flags
    init_warp()
    wp.config.kernel_cache_dir = folder  # Warp, as it starts, adds its version to what it finds there
    factory, config = pickle.loads(kernel)  # imports the factory's module
    module = factory(config).module
    if module.get_module_identifier(CPU_BLOCK) == identifier:
        load_modules([module], wp.get_device("cpu"), CPU_BLOCK)


def _leave() -> None:
    """At the exit: the processes go on, of which Python would warn."""
    for process in _processes:
        if process.returncode is None:
            process.returncode = 0


def _forget() -> None:
    """A forked child has no processes."""
    global _lock
    _lock = threading.Lock()
    _missing.clear()
    _processes.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
