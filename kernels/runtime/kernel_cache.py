"""The folder of compiled kernels (the kernel cache): Warp's folder, or a temporary one if that is not writable.

Warp keeps compiled kernels in a folder of the user or in the folder that WARP_CACHE_PATH names. On a read-only file system or a
full disk it fails with the system's error about some file. This module finds the cause, warns on stderr, and continues with a
temporary folder, which the process removes at exit.

The first call of a query compiles its kernels, which takes seconds. A user at a terminal is told so beforehand.
"""

import atexit
import os
import shutil
import sys
import tempfile
from functools import cache

import warp as wp

ROOM = 1 << 20
"""Bytes that must fit into the folder: the size of a large kernel."""


def init_warp() -> None:
    """Calls `wp.init`; switches to a temporary folder if the kernel cache is not writable."""
    try:
        wp.init()
    except OSError as error:
        use_temporary_folder(error)
        wp.init()


def load_module(module: wp.Module, device: wp.Device, block_dim: int) -> None:
    """Compiles a module, or takes it from the kernel cache, and loads it.

    If the kernel cache is not writable, it switches to a temporary folder.
    """
    if sys.stderr is not None and sys.stderr.isatty() and not is_compiled(module, block_dim):
        announce_compilation()
    try:
        module.load(device, block_dim=block_dim)
    except Exception:
        error = find_fault(wp.config.kernel_cache_dir)
        if error is None:
            raise
        use_temporary_folder(error)
        module.mark_modified()  # clears Warp's record of the failed build
        module.load(device, block_dim=block_dim)


def is_compiled(module: wp.Module, block_dim: int) -> bool:
    """Whether the kernel cache has a module."""
    return os.path.isdir(os.path.join(wp.config.kernel_cache_dir, module.get_module_identifier(block_dim)))


@cache
def announce_compilation() -> None:
    """Says on stderr, once per process, that kernels are being compiled."""
    print(
        "wrt: compiling kernels for this machine, which takes some seconds each; later runs take them from "
        f"'{wp.config.kernel_cache_dir}'.",
        file=sys.stderr,
        flush=True,
    )


def find_fault(folder: str) -> OSError | None:
    """Returns the error that writing to a folder raises; None if the folder is writable."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return None


def use_temporary_folder(error: OSError) -> None:
    """Makes this process use a temporary kernel cache from now on, and says so on stderr."""
    folder, owner = tempfile.mkdtemp(prefix="wrt-kernels-"), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a forked child must not remove its parent's folder
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    print(
        f"wrt: compiled kernels cannot be kept ({error}); this process uses '{folder}' and compiles them for itself alone. "
        "Set WARP_CACHE_PATH to a folder with room that can be written to.",
        file=sys.stderr,
    )
    wp.config.kernel_cache_dir = folder
