"""Files of named arrays, .npz archives, that may come from anywhere: written whole or not at all, and read with suspicion.

What an archive declares is compared with what it holds before any memory is taken for it: a header of a few bytes may name an
array of terabytes. A **checksum** of all arrays tells accidents: a byte that has changed, or an array that was replaced. It is
no signature: whoever forges a file on purpose can compute it too.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import stat
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

CHECKSUM = "checksum"
"""Name of the array that holds it."""

_parsing = threading.Lock()
"""Held while the header of an array is parsed. Two threads that had Python's parser work at the same time got a SystemError,
once in some 9,000 files (CPython 3.11.7; its issue 106905)."""


def checksum(arrays: Mapping[str, np.ndarray]) -> str:
    """64 hexadecimal digits of the names, types, shapes and bytes of arrays; `CHECKSUM` itself does not count."""
    state = hashlib.sha256()
    for name in sorted(arrays.keys() - {CHECKSUM}):
        array = np.asarray(arrays[name])
        state.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        state.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8))
    return state.hexdigest()


def write_archive(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes arrays and their checksum to a file.

    Raises:
        OSError: it cannot be written.
        ValueError: `path` is something else than a regular file.
    """
    with replaced(path) as file:
        np.savez(file, **{**arrays, CHECKSUM: np.array(checksum(arrays))})


def read_archive(path: Path) -> dict[str, np.ndarray]:
    """Reads the arrays of a file; nothing in it is run.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no archive of plain arrays, or not what was written.
    """
    if not zipfile.is_zipfile(path):
        raise ValueError("it is no whole archive")
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > size:
            raise ValueError("its arrays are compressed, or larger than the file")
        arrays = {member.filename.removesuffix(".npy"): read_array(archive, member) for member in archive.infolist()}
    if CHECKSUM not in arrays or str(arrays.pop(CHECKSUM)) != checksum(arrays):
        raise ValueError("its checksum is not that of its arrays")
    return arrays


def read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """An array whose declared size is that of its bytes.

    Raises:
        ValueError: it is not, or the array holds Python objects.
    """
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with _parsing:
            shape, is_fortran, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds Python objects")
        if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise ValueError(f"{member.filename} declares {shape} of {dtype}, which is not what it holds")
        return np.ndarray(shape, dtype, bytearray(file.read()), order="F" if is_fortran else "C")


@contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of `path` when it is complete; if it does not come so far, nothing is left.

    A symbolic link stays, and what it points to is replaced. The new file has the permissions of the old one.

    Raises:
        OSError: the file cannot be written.
        ValueError: there is something else than a regular file: a folder, a device, a pipe.
    """
    target = Path(os.path.realpath(path))
    mode = target.stat().st_mode if target.exists() else None
    if mode is not None and not stat.S_ISREG(mode):
        raise ValueError(f"'{path}' is no regular file, and only such are replaced; choose another path")
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}")
    try:
        with open(temporary, "xb") as file:
            yield file
        if mode is not None:
            os.chmod(temporary, stat.S_IMODE(mode))
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
