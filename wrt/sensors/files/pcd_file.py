"""PCD files: a header of lines, and points as text, as rows of binary numbers, or as compressed columns.

A header lies as easily as it tells: everything that it says is compared with what follows, before memory is taken for it.
Compressed columns are LZF: a byte below 32 announces so many bytes and one more; others begin a copy of what came before, whose
length is in the upper three bits (7: a byte more follows), and whose distance is in the other five and the next byte.

References: pcl-pcd.
"""

from __future__ import annotations

import struct

import numpy as np

__all__ = ["read_pcd"]

MAX_HEADER = 1 << 16
"""Bytes of the file in which the header must end."""

MAX_NUMBERS = 1 << 12
"""Numbers of a point."""

KINDS = {"I": "i", "U": "u", "F": "f"}

PADDING = "_"
"""Name of fields without a meaning, of which there may be several."""


def read_pcd(data: bytes) -> np.ndarray:
    """The points of a file: (N,) structured array of its fields. One of several numbers has a shape.

    Raises:
        ValueError: it is no PCD file, is cut off, or its header does not fit what follows.
    """
    header, begin = _header(data)
    kind, count = _row(header), _count(header)
    form = header["DATA"][0].lower()
    if form == "ascii":
        table = _from_text(data[begin:], kind, count)
    elif form == "binary":
        _check_size(len(data) - begin, kind.itemsize * count)
        table = np.frombuffer(data, dtype=kind, count=count, offset=begin)
    elif form == "binary_compressed":
        table = _from_columns(data[begin:], kind, count)
    else:
        raise ValueError(f"its header says 'DATA {form[:40]}'; the forms are ascii, binary, binary_compressed")
    return table[[name for name in kind.names if not name.startswith(PADDING)]].copy()


Header = dict[str, list[str]]


def _header(data: bytes) -> tuple[Header, int]:
    """The words of each line of the header, and where the points begin."""
    found: Header = {}
    begin = 0
    while "DATA" not in found:
        end = data.find(b"\n", begin, MAX_HEADER)
        if end < 0:
            raise ValueError("its header has no line 'DATA'; is it a PCD file, and complete?")
        words = data[begin:end].decode("latin-1").split("#")[0].split()
        begin = end + 1
        if words:
            found[words[0].upper()] = words[1:]
    for name in ("FIELDS", "SIZE", "TYPE", "WIDTH", "DATA"):
        if not found.get(name):
            raise ValueError(f"its header has no line '{name}'")
    return found, begin


def _whole(words: list[str], name: str) -> list[int]:
    """The whole numbers of a line."""
    if not all(word.isascii() and word.isdigit() and len(word) < 19 for word in words):
        raise ValueError(f"its header has the line '{name} {' '.join(words)[:80]}', which are no whole numbers")
    return [int(word) for word in words]


def _row(header: Header) -> np.dtype:
    """The type of a point."""
    names, sizes = header["FIELDS"], _whole(header["SIZE"], "SIZE")
    counts = _whole(header.get("COUNT") or ["1"] * len(names), "COUNT")
    if not len(names) == len(sizes) == len(header["TYPE"]) == len(counts):
        raise ValueError("the lines FIELDS, SIZE, TYPE and COUNT of its header are of different lengths")
    if not all(counts):
        raise ValueError("a field has no numbers: its header has a COUNT of 0")
    if sum(counts) > MAX_NUMBERS:
        raise ValueError(f"a point has {sum(counts)} numbers; {MAX_NUMBERS} are the most that are read")
    fields: list[tuple] = []
    for place, (name, size, letter, count) in enumerate(zip(names, sizes, header["TYPE"], counts, strict=True)):
        kind = f"<{KINDS.get(letter.upper(), 'V')}{size}"
        if kind[1:] not in ("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"):
            raise ValueError(f"the field {name[:40]!r} is of TYPE {letter[:8]} and SIZE {size}, which is no type of numbers")
        own = f"{PADDING}{place}" if name.startswith(PADDING) else name
        fields.append((own, kind) if count == 1 else (own, kind, (count,)))
    if len({field[0] for field in fields}) < len(fields):
        raise ValueError(f"two fields have the same name: {' '.join(names)[:80]}")
    return np.dtype(fields)


