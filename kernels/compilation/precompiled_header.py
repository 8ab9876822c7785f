"""Warp's precompiled header, kept beside the compiled kernels: threads and processes that share a kernel cache share it.

Clang parses Warp's header for 2 s of a core before the first module that a thread compiles. Warp keeps the result for the
thread, in a temporary folder, and no other finds it. Here a thread that is about to compile gets a copy of what any other has
left in the kernel cache, or of what a thread of this process is just making, and leaves its own there:

    KERNEL CACHE/precompiled_headers/KEY/builtin_bd1_tis_o2_f....pch

**What it leaves out.** Warp defines `WP_NO_BFLOAT16` before its header in modules without this type, but not when it
precompiles the header. Here it is made without the type, in two thirds of the time. Clang refuses such a header for a module
that has the type, and Warp then compiles that module without one; no kernel of wrt has it.

**When one fits.** The key is a hash of all that Clang compares: Warp's version, its compiler, the system, the CPU where code is
for this CPU, the flags, and the place, size and time of change of each header. The name, which Warp gives, has the level of
optimisation and other options. What changes leads to another key; of keys that are no longer used, few stay (`KEYS`).

**Nothing depends on it.** A file begins with a checksum of the rest, and appears in place by renaming; one that is damaged, or
that Clang refuses, is removed. On a read-only file system, a full disk, or with a Warp that keeps headers elsewhere, each
thread parses the header for itself, as ever.
"""

import hashlib
import os
import shutil
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import warp as wp

FOLDER = "precompiled_headers"

KEYS = 8
"""Most keys that a kernel cache keeps: those used last."""

TURN_SECONDS = 0.02
"""Time between two looks at whether another thread has made a header."""

LEFT_OUT = "-DWP_NO_BFLOAT16"
"""Warp's name for a header without this type."""

_lock = threading.Lock()
_makers: dict[str, tuple[Path, threading.Event]] = {}
"""By key, the folder of the thread that is making a header, and what is set when it has compiled its module."""

_without: set[str] = set()
"""Keys for which a thread has compiled a module and made no header: no thread waits for another."""


@contextmanager
def shared_header(module: wp.Module, block_dim: int) -> Iterator[None]:
    """Has this thread compile a module, inside the `with` block, with a header that others made, and keeps its own for them.

    Args:
        module: what is compiled, of which Warp has a hash.
        block_dim: number of threads of a block.
    """
    key, own = _key_for(module), _folder_of_thread()
    if key is None or own is None:
        yield
        return
    place = Path(wp.config.kernel_cache_dir, FOLDER, key)
    taken = _take(place, own)
    is_maker = not _names_in(own) and _wait_for_maker(key, own)
    before = _names_in(own)
    try:
        if is_maker:
            _make(module, block_dim, own)
        yield
        _keep(place, own, before)
        for name in taken - _names_in(own):  # Warp removes one that Clang refused
            with suppress(OSError):
                os.unlink(place / name)
    finally:
        if is_maker:
            with _lock:
                _makers.pop(key)[1].set()
                if not _names_in(own):
                    _without.add(key)


def is_cache_new() -> bool:
    """Whether the kernel cache has no header yet, of any key, and one would be kept."""
    cache = Path(wp.config.kernel_cache_dir)
    has_any = any((cache / FOLDER).glob("*/*.pch"))
    return bool(wp.config.use_precompiled_headers) and not has_any and os.access(cache, os.W_OK)


def _key_for(module: wp.Module) -> str | None:
    """The folder's name of headers for a module; None where none is made."""
    if not isinstance(module, wp.Module) or not wp.config.use_precompiled_headers:
        return None
    flags = module.options.get("cpu_compiler_flags")
    try:
        return _key(wp.config.cpu_compiler_flags if flags is None else flags)
    except (OSError, RuntimeError):
        return None


@cache
def _key(flags: str | None) -> str:
    """Hash of flags, and of what Clang compares beyond them.

    Raises:
        OSError: Warp's headers cannot be read.
        RuntimeError: Warp has no compiler for the CPU.
    """
    machine = wp.get_cpu_kernel_cache_key(cpu_compiler_flags=flags)
    return hashlib.sha256(f"{machine}\n{flags}\n{_headers()}".encode()).hexdigest()[:16]


