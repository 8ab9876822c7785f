"""The folder of compiled kernels (the kernel cache): Warp's folder, or a temporary one if that is not writable.

Warp keeps compiled kernels in a folder of the user or in the folder that WARP_CACHE_PATH names. On a read-only file system it
fails with the system's error about some file, and on a full disk LLVM ends the process. This module finds the cause, warns on
stderr, and continues with a temporary folder, which the process removes at exit.

Several processes can share the folder: Warp compiles into a folder of its own and renames it into place. What was damaged
there is removed (`wrt.kernels.compilation.damaged_kernels`), so that it is compiled again.
"""

import atexit
import errno
import os
import shutil
import sys
import tempfile
from pathlib import Path

import warp as wp

from wrt.kernels.compilation import damaged_kernels, target

ROOM = 1 << 22
"""Bytes that must fit into the folder: the size of a few large kernels, which are compiled at the same time."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a file that has no room."""


def init_warp() -> None:
    """Calls `wp.init`; switches to a temporary folder if the kernel cache is not writable."""
    if target.has_started():
        return
    with target.without_driver_message():
        try:
            wp.init()
        except OSError as error:
            use_temporary_folder(error)
            wp.init()


def load_compiled(module: wp.Module, device: wp.Device, block_dim: int) -> bool:
    """Loads a module that the kernel cache has; False if it cannot be loaded, and has been removed."""
    code, about = cached_files(module, device, block_dim)
    try:
        module.load(device, block_dim=block_dim)
    except Exception as error:
        _remove(code.parent, error)
        return False
    damaged_kernels.seal(code, about)
    return True


def load_module(module: wp.Module, device: wp.Device, block_dim: int) -> None:
    """Compiles a module and loads it.

    If the kernel cache is not writable, it switches to a temporary folder.

    Raises:
        Exception: whatever Warp raises for a module that cannot be compiled.
        OSError: the temporary folder has no room either.
    """
    leave_full_disk()
    try:
        module.load(device, block_dim=block_dim)
    except Exception:
        error = find_fault(wp.config.kernel_cache_dir)
        if error is None:
            raise
        use_temporary_folder(error)
        module.mark_modified()  # clears Warp's record of the failed build
        module.load(device, block_dim=block_dim)


def cached_files(module: wp.Module, device: wp.Device, block_dim: int) -> tuple[Path, Path]:
    """Where the kernel cache has, or would have, the code of a module and the data about it."""
    folder = Path(wp.config.kernel_cache_dir, module.get_module_identifier(block_dim))
    code = module._get_compile_output_name(device, block_dim=block_dim)
    return folder / code, folder / module._get_meta_name(block_dim=block_dim)


def is_compiled(module: wp.Module, device: wp.Device, block_dim: int) -> bool:
    """Whether the kernel cache has a module. One of which there is only a part, or that has changed since it was sealed, is
    removed."""
    code, about = cached_files(module, device, block_dim)
    if os.path.exists(code) and os.path.exists(about):
        damage = damaged_kernels.damage_of(code, about)
    elif os.path.lexists(code):
        damage = f"'{about.name}' is missing"
    else:
        is_usable = not os.path.lexists(code.parent) or (code.parent.is_dir() and os.access(code.parent, os.R_OK | os.X_OK))
        if is_usable:
            return False
        damage = "no folder that can be read"
    if damage is None:
        return True
    _remove(code.parent, damage)
    return False


def _remove(folder: Path, reason: object) -> None:
    """Removes a damaged module; if that is not permitted, this process uses another cache."""
    try:
        damaged_kernels.remove(folder, reason)
    except OSError as error:
        use_temporary_folder(error)


def folder_size() -> tuple[int, int]:
    """Modules in the kernel cache, and bytes of all its files."""
    modules = size = 0
    for folder, _, files in os.walk(wp.config.kernel_cache_dir):
        modules += any(name.endswith(".meta") for name in files)
        for name in files:
            try:
                size += os.path.getsize(os.path.join(folder, name))
            except OSError:  # another process has just renamed it
                continue
    return modules, size


def leave_full_disk() -> None:
    """Switches to a temporary folder if the kernel cache has no room: where LLVM cannot write, it ends the process.

    Raises:
        OSError: the temporary folder has no room either.
    """
    folder = wp.config.kernel_cache_dir
    error = find_fault(folder, wait=False)
    if error is None or error.errno not in FULL:  # other errors are raised by Python, for `load_module`
        return
    if folder == wp.config.kernel_cache_dir:  # else another thread has left it
        use_temporary_folder(error)
    error = find_fault(wp.config.kernel_cache_dir, wait=False)
    if error is not None:
        raise OSError(error.errno, error.strerror, wp.config.kernel_cache_dir)


def find_fault(folder: str, wait: bool = True) -> OSError | None:
    """Returns the error that writing to a folder raises; None if the folder is writable.

    Args:
        folder: to try.
        wait: until the bytes are on the disk, which takes some milliseconds.
    """
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(ROOM))
            file.flush()
            if wait:
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
