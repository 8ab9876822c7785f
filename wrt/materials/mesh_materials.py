"""The materials of a mesh's triangles, with texture coordinates and colours at their corners.

Everything is stored by triangle and corner, not by vertex: merging or splitting vertices does not change it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from wrt.kernels.validation import as_real_array, first_bad, host_array
from wrt.materials.material import Material, Texture

__all__ = ["MeshMaterials", "pack_materials", "unpack_materials"]

AT_TRIANGLES = ("of_face", "corner_uv", "corner_color")
"""Attributes that hold arrays of values at triangles."""


@dataclass(frozen=True, eq=False)
class MeshMaterials:
    """Materials of F triangles.

    Attributes:
        materials: the materials.
        of_face: (F,) int32, the material of each triangle; None: all have the first one.
        corner_uv: (F, 3, 2) float32 texture coordinates of the corners; None for none.
        corner_color: (F, 3, 3) float32 linear colours of the corners, which multiply the materials' own; None for none.
    """

    materials: tuple[Material, ...]
    of_face: np.ndarray | None = None
    corner_uv: np.ndarray | None = None
    corner_color: np.ndarray | None = None

    def numbers(self, count: int) -> np.ndarray:
        """(count,) int32: the material of each triangle."""
        return np.zeros(count, dtype=np.int32) if self.of_face is None else self.of_face

    def mirrored(self) -> MeshMaterials:
        """The same for triangles whose second and third corner are swapped."""
        swapped = {
            name: None if getattr(self, name) is None else np.ascontiguousarray(getattr(self, name)[:, [0, 2, 1]])
            for name in ("corner_uv", "corner_color")
        }
        return replace(self, **swapped)  # type: ignore[arg-type]


def make_mesh_materials(
    faces: np.ndarray, vertex_count: int, materials: Any, of_face: Any = None, uv: Any = None, colors: Any = None
) -> MeshMaterials:
    """Materials of a mesh, checked.

    Args:
        faces: (F, 3) vertex indices.
        vertex_count: V.
        materials: a `Material` or a sequence of them.
        of_face: (F,) the material of each triangle, as its place in the sequence; None: all have the first one.
        uv: (V, 2) or (F, 3, 2) texture coordinates of vertices or corners.
        colors: (V, 3) or (F, 3, 3) linear colours in [0, 1] of vertices or corners.

    Raises:
        TypeError, ValueError: wrong types, shapes or values.
    """
    listed = (materials,) if isinstance(materials, Material) else tuple(materials)
    if not listed or not all(isinstance(one, Material) for one in listed):
        raise TypeError(f"materials must be a wrt.Material or a non-empty sequence of them, not {materials!r}")
    if of_face is not None:
        of_face = host_array("of_face", of_face)
        if of_face.dtype.kind not in "iu" or of_face.shape != (len(faces),):
            raise ValueError(f"of_face must be integers of shape ({len(faces)},), not {of_face.dtype} of shape {of_face.shape}")
        if of_face.min() < 0 or of_face.max() >= len(listed):
            found = f"{of_face.min()} to {of_face.max()}"
            raise ValueError(f"of_face must be from 0 to {len(listed) - 1}, the materials, but ranges from {found}")
        of_face = of_face.astype(np.int32)
    return MeshMaterials(
        listed, of_face, _by_corner("uv", uv, faces, vertex_count, 2), _by_corner("colors", colors, faces, vertex_count, 3)
    )


def _by_corner(name: str, values: Any, faces: np.ndarray, vertex_count: int, width: int) -> np.ndarray | None:
    if values is None:
        return None
    array = as_real_array(name, values).astype(np.float32)
    if array.shape == (vertex_count, width):
        array = array[faces]
    if array.shape != (len(faces), 3, width):
        shapes = f"({vertex_count}, {width}) for vertices or ({len(faces)}, 3, {width}) for corners"
        raise ValueError(f"{name} must have shape {shapes}, not {array.shape}")
    if bad := first_bad(~np.isfinite(array).all(axis=2), array):
        raise ValueError(f"{name} must be finite, but that of [triangle, corner] {bad}")
    return np.ascontiguousarray(array)


def joined_materials(parts: Sequence[MeshMaterials | None], counts: Sequence[int], default: Material) -> MeshMaterials | None:
    """Materials of meshes of this many triangles, one after the other; those without get `default`. None if none has any."""
    if all(part is None for part in parts):
        return None
    known: dict[Material, int] = {}
    numbers, uvs, colors = [], [], []
    for part, count in zip(parts, counts, strict=True):
        part = MeshMaterials((default,)) if part is None else part
        own = np.array([known.setdefault(material, len(known)) for material in part.materials], dtype=np.int32)
        numbers.append(own[part.numbers(count)])
        uvs.append(part.corner_uv)
        colors.append(part.corner_color)
    return MeshMaterials(tuple(known), np.concatenate(numbers), _joined(uvs, counts, 2, 0.0), _joined(colors, counts, 3, 1.0))


def _joined(parts: list[np.ndarray | None], counts: Sequence[int], width: int, default: float) -> np.ndarray | None:
    if all(part is None for part in parts):
        return None
    filled = [
        np.full((count, 3, width), default, dtype=np.float32) if part is None else part
        for part, count in zip(parts, counts, strict=True)
    ]
    return np.concatenate(filled)


def pack_materials(mesh: MeshMaterials) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """For files: JSON of each material, and arrays by name. Images are shared: a material has the number of its own."""
    textures: dict[Texture, int] = {}
    listed = []
    for material in mesh.materials:
        values = {field.name: getattr(material, field.name) for field in fields(Material)}
        listed.append(
            {
                name: {"texture": textures.setdefault(value, len(textures)), "wrap": value.wrap}
                if isinstance(value, Texture)
                else value
                for name, value in values.items()
                if name != "alpha_cutoff" or value is not None  # without, files are as those of earlier versions
            }
        )
    arrays = {f"texture.{number}": with_alpha(texture) for texture, number in textures.items()}
    return listed, arrays | {name: getattr(mesh, name) for name in AT_TRIANGLES if getattr(mesh, name) is not None}


def with_alpha(texture: Texture) -> np.ndarray:
    """(H, W, 3) uint8, or (H, W, 4)."""
    return texture.pixels if texture.alpha is None else np.dstack([texture.pixels, texture.alpha])


def unpack_materials(listed: list[dict[str, Any]], arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The arguments of `TriangleMesh.with_materials`.

    Raises:
        TypeError, ValueError, KeyError: the values are no materials.
    """
    textures: dict[int, Texture] = {}

    def value(stored: Any) -> Any:
        if not isinstance(stored, dict):
            return stored
        number = int(stored["texture"])
        if number not in textures:  # files of earlier versions have no "wrap"
            textures[number] = Texture(arrays[f"texture.{number}"], wrap=stored.get("wrap", "repeat"))
        return textures[number]

    materials = [Material(**{name: value(stored) for name, stored in one.items()}) for one in listed]
    of_face, uv, colors = (arrays.get(name) for name in AT_TRIANGLES)
    return {"materials": materials, "of_face": of_face, "uv": uv, "colors": colors}
