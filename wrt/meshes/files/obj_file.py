"""Wavefront OBJ: polygons, and, where they are wanted, texture coordinates, materials of MTL files and colours behind vertices.

An index counts from 1, or, if it is negative, back from the last vertex before its line. Groups, objects, normals and smoothing
do not change triangles or their order. Lines, points, curves and free-form surfaces are not read.

References: wavefront-technologies-1992.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from wrt.materials.material import Material
from wrt.materials.mesh_materials import MeshMaterials
from wrt.materials.trimesh_materials import to_linear
from wrt.meshes.files.corner_values import checked_colors, checked_uv
from wrt.meshes.files.mesh_source import FileMesh, MeshSource
from wrt.meshes.files.mtl_file import UvMap, read_materials_of
from wrt.meshes.files.text_lines import TextLines, no_number, parse_numbers, plain_text, words_per_line
from wrt.meshes.files.triangulation import triangulate
from wrt.meshes.up_axis import stated_up

__all__ = ["read_obj"]

GLUED_COMMENTS = re.compile(rb"(?m)^((?:v|vt|f|fo) [^\n#]*)#[^\n]*")
"""Comments right behind a number. In names, "#" is a character like others."""


@dataclass
class Faces:
    """The faces of a file.

    Attributes:
        corners: (N,) vertex of each corner, from 0, face after face.
        counts: (P,) corners of each face.
        uv: (N,) texture coordinate of each corner, from 0; -1 for none. None if these are not wanted.
        lines: (P,) line of each face.
    """

    corners: np.ndarray
    counts: np.ndarray
    uv: np.ndarray | None
    lines: np.ndarray


def read_obj(data: bytes, source: MeshSource) -> FileMesh:
    """Reads a file. Materials are read only if `source.materials` is true.

    Raises:
        ValueError: no triangles, words that are no numbers, or a face that refers to a vertex that is not there.
    """
    remarks = [line[1:] for line in data[: 1 << 12].decode("latin-1").splitlines() if line.startswith("#")]
    text = plain_text(data)
    if b"#" in text:
        text = GLUED_COMMENTS.sub(rb"\1", text)
    lines = TextLines(text)
    is_vertex = lines.of_keyword(b"v")
    vertices, colors = _vertices(lines.some(is_vertex, 1))
    faces = _read_faces(lines, is_vertex, bool(source.materials))
    if not (faces.counts >= 3).any():
        raise ValueError("no triangles in it: it has no faces (lines, points and free-form surfaces are not read)")
    few = int(np.count_nonzero(faces.counts < 3))
    if few:
        source.warn(f"{few} faces of fewer than three corners are left out")
    places, face = triangulate(vertices, faces.corners, faces.counts)
    mesh = FileMesh(vertices, faces.corners[places], up=stated_up(remarks))
    if source.materials:
        mesh.materials = _materials(lines, faces, places, face, colors, source)
    return mesh


def _vertices(text: bytes) -> tuple[np.ndarray, np.ndarray | None]:
    """(V, 3) float64, and (V, 3) colours if every vertex has one."""
    words = words_per_line(text)
    numbers = parse_numbers(text, np.float64, "a vertex")
    if len(numbers) != words.sum():
        raise no_number(text, np.float64, "a vertex")
    if len(words) and words.min() < 3:
        raise ValueError(f"vertex {int(np.argmin(words))} has {int(words.min())} coordinates, and not three")
    first = np.cumsum(words) - words
    vertices = numbers.reshape(-1, 3) if (words == 3).all() else numbers[first[:, None] + np.arange(3)]
    colors = numbers[first[:, None] + np.arange(3, 6)] if len(words) and words.min() >= 6 else None
    return vertices, colors


def _read_faces(lines: TextLines, is_vertex: np.ndarray, with_uv: bool) -> Faces:
    is_face = lines.of_keyword(b"f") | lines.of_keyword(b"fo")
    at = np.flatnonzero(is_face)
    text = lines.some(is_face, 2)
    counts = words_per_line(text)
    before = np.cumsum(is_vertex)[at]
    if not with_uv:
        bare = re.sub(rb"/[^ \n]*", b"", text) if b"/" in text else text
        indices = parse_numbers(bare, np.int64, "a face")
        if len(indices) != counts.sum():
            raise no_number(bare, np.int64, "a face")
        return Faces(_from_zero(indices, counts, before, "vertex"), counts, None, at)
    words = re.sub(rb"/(?=[ \n])", b"", re.sub(rb"//[^ \n]*", b"", text)).split()
    parts = np.array([[*word.split(b"/", 2), b"0"][:2] for word in words], dtype="S24").reshape(-1, 2)
    try:
        pairs = parts.astype(np.int64)
    except (ValueError, OverflowError):
        raise no_number(b" ".join(parts.ravel().tolist()), np.int64, "a face") from None
    uv_before = np.cumsum(lines.of_keyword(b"vt"))[at]
    none = pairs[:, 1] == 0
    uv = np.where(none, -1, _from_zero(np.where(none, 1, pairs[:, 1]), counts, uv_before, "texture coordinate"))
    return Faces(_from_zero(pairs[:, 0], counts, before, "vertex"), counts, uv, at)


def _from_zero(indices: np.ndarray, counts: np.ndarray, before: np.ndarray, what: str) -> np.ndarray:
    """Indices from 0 of those in a file, from 1 or back from the last one before the line."""
    if (indices == 0).any():
        face = int(np.searchsorted(np.cumsum(counts), int(np.argmax(indices == 0)), side="right"))
        raise ValueError(f"face {face} (counted from 0) has the index 0 of a {what}; those of OBJ files count from 1")
    negative = indices < 0
    if not negative.any():
        return indices - 1
    found = np.where(negative, np.repeat(before, counts) + indices, indices - 1)
    if (found[negative] < 0).any():
        first = int(np.flatnonzero(negative & (found < 0))[0])
        face = int(np.searchsorted(np.cumsum(counts), first, side="right"))
        raise ValueError(
            f"face {face} (counted from 0) has the index {int(indices[first])} of a {what}, and "
            f"{int(before[face])} are before it"
        )
    return found


def _coordinates(lines: TextLines) -> np.ndarray:
    """(T, 2) texture coordinates."""
    text = lines.some(lines.of_keyword(b"vt"), 2)
    words = words_per_line(text)
    numbers = np.append(parse_numbers(text, np.float64, "a texture coordinate"), 0.0)
    if len(numbers) != words.sum() + 1:
        raise no_number(text, np.float64, "a texture coordinate")
    first = np.cumsum(words) - words
    return np.stack([numbers[first], np.where(words > 1, numbers[np.minimum(first + 1, len(numbers) - 1)], 0.0)], axis=1)


def _materials(
    lines: TextLines, faces: Faces, places: np.ndarray, face: np.ndarray, colors: np.ndarray | None, source: MeshSource
) -> MeshMaterials | None:
    corner_colors = None
    if colors is not None:
        linear = to_linear(checked_colors(colors / 255.0 if np.nanmax(colors) > 1.0 else colors, "colours of vertices", source))
        corner_colors = np.ascontiguousarray(linear[faces.corners[places]])
    uv = None
    if (faces.uv >= 0).any():
        table = _coordinates(lines)
        if faces.uv.max() >= len(table):
            raise ValueError(f"a face refers to texture coordinate {int(faces.uv.max()) + 1}, but there are {len(table)}")
        at = faces.uv[places]
        uv = checked_uv(np.where((at >= 0)[..., None], table[at], 0.0), source)
    used = np.flatnonzero(lines.of_keyword(b"usemtl"))
    names = [lines.line(number)[7:].strip().decode("utf-8", "replace") for number in used.tolist()]
    libraries = [
        lines.line(n)[7:].strip().decode("utf-8", "replace") for n in np.flatnonzero(lines.of_keyword(b"mtllib")).tolist()
    ]
    chosen = np.searchsorted(used, faces.lines)  # 0 for faces before the first "usemtl"
    order, of_face = np.unique(chosen[face], return_inverse=True)
    listed = [names[number - 1] if number else "" for number in order.tolist()]
    unique = list(dict.fromkeys(listed))
    of_face = np.array([unique.index(name) for name in listed], dtype=np.int32)[of_face.reshape(-1)]  # type: ignore[assignment]
    if unique == [""]:
        if uv is None and corner_colors is None:
            return None
        return MeshMaterials((Material() if corner_colors is None else Material(color=1.0),), None, uv, corner_colors)
    found = read_materials_of([name for name in unique if name], libraries, uv is not None, source)
    maps = [found[name][1] if name else UvMap() for name in unique]
    if uv is not None and any(one != UvMap() for one in maps):
        for number, one in enumerate(maps):
            uv[of_face == number] = one(uv[of_face == number])
        uv = checked_uv(uv, source)  # a scale may lead out of float32
    return MeshMaterials(tuple(found[name][0] if name else Material() for name in unique), of_face, uv)
