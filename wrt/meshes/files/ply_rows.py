"""The header of a PLY file, and the rows of its elements as arrays.

A row is made of numbers and of lists, each list with its length before it. Elements without lists, and those in which every
list has the length that it has in the first row, are read as one array; others row by row, of which only the lengths are looked
at.

References: turk-1994.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from wrt.meshes.files.text_lines import parse_numbers

__all__ = ["Element", "Header", "List", "read_elements", "read_header"]

MAX_HEADER = 1 << 20
"""Bytes of the file in which the header must end."""

LAST_LINE = re.compile(rb"[\r\n][ \t]*end_header[ \t]*(?=[\r\n]|$)")
"""In remarks, the word does not end a header."""

MAX_ROW = 1 << 12
"""Properties of an element."""

TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2"}
TYPES |= {"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8"}
TYPES |= {"float64": "f8", "int64": "i8", "uint64": "u8"}

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Property:
    """A number of each row, or, with `length`, a list; NumPy's names of types."""

    name: str
    kind: str
    length: str | None = None


@dataclass
class Element:
    """Rows of one kind: their number and their properties."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


@dataclass
class Header:
    """What a header says.

    Attributes:
        order: "<" or ">" of binary files; empty for text.
        elements: in the file's order.
        comments: in the file's order.
        size: bytes of the header.
    """

    order: str
    elements: list[Element]
    comments: list[str]
    size: int


@dataclass
class List:
    """A list property of all rows: (N,) values, row after row, and (R,) lengths."""

    values: np.ndarray
    lengths: np.ndarray


def read_header(data: bytes) -> Header:
    """Reads a header.

    Raises:
        ValueError: it is no header of a PLY file, or has no end.
    """
    if not data[:4].rstrip().lower() == b"ply":
        raise ValueError("it does not begin with the line 'ply'")
    end = LAST_LINE.search(data, 0, MAX_HEADER)
    if end is None:
        raise ValueError("its header has no line 'end_header'; is the file complete?")
    order, elements, comments = None, [], []
    lines = re.split(r"\r\n|\r|\n", data[: end.start()].decode("latin-1"))  # remarks in UTF-8 hold what Unicode ends lines at
    for line in lines[1:]:
        words = line.split()
        if not words:
            continue
        if words[0] in ("comment", "obj_info"):
            comments.append(line.strip()[len(words[0]) :].strip())
        elif words[0] == "format" and len(words) >= 2:
            if words[1] not in ORDERS:
                raise ValueError(f"its header says 'format {words[1][:40]}'; the formats are {', '.join(ORDERS)}")
            order = ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit():
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(words))
        else:
            raise ValueError(f"its header has the line {line[:80]!r}, which is not understood")
    if order is None:
        raise ValueError("its header has no line 'format'")
    if any(len(element.properties) > MAX_ROW for element in elements):
        raise ValueError(f"an element has more than {MAX_ROW} properties")
    in_lf = b"\n" in data[: end.start() + 2]  # behind a header with "\r" alone, a "\n" is the first byte of the rows
    size = end.end() + (2 if in_lf and data[end.end() : end.end() + 2] == b"\r\n" else 1)
    return Header(order, elements, comments, size)


def _property(words: list[str]) -> Property:
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[3] in TYPES and TYPES.get(words[2], "f")[0] in "iu":
        return Property(words[4], TYPES[words[3]], TYPES[words[2]])
    raise ValueError(
        f"its header has the line {' '.join(words)[:80]!r}; a property is a type and a name, or 'list' and two types"
    )


Rows = dict[str, np.ndarray | List]
"""Properties of an element, by name: (R,) numbers, or lists."""


def read_elements(data: bytes, header: Header, wanted: tuple[str, ...]) -> tuple[dict[str, Rows], int]:
    """The rows of some elements, and how many bytes (binary) or numbers (text) are left behind the last element.

    Elements behind the last wanted one are not read.

    Raises:
        ValueError: the file is shorter than its header says, or holds words that are no numbers.
    """
    found: dict[str, Rows] = {}
    body: Body = Text(data[header.size :]) if header.order == "" else Binary(data, header.size, header.order)
    names = [element.name for element in header.elements]
    last = max((place for place, name in enumerate(names) if name in wanted), default=-1)
    for element in header.elements[: last + 1]:
        rows = body.rows(element)
        if element.name in wanted:
            if element.name in found:
                raise ValueError(f"its header has two elements '{element.name}'")
            found[element.name] = rows
    rest = body.left() if last + 1 == len(names) else 0
    return found, rest


class Body:
    """What follows the header: a reader of rows, element after element."""

    def rows(self, element: Element) -> Rows:
        """The next element's rows."""
        raise NotImplementedError

    def left(self) -> int:
        """How much has not been read."""
        raise NotImplementedError


