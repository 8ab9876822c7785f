"""STL, binary and text. Triangles have vertices of their own, three each; normals and attributes are not read.

A file is binary if it has the length that its number of triangles asks for, whatever its first word: many programs write
"solid" into the 80 bytes before that number. Else it is text if it says so, has a facet, and has no zero byte in the place of
that number, as binary files of fewer than 2^24 triangles have.
"""

from __future__ import annotations

import re

import numpy as np

from wrt.meshes.files.mesh_source import FileMesh, MeshSource
from wrt.meshes.files.text_lines import as_utf_8, parse_numbers, plain_text, ranges, without, words_of
from wrt.meshes.up_axis import stated_up

__all__ = ["read_stl"]

HEADER = 80
FIRST_FACET = re.compile(rb" facet +(normal( +[^ \n]+){3}[ \n]+)?outer ")
"""Where the name of a solid ends, if all is on one line. Names may have any words in them."""

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(data: bytes, source: MeshSource) -> FileMesh:
    """Reads a file.

    Raises:
        ValueError: it is no STL file, is cut off, has no triangles, or facets of another number of corners.
    """
    count = int.from_bytes(data[HEADER : HEADER + 4], "little") if len(data) >= HEADER + 4 else 0
    is_binary = len(data) == HEADER + 4 + count * FACET.itemsize
    text = b"" if is_binary else as_utf_8(data)
    if _is_text(text):
        corners, remarks = _text_corners(text), text[: 1 << 12].decode("latin-1").splitlines()
        remarks = [line.lstrip().removeprefix("#") for line in remarks if line.lstrip().startswith("#")]
    else:
        corners = _binary_corners(data, count, source)
        remarks = [data[:HEADER].rstrip(b"\0 ").decode("latin-1")]
    vertices = np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.float64)
    return FileMesh(vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3), up=stated_up(remarks))


def _is_text(data: bytes) -> bool:
    if not data[:512].lstrip().lower().startswith((b"solid", b"#", b"facet")) or 0 in data[HEADER : HEADER + 4]:
        return False
    return re.search(rb"(?i)\bfacet\b", data) is not None


def _binary_corners(data: bytes, count: int, source: MeshSource) -> np.ndarray:
    """(F, 3, 3) float32."""
    if len(data) < HEADER + 4:
        raise ValueError(
            f"it has {len(data)} bytes, and is neither text with facets nor long enough for the header of a binary STL"
        )
    whole, rest = divmod(len(data) - HEADER - 4, FACET.itemsize)
    if count > whole:
        part = f" and {rest} bytes of another" if rest else ""
        raise ValueError(
            f"it ends too early, or is no STL file: its header announces {count} triangles, and it holds "
            f"{whole}{part}; is the file "
            "complete?"
        )
    if count == 0:
        raise ValueError("no triangles in it: its header announces none")
    left = len(data) - HEADER - 4 - count * FACET.itemsize
    if left:
        source.warn(f"{left} bytes behind the last of the {count} triangles that its header announces are not read")
    return np.frombuffer(data, dtype=FACET, count=count, offset=HEADER + 4)["corners"]


def _text_corners(data: bytes) -> np.ndarray:
    """(F, 3, 3) float64, of all solids."""
    text = without(plain_text(data).lower(), b"solid", lambda before: before in b" \nd", FIRST_FACET)
    array = np.frombuffer(text + bytes(8), dtype=np.uint8)
    begins, ends = words_of(text)

    key = array[begins].astype(np.uint16) << 8 | np.minimum(ends - begins, 255).astype(np.uint16)

    def are(word: bytes) -> np.ndarray:
        found = np.flatnonzero(key == word[0] << 8 | len(word))
        for place, byte in enumerate(word):
            found = found[array[begins[found] + place] == byte]
        return found

    facets, vertices, loops = len(are(b"facet")), are(b"vertex"), are(b"endloop")
    corners = np.diff(np.searchsorted(vertices, loops), prepend=0)
    if (corners != 3).any():
        wrong = int(np.argmax(corners != 3))
        raise ValueError(f"facet {wrong} has {int(corners[wrong])} corners; those of STL have three")
    if len(loops) != facets or len(vertices) != 3 * facets or (facets and vertices[-1] + 3 >= len(begins)):
        raise ValueError(f"it ends within a facet: {facets} begin, and {len(loops)} are complete; is the file complete?")
    numbers = parse_numbers(ranges(array, begins[vertices + 1], ends[vertices + 3] + 1).tobytes(), np.float64, "a facet")
    if len(numbers) != 9 * facets:
        raise ValueError(f"its {facets} facets have {len(numbers)} coordinates, and not {9 * facets}; is the file complete?")
    return numbers.reshape(-1, 3, 3)
