"""Where compiled kernels are kept: Warp's folder, or a temporary one if nothing can be written there.

Warp keeps what it compiles in a folder of the user's, or in the one that WARP_CACHE_PATH names. In a container with a read-only
file system, or on a full disk, it fails with whatever the system said about some file. Here, what went wrong is found out, and
this process goes on with a folder of its own, which it removes at its end.
"""

import atexit
import os
import shutil
import sys
import tempfile

import warp as wp

ROOM = 1 << 20
"""Bytes that must fit into the folder: those of a large kernel."""


def init_warp() -> None:
    """`wp.init`, wherever its folder may be."""
    try:
        wp.init()
    except OSError as error:
        use_temporary_folder(error)
        wp.init()


def load_module(module: wp.Module, device: wp.Device, block_dim: int) -> None:
    """Compiles a module, or takes what is compiled, and loads it."""
    try:
        module.load(device, block_dim=block_dim)
    except Exception:
        error = find_fault(wp.config.kernel_cache_dir)
        if error is None:
            raise
        use_temporary_folder(error)
        module.mark_modified()  # Warp remembers that it failed
        module.load(device, block_dim=block_dim)


def find_fault(folder: str) -> OSError | None:
    """Why nothing can be written to a folder; None if it can."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return None


def use_temporary_folder(error: OSError) -> None:
    """Makes this process keep its kernels in a folder of its own from now on, and says so."""
    folder, owner = tempfile.mkdtemp(prefix="wrt-kernels-"), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not at the end of a forked child
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    print(
        f"wrt: compiled kernels cannot be kept ({error}); this process uses '{folder}' and compiles them for itself alone. "
        "Set WARP_CACHE_PATH to a folder with room that can be written to.",
        file=sys.stderr,
    )
    wp.config.kernel_cache_dir = folder