def _shorter(element: Element) -> ValueError:
    return ValueError(
        f"it ends before the last of {element.count} rows of the element '{element.name}' that its header "
        "announces; is the file "
        "complete?"
    )


class Binary(Body):
    """Rows in binary."""

    def __init__(self, data: bytes, at: int, order: str) -> None:
        self.data, self.at, self.order = data, at, order

    def left(self) -> int:
        return len(self.data) - self.at

    def rows(self, element: Element) -> Rows:
        if element.count == 0 or not element.properties:
            return self._split(np.zeros(0, self._type(element, [0] * len(element.properties))), element)
        rows = self._equal_rows(element)
        return self._uneven_rows(element) if rows is None else self._split(rows, element)

    def _type(self, element: Element, lengths: list[int]) -> np.dtype:
        """The type of a row whose lists have these lengths; fields are numbered, since names may repeat."""
        fields: list[tuple] = []
        for number, (one, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if one.length is None:
                fields.append((f"{number}", self.order + one.kind))
            else:
                fields += [(f"{number}n", self.order + one.length), (f"{number}", self.order + one.kind, (length,))]
        return np.dtype(fields)

    def _first_lengths(self, element: Element) -> list[int]:
        at, lengths = self.at, []
        for one in element.properties:
            lengths.append(0 if one.length is None else self._length(at, one, element))
            at += np.dtype(one.kind).itemsize * (1 if one.length is None else lengths[-1])
            at += 0 if one.length is None else np.dtype(one.length).itemsize
        return lengths

    def _length(self, at: int, one: Property, element: Element) -> int:
        size = np.dtype(one.length).itemsize
        if at + size > len(self.data):
            raise _shorter(element)
        little = "little" if self.order == "<" else "big"
        length = int.from_bytes(self.data[at : at + size], little, signed=one.length[0] == "i")  # type: ignore[arg-type]
        if length < 0:
            raise ValueError(f"a list '{one.name}' of the element '{element.name}' has the length {length}")
        if length * np.dtype(one.kind).itemsize > len(self.data) - at:
            raise _shorter(element)
        return length

    def _equal_rows(self, element: Element) -> np.ndarray | None:
        """All rows, if their lists are as long as those of the first one; else None."""
        lengths = self._first_lengths(element)
        row = self._type(element, lengths)
        if row.itemsize == 0:
            return np.zeros(0, row)
        size = element.count * row.itemsize
        lists = [number for number, one in enumerate(element.properties) if one.length is not None]
        if size > len(self.data) - self.at:
            if lists:
                return None
            raise _shorter(element)
        rows = np.frombuffer(self.data, dtype=row, count=element.count, offset=self.at)
        if any((rows[f"{number}n"] != lengths[number]).any() for number in lists):
            return None
        self.at += size
        return rows

    def _split(self, rows: np.ndarray, element: Element) -> Rows:
        found: Rows = {}
        for number, one in enumerate(element.properties):
            values = rows[f"{number}"]
            if one.length is None:
                found[one.name] = values
            else:
                found[one.name] = List(values.reshape(-1), np.full(len(rows), values.shape[1], dtype=np.int64))
        return found

    def _uneven_rows(self, element: Element) -> Rows:
        """Rows of different lengths: a walk over the lengths of their lists, then all values at once."""
        lists = [one for one in element.properties if one.length is not None]
        places: list[list[int]] = [[] for _ in lists]
        lengths: list[list[int]] = [[] for _ in lists]
        before, behind = self._gaps(element)
        at, end, data, order = self.at, len(self.data), self.data, "little" if self.order == "<" else "big"
        steps = [
            (before[k], np.dtype(one.length).itemsize, one.length[0] == "i", np.dtype(one.kind).itemsize, places[k], lengths[k])
            for k, one in enumerate(lists)
        ]
        starts = []
        min_bytes = sum(before) + behind + sum(step[1] for step in steps)
        if element.count * min_bytes > end - at:
            raise _shorter(element)
        for _ in range(element.count):
            starts.append(at)
            for gap, size, signed, item, place, length in steps:
                at += gap
                count = (
                    data[at]
                    if size == 1 and not signed and at < end
                    else int.from_bytes(data[at : at + size], order, signed=signed)  # type: ignore[arg-type]
                )
                at += size
                if count < 0:
                    raise ValueError(f"a list of the element '{element.name}' has the length {count}")
                place.append(at)
                length.append(count)
                at += count * item
            at += behind
            if at > end:
                raise _shorter(element)
        self.at = at
        return self._gathered(element, np.array(starts), [np.array(p) for p in places], [np.array(n) for n in lengths])

    @staticmethod
    def _gaps(element: Element) -> tuple[list[int], int]:
        """Bytes of numbers before each list, and behind the last one."""
        before, gap = [], 0
        for one in element.properties:
            if one.length is None:
                gap += np.dtype(one.kind).itemsize
            else:
                before.append(gap)
                gap = 0
        return before, gap

    def _gathered(self, element: Element, starts: np.ndarray, places: list[np.ndarray], lengths: list[np.ndarray]) -> Rows:
        array, at, number = np.frombuffer(self.data, dtype=np.uint8), starts, 0
        found: Rows = {}
        for one in element.properties:
            size, dtype = np.dtype(one.kind).itemsize, self.order + one.kind
            if one.length is None:
                found[one.name] = array[at[:, None] + np.arange(size)].view(dtype)[:, 0]
                at = at + size
            else:
                place, count = places[number], lengths[number]
                begin = np.cumsum(count) - count
                item = np.arange(int(count.sum())) - np.repeat(begin, count)
                where = np.repeat(place, count) + item * size
                values = array[where[:, None] + np.arange(size)].view(dtype)[:, 0] if len(where) else np.zeros(0, dtype)
                found[one.name] = List(values, count)
                at = place + count * size
                number += 1
        return found


class Text(Body):
    """Rows in text: numbers between blanks, in order."""

    def __init__(self, data: bytes) -> None:
        self.values = parse_numbers(data, np.float64, "the file")
        self.at = 0

    def left(self) -> int:
        return len(self.values) - self.at

    def rows(self, element: Element) -> Rows:
        found: Rows = {}
        width = len(element.properties)
        lists = [number for number, one in enumerate(element.properties) if one.length is not None]
        if element.count * width > len(self.values) - self.at:
            raise _shorter(element)
        if not lists:
            table = self.values[self.at : self.at + element.count * width].reshape(element.count, width)
            self.at += element.count * width
            return {one.name: table[:, number] for number, one in enumerate(element.properties)}
        if width == 1:
            return {element.properties[0].name: self._single_list(element)}
        parts: list[list[np.ndarray]] = [[] for _ in element.properties]
        for _ in range(element.count):
            for number, one in enumerate(element.properties):
                count = 1 if one.length is None else self._length(self.at, element)
                begin = self.at + (one.length is not None)
                if begin + count > len(self.values):
                    raise _shorter(element)
                parts[number].append(self.values[begin : begin + count])
                self.at = begin + count
        for one, part in zip(element.properties, parts, strict=True):
            values = np.concatenate(part) if part else np.zeros(0)
            found[one.name] = values if one.length is None else List(values, np.array([len(p) for p in part], dtype=np.int64))
        return found

    def _length(self, at: int, element: Element) -> int:
        value = self.values[at] if at < len(self.values) else np.nan
        if not (value >= 0 and value == int(value)) or value > len(self.values):
            if at >= len(self.values) or value > len(self.values):
                raise _shorter(element)
            raise ValueError(f"a list of the element '{element.name}' has the length {value:g}")
        return int(value)

    def _single_list(self, element: Element) -> List:
        """Rows of one list and nothing else, as faces are in most files."""
        if element.count == 0:
            return List(np.zeros(0), np.zeros(0, dtype=np.int64))
        first = self._length(self.at, element)
        size = element.count * (first + 1)
        if size <= len(self.values) - self.at:
            table = self.values[self.at : self.at + size].reshape(element.count, first + 1)
            if (table[:, 0] == first).all():
                self.at += size
                return List(table[:, 1:].reshape(-1), np.full(element.count, first, dtype=np.int64))
        values, at, places = self.values[self.at :].tolist(), 0, []
        for _ in range(element.count):
            if at >= len(values) or not 0 <= values[at] <= len(values):
                raise _shorter(element)
            places.append(at)
            at += int(values[at]) + 1
        if at > len(values):
            raise _shorter(element)
        given = self.values[self.at :][places]
        lengths = given.astype(np.int64)
        if (lengths != given).any():
            raise ValueError(f"a list of the element '{element.name}' has a length that is no whole number")
        keep = np.ones(at, dtype=bool)
        keep[places] = False
        found = List(self.values[self.at : self.at + at][keep], lengths)
        self.at += at
        return found