@cache
def _headers() -> str:
    """Place, size and time of change of each header of Warp: Clang refuses a precompiled header when one of these differs."""
    place = Path(wp.__path__[0], "native")
    files = sorted(path for path in place.rglob("*.h"))
    return "\n".join(f"{path} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files)


def _folder_of_thread() -> Path | None:
    """Where Warp keeps headers of the thread that asks; None if that is not known."""
    try:
        folder = wp._src.context.runtime.get_clang_pch_dir()
    except (AttributeError, OSError):
        return None
    return folder and Path(folder)


def _names_in(folder: Path) -> set[str]:
    """The headers of a folder; none if it cannot be read."""
    try:
        return {name for name in os.listdir(folder) if name.endswith(".pch")}
    except OSError:
        return set()


def _take(place: Path, own: Path) -> set[str]:
    """Copies headers from the kernel cache to the thread's folder, where these are missing; returns their names."""
    taken = set()
    for name in _names_in(place) - _names_in(own):
        with suppress(OSError):
            checksum, _, header = (place / name).read_bytes().partition(b"\n")
            if checksum == _checksum(header):
                _write(own / name, header)
                taken.add(name)
                os.utime(place)
            else:
                os.unlink(place / name)
    return taken


def _wait_for_maker(key: str, own: Path) -> bool:
    """Takes the header that another thread of this process is making; True if there is none, and this thread is to make it."""
    with _lock:
        if key in _without:
            return False
        if key not in _makers:
            _makers[key] = own, threading.Event()
            return True
        folder, has_ended = _makers[key]
    while not has_ended.wait(TURN_SECONDS) and not _names_in(folder):
        pass
    for name in _names_in(folder):
        with suppress(OSError):
            shutil.copyfile(folder / name, own / name)
    return False


def _make(module: wp.Module, block_dim: int, own: Path) -> None:
    """Makes the header of a module, less what `LEFT_OUT` leaves out, under the name by which Warp looks for it in the thread's
    folder. If that fails, Warp makes its own later."""
    with suppress(Exception), TemporaryDirectory(dir=own) as folder:
        options = module.resolved_options.get(block_dim) or module.resolve_options(wp.config, block_dim=block_dim)
        flags, level = options["cpu_compiler_flags"], options["optimization_level"]
        empty = Path(folder, "empty.cpp")
        empty.touch()
        wp._src.build.build_cpu(
            f"{folder}/empty.o",
            str(empty),
            mode=options["mode"],
            verify_fp=options["verify_fp"],
            extra_flags=f"{flags} {LEFT_OUT}",
            optimization_level=2 if level is None else level,
            use_precompiled_headers=True,
            pch_dir=folder,
            block_dim=options["block_dim"],
            enable_tiles_in_stack_memory=options["enable_tiles_in_stack_memory"],
            extra_include_dirs=options["extra_cpu_include_dirs"],
        )
        (name,) = _names_in(Path(folder))
        os.replace(f"{folder}/{name}", own / name.replace(_hash_of(f"{flags} {LEFT_OUT}"), _hash_of(flags)))


def _hash_of(flags: str) -> str:
    """The part of a header's name that Warp's compiler derives from its flags: FNV-1a of 64 bits."""
    value = 14695981039346656037
    for byte in b"".join(flag.encode() + b"\0" for flag in flags.split()):
        value = (value ^ byte) * 1099511628211 % 2**64
    return f"{value:016x}"


def _keep(place: Path, own: Path, before: set[str]) -> None:
    """Copies headers that this thread has made to the kernel cache."""
    for name in _names_in(own) - before - _names_in(place):
        with suppress(OSError):
            os.makedirs(place, exist_ok=True)
            header = (own / name).read_bytes()
            _write(place / name, _checksum(header) + b"\n" + header)
            _remove_old(place.parent)


def _checksum(header: bytes) -> bytes:
    return f"{zlib.crc32(header):08x} {len(header)}".encode()


def _write(path: Path, content: bytes) -> None:
    """Writes a file that appears whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    beside = path.with_name(f"{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        beside.write_bytes(content)
        os.replace(beside, path)
    except OSError:
        with suppress(OSError):
            os.unlink(beside)
        raise


def _remove_old(folder: Path) -> None:
    """Removes the headers of all keys but those used last."""
    used = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)
    for path in used[:-KEYS]:
        shutil.rmtree(path, ignore_errors=True)


def _forget() -> None:
    """A forked child has none of the threads."""
    global _lock
    _lock = threading.Lock()
    _makers.clear()
    _without.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
