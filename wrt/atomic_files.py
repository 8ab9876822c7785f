"""Files and folders that appear whole or not at all: written beside the old file, which they then replace.

Whoever opens a file for writing empties it first. If the disk is full, the program is interrupted, or the data turn out to be
unfit, the old contents are lost and half of the new ones are there. Here a temporary file in the same folder takes the
contents; it has a random name that begins with a dot, and replaces the old file in one step of the file system. After an error
it is removed. Only a process that is killed, or a machine that stops, leaves it.

* **Symbolic links** stay: the file that they point to is replaced, or made. Hard links do not: other names keep the old one.
* The new file has the **permissions** of the old one, and its owner where the process may give files away. A file that the
  process may not write is not replaced. The folder must be writable, for the temporary file.
* Contents are **on the disk** (`fsync`) before they replace older ones, so that a machine that stops leaves one of the two. A
  file that replaces none is not waited for.
* **Pipes, devices and open descriptors** (a FIFO, /dev/stdout, /dev/fd/3) are never replaced by a file. Where a caller allows
  them, the contents are first made in a temporary file and then written through, also if standard output is a file.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

LONGEST = 30
"""Characters of a name that its temporary file repeats; more could make that name longer than file systems allow."""

OPEN_DESCRIPTOR = re.compile(r"(?:/dev|/proc/(?P<process>\d+)(?:/task/\d+)?)/fd/(?P<number>\d+)")
"""Path of an open file of a process, as the links /dev/stdout and /dev/fd lead to it."""

UNKNOWN_TO_DISK = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP)
"""Errors of file systems that cannot be told to write to the disk at once."""


@contextmanager
def replaced(path: str | Path, *, streams: bool = False) -> Iterator[BinaryIO]:
    """Opens a temporary file that replaces `path` when the `with` block ends; after an error, all is as before.

    A library that takes no open file may write to `file.name` instead.

    Args:
        path: of the file.
        streams: whether `path` may be a pipe, a device or an open descriptor, which then gets the contents at the end;
            opening a pipe waits for its reader.

    Raises:
        OSError: the file cannot be written; the error names `path`.
        ValueError: `path` is a folder, or anything else that this does not write.
    """
    target, descriptor = _destination(Path(path))
    found = _status(target) if descriptor is None else None
    if descriptor is None and (found is None or stat.S_ISREG(found.st_mode)):
        with _replacement(target, found, path) as file:
            yield file
        return
    if not streams or (found is not None and not (stat.S_ISFIFO(found.st_mode) or stat.S_ISCHR(found.st_mode))):
        raise ValueError(f"'{path}' is not a regular file, and only such files are replaced; choose another path")
    with named(path), tempfile.TemporaryDirectory() as folder:
        with open(Path(folder, "contents"), "wb") as file:
            yield file
        with open(file.name, "rb") as made, _opened(target, descriptor) as stream:
            shutil.copyfileobj(made, stream)


def write_text(path: str | Path, text: str) -> None:
    """Writes a file of text in UTF-8, or replaces it; pipes and open descriptors are written through. Raises as `replaced`."""
    with replaced(path, streams=True) as file:
        file.write(text.encode())


@contextmanager
def new_folder(path: str | Path) -> Iterator[Path]:
    """Where to make a folder, which becomes `path` when the `with` block ends; after an error, nothing is left.

    Args:
        path: of the folder; nothing may be there.

    Raises:
        OSError: something is there, or the folder cannot be made; the error names `path`.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, f"{os.strerror(errno.EEXIST)}; choose a new folder", str(path))
    around = _beside(path)
    try:
        with named(path, around):
            around.mkdir()
            yield around / path.name
            os.rename(around / path.name, path)
    finally:
        shutil.rmtree(around, ignore_errors=True)


@contextmanager
def _replacement(target: Path, old: os.stat_result | None, path: str | Path) -> Iterator[BinaryIO]:
    """A temporary file that replaces a regular file, or makes one, which the caller names `path`."""
    if old is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    temporary = _beside(target)
    try:
        with named(path, temporary):
            with open(temporary, "xb") as file:
                yield file
            if old is not None:
                _take_over(temporary, old)
                _to_disk(temporary)
            os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name[:LONGEST]}.{secrets.token_hex(8)}")


def _take_over(path: Path, old: os.stat_result) -> None:
    """Gives a file the owner, where that is allowed, and the permissions of another."""
    new = path.stat()
    if (new.st_uid, new.st_gid) != (old.st_uid, old.st_gid):
        with suppress(PermissionError):
            os.chown(path, old.st_uid, old.st_gid)
    os.chmod(path, stat.S_IMODE(old.st_mode))


def _to_disk(path: Path) -> None:
    """Waits until the contents of a file are on the disk, if the file system can say so."""
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in UNKNOWN_TO_DISK:
            raise
    finally:
        os.close(descriptor)


def _status(path: Path) -> os.stat_result | None:
    """What is at a path; None if nothing is."""
    try:
        return os.stat(path)
    except FileNotFoundError:
        return None


def _destination(path: Path) -> tuple[Path, int | None]:
    """Where the links of a path lead; and the number of the descriptor, if they lead to an open file of this process.

    Links are followed one by one: the path that the system gives for an open file may be that of another file by now.

    Raises:
        ValueError: they lead to an open file of another process.
    """
    for _ in range(40):  # as many links as Linux follows
        path = Path(os.path.realpath(path.parent), path.name)
        if found := OPEN_DESCRIPTOR.fullmatch(str(path)):
            if found["process"] not in (None, str(os.getpid())):
                raise ValueError(f"'{path}' is a file that another process has open; choose another path")
            return path, int(found["number"])
        if not path.is_symlink():
            return path, None
        path = path.parent / os.readlink(path)
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))


def _opened(path: Path, descriptor: int | None) -> BinaryIO:
    """A stream to write to, after all that was printed before."""
    if descriptor is None:
        return open(path, "wb")
    for printed in (sys.stdout, sys.stderr):
        if printed is not None:
            printed.flush()
    return os.fdopen(os.dup(descriptor), "wb")


@contextmanager
def named(path: str | Path, temporary: Path | None = None) -> Iterator[None]:
    """Errors of writing name the file or folder as the caller did, not the temporary one, nor what is in it."""
    try:
        yield
    except OSError as error:
        if type(error) is OSError and error.errno is None:  # of NumPy and Pillow, which tell how much was written, or nothing
            raise OSError(f"'{path}' cannot be written ({error}); is the disk full?") from error
        if error.errno is None:  # of reading
            raise
        if error.filename is None or temporary in (Path(error.filename), *Path(error.filename).parents):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
