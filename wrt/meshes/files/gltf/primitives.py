"""Meshes of glTF: primitives as triangles, with morph targets at their default weights, colours and texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wrt.materials.material import Material, cutoff_of_image
from wrt.materials.mesh_materials import MeshMaterials
from wrt.meshes.files.corner_values import checked_colors, checked_uv
from wrt.meshes.files.gltf.document import Document
from wrt.meshes.files.gltf.gltf_materials import GltfMaterials

__all__ = ["Part", "mesh_parts"]

LIST, STRIP, FAN = 4, 5, 6
"""Modes of triangles; those below are points and lines."""


@dataclass
class Part:
    """A primitive's triangles.

    Attributes:
        vertices: (V, 3) float64, in the mesh's space.
        faces: (F, 3).
        materials: of the triangles; None for none.
        attributes: accessors by name.
    """

    vertices: np.ndarray
    faces: np.ndarray
    materials: MeshMaterials | None
    attributes: dict[str, Any] = field(default_factory=dict)


def mesh_parts(document: Document, index: Any, weights: Any, materials: GltfMaterials | None) -> list[Part]:
    """The primitives of a mesh that are triangles.

    Args:
        document: the file.
        index: of the mesh.
        weights: of morph targets, of the node; None for those of the mesh.
        materials: None if they are not wanted.

    Raises:
        ValueError: broken structure, indices of vertices that are not there, or data in a compressed form.
    """
    mesh = document.item("meshes", index)
    weights = mesh.get("weights") if weights is None else weights
    parts = []
    primitives = mesh.get("primitives", [])
    for number, primitive in enumerate(primitives):
        what = f"meshes[{index}].primitives[{number}]"
        mode = primitive.get("mode", LIST)
        if isinstance(mode, bool) or mode not in range(7):
            raise ValueError(f"{what} has the mode {mode!r}; those of glTF are 0 to 6")
        if mode >= LIST:
            parts += _part(document, primitive, mode, weights, materials, what)
    return parts


def _part(
    document: Document, primitive: dict[str, Any], mode: int, weights: Any, materials: GltfMaterials | None, what: str
) -> list[Part]:
    attributes = primitive["attributes"]
    compressed = [name for name in primitive.get("extensions", {}) if name.endswith("_compression")]
    if "POSITION" not in attributes:
        return []
    try:
        vertices = document.accessor(attributes["POSITION"], ("VEC3",), f"POSITION of {what}").astype(np.float64)
        faces = _triangles(document, primitive, mode, len(vertices), what)
    except ValueError as error:
        if compressed:
            raise ValueError(f"{what} is compressed by {', '.join(compressed)}, which is not supported: {error}") from None
        raise
    vertices = _morphed(document, primitive, vertices, weights, what)
    found = None if materials is None else _looks(document, primitive, faces, materials, what)
    return [Part(vertices, faces, found, attributes)] if len(faces) else []


def _triangles(document: Document, primitive: dict[str, Any], mode: int, vertex_count: int, what: str) -> np.ndarray:
    """(F, 3) vertex indices."""
    if primitive.get("indices") is None:
        indices = np.arange(vertex_count)
    else:
        indices = document.accessor(primitive["indices"], ("SCALAR",), f"indices of {what}")[:, 0]
        if indices.dtype.kind != "u":
            raise ValueError(f"indices of {what} are not of an unsigned type")
        if len(indices) and indices.max() >= vertex_count:
            raise ValueError(f"indices of {what} go up to {int(indices.max())}, and there are {vertex_count} vertices")
    indices = indices.astype(np.int64)
    if mode == LIST:
        if len(indices) % 3:
            raise ValueError(f"{what} has {len(indices)} indices of triangles, which is no multiple of three")
        return indices.reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    a, b, c = indices[:-2], indices[1:-1], indices[2:]
    if mode == FAN:
        return np.stack([np.broadcast_to(indices[0], a.shape), b, c], axis=1)
    odd = np.arange(len(a)) % 2 == 1
    return np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)


def _morphed(document: Document, primitive: dict[str, Any], vertices: np.ndarray, weights: Any, what: str) -> np.ndarray:
    targets = primitive.get("targets") or []
    if not targets or not weights:
        return vertices
    given = np.array(weights, dtype=np.float64)
    if given.shape != (len(targets),) or not np.isfinite(given).all():
        raise ValueError(f"the weights of {what} are {str(weights)[:60]}, and it has {len(targets)} morph targets")
    for weight, target in zip(given.tolist(), targets, strict=True):
        if weight != 0.0 and "POSITION" in target:
            shift = document.accessor(target["POSITION"], ("VEC3",), f"a morph target of {what}")
            if len(shift) != len(vertices):
                raise ValueError(f"a morph target of {what} has {len(shift)} points for {len(vertices)} vertices")
            vertices = vertices + weight * shift.astype(np.float64)
    return vertices


def _looks(
    document: Document, primitive: dict[str, Any], faces: np.ndarray, materials: GltfMaterials, what: str
) -> MeshMaterials | None:
    """Material, texture coordinates and colours of a primitive's triangles."""
    attributes, source = primitive["attributes"], document.source
    colors, alpha = None, 1.0
    used = materials.of(primitive.get("material"))
    if "COLOR_0" in attributes:
        values = document.accessor(attributes["COLOR_0"], ("VEC3", "VEC4"), f"COLOR_0 of {what}")
        if values.dtype.kind in "iu":
            raise ValueError(f"COLOR_0 of {what} are integers that are not normalised")
        shown = checked_colors(values[:, :3].astype(np.float64), "colours of vertices", source)
        colors = np.ascontiguousarray(_at_corners(shown, faces, "COLOR_0", what), dtype=np.float32)
        if values.shape[1] == 4 and used.plain is not None and used.plain.alpha_cutoff is not None:
            alpha = _one_alpha(_at_corners(values[:, 3:], faces, "COLOR_0", what), document, what)
    uv, name = None, f"TEXCOORD_{used.texcoord}"
    if name in attributes:
        values = document.accessor(attributes[name], ("VEC2",), f"{name} of {what}").astype(np.float64)
        values = used.transform(_at_corners(values, faces, name, what))
        uv = checked_uv(values * (1.0, -1.0) + (0.0, 1.0), source)  # v grows downward in glTF, upward here
    if used.textured is not None and uv is not None:
        return MeshMaterials((_thinned(used.textured(), alpha),), None, uv, colors)
    if used.textured is not None and name not in attributes and used.has_images:
        source.warn(f"the material {used.name} has images, and {what} has no {name} to place them; they are left out")
    if used.plain is None:
        if colors is None and uv is None:
            return None
        return MeshMaterials((Material() if colors is None else Material(color=1.0),), None, uv, colors)
    return MeshMaterials((_thinned(used.plain, alpha),), None, uv, colors)


def _one_alpha(values: np.ndarray, document: Document, what: str) -> float:
    """The alpha that all corners have, from 0 to 1; 1 with a warning if they differ."""
    clipped = np.clip(np.nan_to_num(values.astype(np.float64), nan=1.0), 0.0, 1.0)
    low, high = clipped.min(initial=1.0), clipped.max(initial=0.0)
    if low >= high:
        return float(low)
    document.source.warn(
        f"COLOR_0 of {what} has alpha from {low:g} to {high:g}; it is read where all are the same, and left out"
    )
    return 1.0


def _thinned(material: Material, alpha: float) -> Material:
    """A material whose alpha is multiplied, if it is a mask."""
    if material.alpha_cutoff is None or alpha == 1.0:
        return material
    return replace(material, alpha_cutoff=cutoff_of_image(material.alpha_cutoff, alpha))


def _at_corners(values: np.ndarray, faces: np.ndarray, name: str, what: str) -> np.ndarray:
    """(F, 3, k): the values of the triangles' corners."""
    if len(faces) and faces.max() >= len(values):
        raise ValueError(f"{name} of {what} has {len(values)} rows, fewer than there are vertices")
    return values[faces]
