"""The upward direction of meshes: by the format of their file, and for pictures of several meshes.

In files it is a comment, or, in glTF, where y is up by standard, a node that turns the mesh.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers

Direction = tuple[float, float, float]

Y_UP: Direction = (0.0, 1.0, 0.0)
Z_UP: Direction = (0.0, 0.0, 1.0)

Y_UP_FORMATS = frozenset({"glb", "gltf", "obj", "off", "ply"})
"""Formats of computer graphics, whose y axis usually points up; in glTF, by standard. In the others, of engineering, z does."""


def up_of_format(suffix: str) -> Direction | None:
    """Upward direction of meshes in files with this extension, without its dot; None for z, the default."""
    return Y_UP if suffix.lower() in Y_UP_FORMATS else None


def up_remark(up: Direction) -> str:
    """What `wrt.TriangleMesh.save` writes into a file as a comment, and `stated_up` reads.

    Formats have no other place for it.
    """
    return "up " + " ".join(f"{x!r}" for x in up)


def stated_up(remarks: Iterable[str]) -> Direction | None:
    """The upward direction in comments of a file; None if none states it."""
    for remark in remarks:
        words = remark.split()
        if len(words) == 4 and words[0] == "up":
            try:
                return checked_up([float(word) for word in words[1:]])
            except (TypeError, ValueError):
                continue
    return None


def checked_up(up: Any) -> Direction | None:
    """Returns a unit vector, or None for None.

    Raises:
        TypeError: `up` does not hold numbers.
        ValueError: it is not three finite numbers, or is zero.
    """
    if up is None:
        return None
    vector = as_numbers("up", up, finite=False)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError(f"up must be three finite numbers x, y, z that are not all zero, or None, not {up!r}")
    vector /= np.abs(vector).max()  # so that squares neither overflow nor vanish
    return tuple((vector / np.linalg.norm(vector)).tolist())


def mapped_up(up: Direction | None, linear: np.ndarray) -> Direction | None:
    """Upward direction after a linear map, (3, 3); None if it is None or the map takes it to zero."""
    if up is None:
        return None
    image = linear @ up
    return checked_up(image) if image.any() and np.isfinite(image).all() else None


def common_up(meshes: Iterable[Any]) -> Direction | None:
    """The upward direction of all meshes that have one; None if none has, or if they differ by more than rounding."""
    known = [up for up in (getattr(mesh, "up", None) for mesh in meshes) if up is not None]
    return known[0] if known and np.allclose(known, known[0], rtol=0.0, atol=1e-9) else None


def default_up(geometry: Any) -> Direction:
    """Upward direction of pictures of a mesh or scene: that of its meshes (`common_up`), else z."""
    return common_up(getattr(geometry, "meshes", (geometry,))) or Z_UP


def with_stated_up(data: bytes, suffix: str, up: Direction | None) -> bytes:
    """The contents of a file that state an upward direction, if it is known and not that of the format.

    Args:
        data: of the file.
        suffix: of the format, without the dot; formats other than `REMARKS` are left as they are.
        up: a unit vector, or None.
    """
    if up is None or suffix not in REMARKS or up == (up_of_format(suffix) or Z_UP):
        return data
    return REMARKS[suffix](data, up)


def _in_ply(data: bytes, up: Direction) -> bytes:
    first, second, rest = data.split(b"\n", 2)
    return b"\n".join([first, second, f"comment {up_remark(up)}".encode(), rest])


def _in_obj(data: bytes, up: Direction) -> bytes:
    return f"# {up_remark(up)}\n".encode() + data


def _in_off(data: bytes, up: Direction) -> bytes:
    first, rest = data.split(b"\n", 1)
    return b"\n".join([first, f"# {up_remark(up)}".encode(), rest])


def _in_stl(data: bytes, up: Direction) -> bytes:
    return up_remark(up).encode()[:80].ljust(80, b"\0") + data[80:]


def _in_glb(data: bytes, up: Direction) -> bytes:
    size = int.from_bytes(data[12:16], "little")
    text, rest = _in_gltf(data[20 : 20 + size], up), data[20 + size :]
    header = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    return header + len(text).to_bytes(4, "little") + b"JSON" + text + rest


def _in_gltf(data: bytes, up: Direction) -> bytes:
    """The JSON of a file with one mesh, under a node that turns it and names the direction that it turns to y."""
    document = json.loads(data)
    mesh = next(node["mesh"] for node in document["nodes"] if "mesh" in node)
    document["nodes"] = [{"mesh": mesh, "matrix": turn_to_y(up).T.reshape(-1).tolist(), "extras": {"up": list(up)}}]
    document["scenes"], document["scene"] = [{"nodes": [0]}], 0
    text = json.dumps(document).encode()
    return text + b" " * (-len(text) % 4)


def turn_to_y(up: Direction) -> np.ndarray:
    """(4, 4): the shortest rotation of a unit vector to the y axis."""
    from_up, to_y = np.array(up), np.array(Y_UP)
    axis, cos = np.cross(from_up, to_y), float(from_up @ to_y)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([1.0, -1.0, -1.0]) if cos <= -1.0 + 1e-12 else np.eye(3) + cross + cross @ cross / (1.0 + cos)
    return matrix


REMARKS = {"ply": _in_ply, "obj": _in_obj, "off": _in_off, "stl": _in_stl, "glb": _in_glb, "gltf": _in_gltf}
"""How each format states an upward direction that is not its own."""
