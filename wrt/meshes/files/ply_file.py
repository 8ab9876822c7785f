"""PLY: vertices, faces or triangle strips, colours, texture coordinates and one image.

Polygons are triangulated, strips (`tristrips`, with -1 between them) are cut into their triangles. Elements and properties of
other names are skipped.
"""

from __future__ import annotations

import numpy as np

from wrt.materials.material import Material
from wrt.materials.mesh_materials import MeshMaterials
from wrt.materials.trimesh_materials import to_linear
from wrt.meshes.files.corner_values import checked_colors, checked_uv
from wrt.meshes.files.file_images import FileImages
from wrt.meshes.files.mesh_source import FileMesh, MeshSource
from wrt.meshes.files.ply_rows import Element, Header, List, Rows, read_elements, read_header
from wrt.meshes.files.triangulation import check_corners, triangulate
from wrt.meshes.up_axis import stated_up

__all__ = ["read_ply"]

COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
COORDINATES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))
LEVELS = {"u1": 255.0, "u2": 65535.0}
"""White, by type; of others it is 1."""


def read_ply(data: bytes, source: MeshSource) -> FileMesh:
    """Reads a file.

    Raises:
        ValueError: it is no PLY file, is cut off, has no triangles, or its faces refer to vertices that it has not.
    """
    header = read_header(data)
    found, rest = read_elements(data, header, ("vertex", "face", "tristrips"))
    if rest > 0:
        what = "bytes" if header.order else "numbers"
        source.warn(f"{rest} {what} behind the last of its rows are not read; does its header tell the right numbers?")
    vertex = found.get("vertex")
    if vertex is None or not all(isinstance(vertex.get(axis), np.ndarray) for axis in "xyz"):
        raise ValueError("its header announces no element 'vertex' with the properties x, y and z")
    vertices = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    parts = [
        (_strips if element.name == "tristrips" else _faces)(found[element.name], vertices, source)
        for element in header.elements
        if element.name in ("face", "tristrips") and element.name in found
    ]
    if not parts or not sum(len(triangles) for triangles, _, _ in parts):
        raise ValueError(
            "no triangles in it: it has neither faces nor triangle strips (read a cloud of points with wrt.sensors.read_points)"
        )
    triangles = np.concatenate([triangles for triangles, _, _ in parts])
    mesh = FileMesh(vertices, triangles, up=stated_up(header.comments))
    if source.materials is not False:
        mesh.materials = _materials(header, found, parts, triangles, source)
    return mesh


Part = tuple[np.ndarray, np.ndarray | None, np.ndarray | None]
"""(T, 3) vertices of triangles; of faces also (T,) the face, and (T, 3) places in the list of all corners."""


def index_list(rows: Rows, element: str) -> List:
    """The list of vertex indices, whole numbers."""
    lists = {name: one for name, one in rows.items() if isinstance(one, List)}
    name: str | None = next((name for name in ("vertex_indices", "vertex_index") if name in lists), None)
    name = name or next((name for name in lists if not name.startswith("tex")), None)
    if name is None:
        raise ValueError(f"the element '{element}' has no list of vertex indices")
    values = lists[name].values
    whole = values.astype(np.int64) if values.dtype.kind in "iu" else np.rint(np.nan_to_num(values, nan=-1.5)).astype(np.int64)
    if values.dtype.kind == "f" and (whole != values).any():
        bad = float(values[whole != values][0])
        raise ValueError(f"the list '{name}' of the element '{element}' holds {bad:g}, which is no index")
    return List(whole, lists[name].lengths)


def _faces(rows: Rows, vertices: np.ndarray, source: MeshSource) -> Part:
    indices = index_list(rows, "face")
    few = int(np.count_nonzero(indices.lengths < 3))
    if few:
        source.warn(f"{few} faces of fewer than three corners are left out")
    places, face = triangulate(vertices, indices.values, indices.lengths)
    return indices.values[places], face, places


def _strips(rows: Rows, vertices: np.ndarray, source: MeshSource) -> Part:
    indices = index_list(rows, "tristrips")
    values, lengths = indices.values, indices.lengths
    ends = np.zeros(len(values) + 1, dtype=bool)
    ends[np.cumsum(lengths)] = True  # a strip does not go on in the next row
    breaks = values == -1
    used = np.flatnonzero(~breaks)
    check_corners(values[used], np.array([len(used)]), len(vertices))
    strip = np.cumsum(breaks | ends[:-1])
    first = np.flatnonzero(np.diff(strip[used], prepend=-1))
    place = np.arange(len(used)) - np.repeat(first, np.diff(np.append(first, len(used))))
    third = np.flatnonzero(place >= 2)
    a, b, c = used[third - 2], used[third - 1], used[third]
    odd = place[third] % 2 == 1
    return np.stack([values[np.where(odd, b, a)], values[np.where(odd, a, b)], values[c]], axis=1), None, None


def _materials(
    header: Header, found: dict[str, Rows], parts: list[Part], triangles: np.ndarray, source: MeshSource
) -> MeshMaterials | None:
    elements = {element.name: element for element in header.elements}
    vertex, (_, face, places) = found["vertex"], parts[0]
    only_faces = len(parts) == 1 and face is not None
    uv = next((np.stack([vertex[n] for n in pair], axis=1)[triangles] for pair in COORDINATES if _numbers(vertex, pair)), None)  # type: ignore[misc]
    coordinates = found["face"].get("texcoord") if only_faces else None
    if isinstance(coordinates, List) and len(coordinates.values) == 2 * int(index_list(found["face"], "face").lengths.sum()):
        uv = coordinates.values.reshape(-1, 2)[places]
    colors = _colors(vertex, elements["vertex"], source)
    corner_colors = None if colors is None else colors[triangles]
    if colors is None and only_faces:
        colors = _colors(found["face"], elements["face"], source)
        corner_colors = None if colors is None else np.repeat(colors[face][:, None], 3, axis=1)
    images = FileImages(source)
    name = next((text.partition(" ")[2].strip() for text in header.comments if text.startswith("TextureFile ")), None)
    if name is not None and uv is None:
        source.warn(f"it has no texture coordinates to place the image '{name}', which is left out")
    uv = checked_uv(uv, source)
    texture = None if name is None or uv is None else images.of_file(name, "TextureFile")
    if texture is not None:
        return MeshMaterials((Material(color=1.0, color_texture=texture),), corner_uv=uv)
    if corner_colors is not None:
        return MeshMaterials((Material(color=1.0),), corner_uv=uv, corner_color=np.ascontiguousarray(corner_colors))
    return None if uv is None else MeshMaterials((Material(),), corner_uv=uv)


def _numbers(rows: Rows, names: tuple[str, ...]) -> bool:
    return all(isinstance(rows.get(name), np.ndarray) for name in names)


def _colors(rows: Rows, element: Element, source: MeshSource) -> np.ndarray | None:
    """(R, 3) float32, linear."""
    names = next((names for names in COLORS if _numbers(rows, names)), None)
    if names is None or len(rows[names[0]]) == 0:  # type: ignore[arg-type]
        return None
    kinds = {one.name: one.kind for one in element.properties}
    given = np.stack([rows[name].astype(np.float64) / LEVELS.get(kinds[name], 1.0) for name in names], axis=1)
    if kinds[names[0]] not in LEVELS and np.nanmax(given, initial=0.0) > 1.0:
        given /= 255.0  # levels in a type other than uchar
    return to_linear(checked_colors(given, f"colours of the element '{element.name}'", source))
