"""Contents of mesh files. PLY, OBJ and OFF are made here, because trimesh rounds: to float32 in PLY, where points far from 0
move by decimetres, and to 8 or 10 decimals in text, where small meshes lose their shape. Other formats are left to trimesh.

STL and glTF hold float32 by their standards, and trimesh writes seven digits into Collada files. Where that moves vertices by
more than a share of the mesh's size, a warning says by how much.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

NOTICED = 2.0**-20
"""Share of a mesh's size by which float32 may move its vertices without a warning: sixteen times what it does near 0."""


def _float32(values: np.ndarray) -> np.ndarray:
    """Values rounded to float32."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _seven_digits(values: np.ndarray) -> np.ndarray:
    """Values rounded to seven decimal digits, up to an error of float64."""
    unit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(values), np.finfo(np.float64).tiny))) - 6.0)
    return np.round(values / unit) * unit


ROUNDING: Mapping[str, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    "stl": ("float32", _float32),
    "glb": ("float32", _float32),
    "gltf": ("float32", _float32),
    "dae": ("seven digits", _seven_digits),
}
"""What formats hold, and what becomes of values in them."""


def encode_mesh(mesh: trimesh.Trimesh, suffix: str) -> bytes:
    """The contents of a file of one piece.

    Args:
        mesh: what to write.
        suffix: of the format, without the dot.

    Raises:
        ValueError: trimesh cannot write that format, or not into one file.

    Warns:
        UserWarning: the format moves vertices.
    """
    if suffix in ENCODERS:
        return ENCODERS[suffix](np.asarray(mesh.vertices), np.asarray(mesh.faces))
    warn_of_rounding(mesh, suffix)
    if suffix == "gltf":  # else with buffers in files beside it, whose names do not depend on its own
        data = mesh.export(file_type=suffix, embed_buffers=True)["model.gltf"]  # type: ignore[call-overload, index]
    else:
        data = mesh.export(file_type=suffix)
    if isinstance(data, dict):
        raise ValueError("it is no format of files")
    return data.encode() if isinstance(data, str) else data


def warn_of_rounding(mesh: trimesh.Trimesh, suffix: str) -> None:
    """Warns if a format moves vertices noticeably.

    Warns:
        UserWarning: it does.
    """
    if suffix not in ROUNDING:
        return
    held, rounded = ROUNDING[suffix]
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    moved = np.abs(rounded(vertices) - vertices).max()
    if moved > NOTICED * np.linalg.norm(np.ptp(vertices, axis=0)):
        warnings.warn(
            f".{suffix} files hold {held}, which moves vertices by up to {moved:.2g}; save a .ply, .obj or .off file, or move "
            "the mesh to 0 first (TriangleMesh.transformed)",
            stacklevel=4,
        )


def _ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Binary, in float32 if that holds all coordinates exactly, else in float64."""
    with np.errstate(over="ignore"):
        narrow = vertices.astype("<f4")
    is_exact = bool((narrow == vertices).all())
    rows = np.empty(len(faces), dtype=[("corners", "u1"), ("vertex", "<i4", 3)])
    rows["corners"], rows["vertex"] = 3, faces
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property {'float' if is_exact else 'double'} {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode() + (narrow if is_exact else vertices.astype("<f8")).tobytes() + rows.tobytes()


def _obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces.astype(np.int64) + 1).tolist()]
    return "\n".join([*lines, ""]).encode()


def _off(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [f"{x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join([*lines, ""]).encode()


ENCODERS: Mapping[str, Callable[[np.ndarray, np.ndarray], bytes]] = {"ply": _ply, "obj": _obj, "off": _off}
