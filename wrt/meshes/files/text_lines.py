"""Text files as lines of numbers, by whole arrays of bytes: a Python loop over lines would take longer than all else.

Line ends of all systems, tabs, a byte order mark, comments from "#" on, and lines that "\\" continues are made plain first.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import numpy as np

__all__ = ["TextLines", "as_utf_8", "parse_numbers", "plain_text", "ranges", "without", "words_of", "words_per_line"]

BLANKS = bytes.maketrans(b"\t\v\f", b"   ")
IS_OLD_NUMPY = np.lib.NumpyVersion(np.__version__) < "2.3.0"
UTF_16 = (b"\xff\xfe", b"\xfe\xff")


def as_utf_8(data: bytes) -> bytes:
    """A text without a byte order mark; one that begins with that of UTF-16 is converted.

    Raises:
        ValueError: it is UTF-16 and broken.
    """
    return data.decode("utf-16").encode() if data.startswith(UTF_16) else data.removeprefix(b"\xef\xbb\xbf")


def plain_text(data: bytes) -> bytes:
    """Text with "\\n" at the end of each line, blanks between words, and no comments behind a blank or at the start of a line.

    Raises:
        ValueError: errors as in `as_utf_8`.
    """
    data = as_utf_8(data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = data.translate(BLANKS)
    data = without(data, b"#", lambda before: before in b" \n")
    if b"\\" in data:
        data = re.sub(rb"\\ *\n", b" ", data)
    if b"\n " in data or data.startswith(b" "):
        data = re.sub(rb"(?m)^ +", b"", data)
    return data if data.endswith(b"\n") else data + b"\n"


def without(data: bytes, word: bytes, begins: Callable[[bytes], bool], stop: re.Pattern[bytes] | None = None) -> bytes:
    """A text without what begins with a word, up to the end of the line.

    Args:
        data: the text.
        word: with which a piece begins.
        begins: whether one does, by the character before it (b"" at the start of the text).
        stop: what it ends at, if that begins on the same line; None for nothing.
    """
    pieces, kept, at = [], 0, data.find(word)
    while at >= 0:
        end = at + len(word)
        if begins(data[max(at - 1, 0) : at]):
            line = data.find(b"\n", at)
            end = len(data) if line < 0 else line
            other = None if stop is None else stop.search(data, at)
            end = end if other is None else min(end, other.start())
            pieces.append(data[kept:at])
            kept = end
        at = data.find(word, end)
    return data if kept == 0 and not pieces else b"".join([*pieces, data[kept:]])


class TextLines:
    """The lines of a text that `plain_text` returned.

    Attributes:
        text: the bytes.
        starts, ends: (L,) where each line begins, and its "\\n".
    """

    def __init__(self, text: bytes) -> None:
        self.text = text
        self._bytes = np.frombuffer(text, dtype=np.uint8)
        self.ends = np.flatnonzero(self._bytes == 10)
        self.starts = np.concatenate([[0], self.ends[:-1] + 1])

    def of_keyword(self, keyword: bytes) -> np.ndarray:
        """(L,) bool: whether a line is a keyword, a blank and more."""
        last = len(self._bytes) - 1
        found = np.ones(len(self.starts), dtype=bool)
        for place, byte in enumerate(keyword + b" "):
            found &= self._bytes[np.minimum(self.starts + place, last)] == byte
        return found & (self.ends - self.starts > len(keyword))

    def line(self, number: int) -> bytes:
        """A line, without its end."""
        return self.text[self.starts[number] : self.ends[number]]

    def some(self, lines: np.ndarray, keyword: int = 0) -> bytes:
        """The text of some lines, by a mask (L,), with the first characters of each, its keyword, blank."""
        begins, lengths = self.starts[lines], (self.ends - self.starts)[lines] + 1
        found = ranges(self._bytes, begins, begins + lengths)
        places = np.cumsum(lengths) - lengths
        for place in range(keyword):
            found[places + place] = 32
        return found.tobytes()


def ranges(array: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The bytes of some ranges of an array, in order; ranges do not overlap."""
    edges = np.zeros(len(array) + 1, dtype=np.int8)
    edges[begins] += 1
    edges[ends] -= 1
    return array[np.cumsum(edges[:-1], dtype=np.int8).view(bool)]


def words_of(text: bytes) -> tuple[np.ndarray, np.ndarray]:
    """(N,) where each word of a text begins, and (N,) where it ends."""
    inside = np.zeros(len(text) + 2, dtype=bool)
    np.greater(np.frombuffer(text, dtype=np.uint8), 32, out=inside[1:-1])
    edges = np.flatnonzero(inside[1:] != inside[:-1])
    return edges[0::2], edges[1::2]


def words_per_line(text: bytes) -> np.ndarray:
    """(L,) how many words each line of a text has."""
    array = np.frombuffer(text, dtype=np.uint8)
    if len(array) == 0:
        return np.zeros(0, dtype=np.int64)
    inside = array > 32
    begins = inside.copy()
    begins[1:] &= ~inside[:-1]
    ends = np.flatnonzero(array == 10)
    total = np.cumsum(begins, dtype=np.int32)[ends]
    return np.diff(total, prepend=0)


def parse_numbers(text: bytes, dtype: type, what: str) -> np.ndarray:
    """All numbers of a text, in order; those of Python's float or int.

    Args:
        text: words between blanks and line ends.
        dtype: np.float64 or np.int64.
        what: to call them in messages.

    Raises:
        ValueError: a word is no number.
    """
    if not text.strip():
        return np.zeros(0, dtype=dtype)
    try:
        with all_or_error():
            found = np.fromstring(text, dtype=dtype, sep=" ")
        if dtype is np.float64 or len(found) == int(words_per_line(text if text.endswith(b"\n") else text + b"\n").sum()):
            return found
    except (ValueError, DeprecationWarning):
        pass
    raise no_number(text, dtype, what)


@contextmanager
def all_or_error() -> Iterator[None]:
    """Inside the `with` block, NumPy raises where a word is no number, as it does from 2.3 on; before, it warned and gave what
    stands in front of the word."""
    with warnings.catch_warnings() if IS_OLD_NUMPY else nullcontext():
        if IS_OLD_NUMPY:
            warnings.simplefilter("error", DeprecationWarning)
        yield


def no_number(text: bytes, dtype: type, what: str) -> ValueError:
    """The error for a text with a word that is no number; arguments as in `parse_numbers`."""
    kind = float if dtype is np.float64 else int
    for word in text.split():
        try:
            kind(word)
        except ValueError:
            return ValueError(f"{what} holds {word[:40].decode(errors='replace')!r}, which is no number")
    return ValueError(f"{what} holds words that are no numbers")
