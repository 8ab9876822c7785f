"""The upward direction in mesh files: as a comment, or, in glTF, where y is up by standard, as a node that turns the mesh."""

from __future__ import annotations

import json

import numpy as np

from wrt.meshes.up_axis import Y_UP, Z_UP, Direction, up_of_format, up_remark

__all__ = ["with_stated_up"]


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