def _count(header: Header) -> int:
    """Number of points."""
    width, height = _whole(header["WIDTH"][:1], "WIDTH"), _whole(header.get("HEIGHT", ["1"])[:1], "HEIGHT")
    points = _whole(header.get("POINTS", [])[:1], "POINTS")
    count = width[0] * height[0] if height else width[0]
    if points and points[0] != count:
        raise ValueError(f"its header says POINTS {points[0]}, but WIDTH and HEIGHT of {count} points")
    return count


def _check_size(found: int, needed: int) -> None:
    """Refuses a file that is shorter than its header says."""
    if found < needed:
        raise ValueError(f"its points need {needed} bytes, but {found} follow the header; is the file complete?")


def _from_text(data: bytes, kind: np.dtype, count: int) -> np.ndarray:
    """Points of text: a line each."""
    lines = [line for line in data.splitlines() if line.strip()]
    numbers = sum(int(np.prod(kind[name].shape, dtype=int)) for name in kind.names)
    if len(lines) < count:
        raise ValueError(f"its header announces {count} points, but {len(lines)} lines follow; is the file complete?")
    rows = [line.split() for line in lines[:count]]
    wrong = next((place for place, row in enumerate(rows) if len(row) != numbers), None)
    if wrong is not None:
        raise ValueError(f"line {wrong + 1} of its points has {len(rows[wrong])} numbers, not {numbers}")
    table, column = np.empty(count, dtype=kind), 0
    for name in kind.names:
        size = int(np.prod(kind[name].shape, dtype=int))
        words, base = [row[column : column + size] for row in rows], kind[name].base
        try:
            values = np.array(words, dtype="S").astype(base) if base.kind == "f" else _integers(words, base)
        except (ValueError, OverflowError) as error:
            raise ValueError(f"the field {name!r} holds what is no {base.name}: {error}") from None
        table[name] = values.reshape(count, *kind[name].shape)
        column += size
    return table


def _integers(words: list[list[bytes]], kind: np.dtype) -> np.ndarray:
    """Whole numbers of text, each within its type."""
    numbers, limits = [[int(word) for word in row] for row in words], np.iinfo(kind)
    wrong = next((number for row in numbers for number in row if not limits.min <= number <= limits.max), None)
    if wrong is not None:
        raise OverflowError(f"{wrong} is not from {limits.min} to {limits.max}")
    return np.array(numbers, dtype=kind)


def _from_columns(data: bytes, kind: np.dtype, count: int) -> np.ndarray:
    """Points of compressed columns, one field after the other."""
    _check_size(len(data), 8)
    packed, size = struct.unpack("<II", data[:8])
    _check_size(len(data) - 8, packed)
    if size != kind.itemsize * count:
        raise ValueError(f"its compressed points are {size} bytes, but its header announces {kind.itemsize * count}")
    columns, table, begin = decompress(data[8 : 8 + packed], size), np.empty(count, dtype=kind), 0
    for name in kind.names:
        own = kind[name]
        values = np.frombuffer(columns, dtype=own.base, count=count * own.itemsize // own.base.itemsize, offset=begin)
        table[name] = values.reshape(count, *own.shape)
        begin += count * own.itemsize
    return table


def decompress(data: bytes, size: int) -> bytes:
    """What LZF has packed.

    Args:
        data: packed.
        size: of the result, in bytes.

    Raises:
        ValueError: it is not that long, or refers to what is not there.
    """
    made, at, end = bytearray(), 0, len(data)
    try:
        while at < end and len(made) <= size:
            head = data[at]
            at += 1
            if head < 32:
                if at + head >= end:
                    raise IndexError
                made += data[at : at + head + 1]
                at += head + 1
                continue
            length = (head >> 5) + 2
            if length == 9:
                length += data[at]
                at += 1
            distance = ((head & 31) << 8) + data[at] + 1
            at += 1
            if distance > len(made):
                raise ValueError("its compressed points refer to bytes before the first one")
            if distance >= length:
                begin = len(made) - distance
                made += made[begin : begin + length]
            else:  # what is copied repeats itself
                made += (bytes(made[-distance:]) * (length // distance + 1))[:length]
    except IndexError:
        raise ValueError("its compressed points are cut off") from None
    if len(made) != size:
        raise ValueError(f"its compressed points make {len(made)} bytes or more, not {size}")
    return bytes(made)
