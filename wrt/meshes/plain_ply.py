"""Binary PLY files that hold positions and triangles and nothing else: the most frequent kind of file of scanned models.

They are read here because importing trimesh takes 0.5 s, a fifth of `wrt render bunny.ply` with a warm kernel cache
(notebooks/records/2026-11-23-warm-start.md). Every other file, and every file of this kind that is not exactly as long as its
header says, is left to trimesh, errors included. Arrays are those that trimesh returns, to the bit.

References:
    G. Turk: The PLY polygon file format. Stanford University, 1994.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

MAX_HEADER = 1 << 12
"""Bytes of the file in which the header must end."""

HEADER = re.compile(
    rb"ply\r?\nformat binary_(?P<order>little|big)_endian 1\.0\r?\n(?:(?:comment|obj_info)[^\n]*\n)*"
    rb"element vertex (?P<vertices>\d{1,10})\r?\n"
    rb"property (?P<real>float|float32|double|float64) x\r?\nproperty (?P=real) y\r?\nproperty (?P=real) z\r?\n"
    rb"element face (?P<faces>\d{1,10})\r?\n"
    rb"property list (?:uchar|uint8) (?P<index>int|int32|uint|uint32) vertex_(?:index|indices)\r?\n"
    rb"end_header\r?\n"
)

NUMPY = {b"little": "<", b"big": ">", b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"}
NUMPY |= {b"int": "i4", b"int32": "i4", b"uint": "u4", b"uint32": "u4"}
"""NumPy's names of byte orders and types."""


def read_plain_ply(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """(V, 3) float64 vertices and (F, 3) faces of a file; None if trimesh must read it."""
    with open(path, "rb") as file:
        header = HEADER.match(file.read(MAX_HEADER))
        if header is None:
            return None
        order, real, index = (NUMPY[header[name]] for name in ("order", "real", "index"))
        vertex_count, face_count = int(header["vertices"]), int(header["faces"])
        row = np.dtype([("corners", "u1"), ("vertex", order + index, 3)])
        size = header.end() + vertex_count * 3 * np.dtype(real).itemsize + face_count * row.itemsize
        if vertex_count == 0 or face_count == 0 or path.stat().st_size != size:
            return None
        file.seek(header.end())
        vertices = np.fromfile(file, dtype=order + real, count=3 * vertex_count).reshape(-1, 3)
        faces = np.fromfile(file, dtype=row, count=face_count)
    if len(vertices) != vertex_count or len(faces) != face_count or (faces["corners"] != 3).any():
        return None
    return vertices.astype(np.float64), faces["vertex"].astype(order.replace(">", "<") + index)
