"""OFF: vertices and polygons as text, with colours of vertices (COFF).

The first word tells what a vertex has: C for a colour of three or four numbers, N for a normal, ST for texture coordinates, in
any order. A vertex is its line's first three numbers; then come the normal, the colour and the texture coordinates. MeshLab
writes NC and the colour before the normal. Colours of faces are skipped. Files in four or n dimensions, and binary ones, are
refused.

References: geometry-center-1996.
"""

from __future__ import annotations

import re

import numpy as np

from wrt.materials.material import Material
from wrt.materials.mesh_materials import MeshMaterials
from wrt.materials.trimesh_materials import to_linear
from wrt.meshes.files.corner_values import checked_colors, checked_uv
from wrt.meshes.files.mesh_source import FileMesh, MeshSource
from wrt.meshes.files.text_lines import no_number, parse_numbers, plain_text, words_per_line
from wrt.meshes.files.triangulation import triangulate
from wrt.meshes.up_axis import stated_up

__all__ = ["read_off"]

FIRST_WORD = re.compile(rb"(?P<letters>(?:ST|[CN4n])*)OFF(?P<binary> BINARY)?(?=[ \n]|$)")


def read_off(data: bytes, source: MeshSource) -> FileMesh:
    """Reads a file.

    Raises:
        ValueError: it is no OFF file or of a kind that is not read, is cut off, or its faces refer to vertices that it has not.
    """
    remarks = [line.strip()[1:] for line in data[: 1 << 12].decode("latin-1").splitlines() if line.lstrip().startswith("#")]
    text = re.sub(rb"#[^\n]*", b"", plain_text(data)).lstrip()
    word = FIRST_WORD.match(text)
    if word is None:
        raise ValueError(f"it begins with {text[:20].decode(errors='replace')!r} and not with the word OFF")
    letters = word["letters"]
    for is_so, what in (
        (b"4" in letters, "vertices of four coordinates"),
        (b"n" in letters, "vertices of any dimension"),
        (word["binary"], "binary numbers"),
    ):
        if is_so:
            raise ValueError(f"its first word '{word[0].decode()}' announces {what}, which are not read; save it as plain OFF")
    text = re.sub(rb"\n[ \n]*\n", b"\n", text[word.end() :].lstrip())
    counts_line, _, body = text.partition(b"\n")
    counts = parse_numbers(counts_line, np.int64, "the line of counts")
    if len(counts) < 2 or counts.min() < 0:
        raise ValueError("it has no line with the numbers of vertices and faces")
    return _mesh(body, int(counts[0]), int(counts[1]), letters, remarks, source)


def _mesh(body: bytes, vertex_count: int, face_count: int, letters: bytes, remarks: list[str], source: MeshSource) -> FileMesh:
    words = words_per_line(body)
    if len(words) < vertex_count + face_count:
        raise ValueError(
            f"it announces {vertex_count} vertices and {face_count} faces, and has {len(words)} lines for "
            "them; is the file complete?"
        )
    if len(words) > vertex_count + face_count:
        source.warn(f"{len(words) - vertex_count - face_count} lines behind the last face are not read")
    numbers = parse_numbers(body, np.float64, "the file")
    if len(numbers) != words.sum():
        raise no_number(body, np.float64, "the file")
    first = np.cumsum(words) - words
    if vertex_count == 0 or words[:vertex_count].min() < 3:
        raise ValueError(
            "no triangles in it: it has no vertices" if vertex_count == 0 else "a vertex has fewer than three numbers"
        )
    vertices = numbers[first[:vertex_count, None] + np.arange(3)]
    begin, widths = first[vertex_count : vertex_count + face_count], words[vertex_count : vertex_count + face_count]
    lengths = numbers[begin]
    if (~((lengths >= 0) & (lengths == np.floor(lengths)) & (lengths < widths))).any():
        bad = int(np.argmax(~((lengths >= 0) & (lengths == np.floor(lengths)) & (lengths < widths))))
        raise ValueError(f"face {bad} announces {lengths[bad]:g} corners and has {int(widths[bad]) - 1} numbers")
    lengths = lengths.astype(np.int64)
    corner = np.arange(int(lengths.sum())) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    indices = numbers[np.repeat(begin + 1, lengths) + corner]
    whole = np.rint(np.nan_to_num(indices, nan=-1.5, posinf=1e18, neginf=-1e18)).astype(np.int64)
    if (whole != indices).any():
        raise ValueError(f"a face refers to vertex {indices[whole != indices][0]:g}, which is no index")
    if not (lengths >= 3).any():
        raise ValueError("no triangles in it: it has no faces")
    few = int(np.count_nonzero(lengths < 3))
    if few:
        source.warn(f"{few} faces of fewer than three corners are left out")
    places, _ = triangulate(vertices, whole, lengths)
    mesh = FileMesh(vertices, whole[places], up=stated_up(remarks))
    if source.materials is not False:
        mesh.materials = _materials(numbers, first[:vertex_count], words[:vertex_count], letters, mesh.faces, source)
    return mesh


def _materials(
    numbers: np.ndarray, first: np.ndarray, words: np.ndarray, letters: bytes, faces: np.ndarray, source: MeshSource
) -> MeshMaterials | None:
    """Colours and texture coordinates of vertices, which stand behind positions and normals."""
    at = 3 + 3 * (b"N" in letters and b"NC" not in letters)
    shortest, behind = int(words.min()), 2 * (b"ST" in letters)
    colors = uv = None
    if b"C" in letters and shortest >= at + 3 + behind:
        given = numbers[first[:, None] + np.arange(at, at + 3)]
        levels = given / 255.0 if np.nanmax(given, initial=0.0) > 1.0 else given
        colors = np.ascontiguousarray(to_linear(checked_colors(levels, "colours of vertices", source))[faces])
    if b"ST" in letters and shortest >= at + behind:
        uv = checked_uv(numbers[(first + words - 2)[:, None] + np.arange(2)][faces], source)
    if colors is None and uv is None:
        return None
    return MeshMaterials((Material() if colors is None else Material(color=1.0),), None, uv, colors)
