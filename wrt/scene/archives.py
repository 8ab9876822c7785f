"""Files of named arrays (.npz archives) from untrusted sources: written completely or not at all, and checked while read.

What an archive declares is compared with its size before memory is allocated: a header of a few bytes may declare an array
of terabytes. A **checksum** over all arrays detects accidental changes. It is not a signature: anyone who forges a file can
compute it too.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import struct
import threading
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np

from wrt.atomic_files import replaced

CHECKSUM = "checksum"
"""Name of the array that holds the checksum."""

ALIGNED = 64
"""Bytes at whose multiples the elements of an array begin in a file, so that kernels can read them where they are."""

LOCAL_HEADER, ZIP64, EXTRA_HEADER = 30, 20, 4
"""Bytes before the name of a member of an archive, of the field with its sizes, and before the contents of other fields."""

PADDING = 0xD935
"""Identifier of a field that aligns the contents of a member, as Android's archives have it."""

UNREADABLE = (ValueError, TypeError, KeyError, RuntimeError, OSError, EOFError, zipfile.BadZipFile, zlib.error)
"""Exceptions that reading a damaged archive may raise."""

_parsing = threading.Lock()
"""Held while the header of an array is parsed. CPython 3.11 may raise a SystemError when two threads parse literals at the
same time (CPython issue 106905).
"""


@contextmanager
def checked_reading(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Inside the `with` block, a file is read: what any fault of it raises becomes one error with a remedy.

    Raises:
        PermissionError: the file may not be read.
        ValueError: it is not what it should be, or it is damaged.
    """
    try:
        yield
    except PermissionError:
        raise
    except UNREADABLE as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"'{path}' is not {what}, or it is damaged ({reason}); {remedy}") from error


def check_format(found: Any, known: int) -> None:
    """Refuses a file whose format this version does not read.

    Raises:
        ValueError: it is another format.
    """
    if found != known:
        raise ValueError(f"it has format {found}, and this version of wrt reads format {known}")


def checksum(arrays: Mapping[str, np.ndarray]) -> str:
    """64 hexadecimal digits: SHA-256 of the names, types, shapes and bytes of all arrays but `CHECKSUM`."""
    state = hashlib.sha256()
    for name in sorted(arrays.keys() - {CHECKSUM}):
        array = np.asarray(arrays[name])
        state.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        state.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8))  # type: ignore[arg-type]
    return state.hexdigest()


def write_archive(path: Path, arrays: Mapping[str, np.ndarray], in_one_piece: bool = False) -> None:
    """Writes arrays and their checksum to a file.

    Args:
        path: of the file.
        arrays: by name.
        in_one_piece: whether the file is put together in memory and written by one call: Linux then caches it in large pages,
            which are mapped faster.

    Raises:
        OSError: the file cannot be written.
        ValueError: `path` exists and is not a regular file.
    """
    with replaced(path) as file:
        if in_one_piece:
            content = io.BytesIO()
            write_members(content, arrays)
            file.write(content.getbuffer())
        else:
            write_members(file, arrays)


def write_members(file: BinaryIO, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes the archive of arrays and their checksum."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in {**arrays, CHECKSUM: np.array(checksum(arrays))}.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            begin = file.tell() + LOCAL_HEADER + len(member.filename.encode()) + ZIP64 + EXTRA_HEADER
            missing = -begin % ALIGNED  # the header of an array ends at a multiple of 64 bytes from its begin
            member.extra = struct.pack("<HH", PADDING, missing) + bytes(missing)
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)


def read_archive(source: Path | BinaryIO) -> dict[str, np.ndarray]:
    """Reads the arrays of a file, given by its path or opened; nothing in it is executed. All are in C order.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is not an archive of plain arrays, or it has changed since it was written.
    """
    if isinstance(source, Path) and source.exists() and not source.is_file():
        raise ValueError("it is not a regular file")  # a pipe would be waited for
    if not zipfile.is_zipfile(source):
        raise ValueError("it is not a complete archive")
    size = source.stat().st_size if isinstance(source, Path) else os.fstat(source.fileno()).st_size
    with zipfile.ZipFile(source) as archive:
        members = archive.infolist()
        is_plain = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not is_plain or sum(member.file_size for member in members) > size:
            raise ValueError("its arrays are compressed, or larger than the file")
        arrays = {member.filename.removesuffix(".npy"): read_array(archive, member) for member in members}
    if len(arrays) != len(members):
        raise ValueError("two of its arrays have the same name")
    if CHECKSUM not in arrays or str(arrays.pop(CHECKSUM)) != checksum(arrays):
        raise ValueError("its checksum does not match its arrays")
    return arrays


def read_array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """An array whose declared size equals the number of its bytes.

    Raises:
        ValueError: the sizes differ, or the array holds Python objects.
    """
    with archive.open(member) as file:
        shape, is_fortran, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds Python objects")
        if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise ValueError(f"{member.filename} declares {shape} of {dtype}, which does not match its size")
        array = np.ndarray(shape, dtype, bytearray(file.read()), order="F" if is_fortran else "C")
        return array.copy(order="C") if is_fortran else array


def read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether the order is Fortran's, and type of the array that begins in a file; reads up to its elements.

    Raises:
        ValueError: no array begins there.
    """
    version = np.lib.format.read_magic(file)
    parse = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with _parsing:
        return parse(file)


class ArrayPlace(NamedTuple):
    """Where the elements of an array are in an archive.

    Attributes:
        offset: of the first byte in the file.
        shape, dtype: of the array.
        is_fortran: whether its first index changes fastest, and not the last one.
    """

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype
    is_fortran: bool

    @property
    def bytes(self) -> int:
        """Bytes of the elements."""
        return math.prod(self.shape) * self.dtype.itemsize


def array_places(source: Path | BinaryIO) -> dict[str, ArrayPlace]:
    """Where the arrays of an archive are, for reading them again once `read_archive` has checked them.

    Raises:
        OSError, ValueError: as `read_archive`.
    """
    places = {}
    with zipfile.ZipFile(source) as archive:
        file = archive.fp
        for member in archive.infolist():
            file.seek(member.header_offset + 26)  # the local header ends with the lengths of a name and of extra fields
            name, extra = struct.unpack("<HH", file.read(4))
            file.seek(name + extra, os.SEEK_CUR)
            shape, is_fortran, dtype = read_header(file)
            places[member.filename.removesuffix(".npy")] = ArrayPlace(file.tell(), shape, dtype, is_fortran)
    return places
