"""Materials of trimesh objects: vertex and face colours, plain materials of OBJ files, and those of glTF."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from wrt.materials.material import Material, Texture, cutoff_of_image
from wrt.materials.mesh_materials import MeshMaterials

__all__ = ["read_materials"]


def read_materials(source: Any) -> MeshMaterials | None:
    """The materials of a trimesh.Trimesh; None if it has none.

    A glTF material becomes "glossy", with base colour, metallic share, roughness and emission, and the images of the first
    three; an OBJ material "diffuse", with its colour and image. Colours of vertices and triangles become colours of a diffuse
    surface. Colours are taken as sRGB, but glTF's factors and vertex colours as linear. Of alpha, glTF's mode MASK is read;
    normal maps and other images are not.
    """
    visual = getattr(source, "visual", None)
    kind = getattr(visual, "kind", None)
    faces = np.asarray(source.faces)
    if kind == "face":
        colors = to_linear(np.asarray(visual.face_colors)[:, :3] / 255.0)
        return MeshMaterials((Material(color=1.0),), corner_color=np.repeat(colors[:, None], 3, axis=1))
    if kind == "vertex":
        colors = to_linear(np.asarray(visual.vertex_colors)[:, :3] / 255.0)
        return MeshMaterials((Material(color=1.0),), corner_color=colors[faces])
    if kind != "texture" or visual.material is None:
        return None
    uv = getattr(visual, "uv", None)
    uv = None if uv is None or len(uv) != len(source.vertices) else np.asarray(uv, dtype=np.float32)[:, :2]
    if uv is not None and not np.isfinite(uv).all():
        warnings.warn("texture coordinates are NaN or infinite; coordinates and images are left out", stacklevel=2)
        uv = None
    corner_uv = None if uv is None else np.ascontiguousarray(uv[faces])
    inner = getattr(visual.material, "materials", None)
    if inner:
        materials = tuple(as_material(one, corner_uv is not None) for one in inner)
        numbers = getattr(visual, "face_materials", None)
        of_face = None if numbers is None else np.clip(np.asarray(numbers), 0, len(inner) - 1).astype(np.int32)
        return MeshMaterials(materials, of_face, corner_uv)
    return MeshMaterials((as_material(visual.material, corner_uv is not None),), corner_uv=corner_uv)


def as_material(source: Any, has_uv: bool) -> Material:
    """A material of trimesh; images only with texture coordinates."""
    if not hasattr(source, "metallicFactor"):
        image = getattr(source, "image", None) if has_uv else None
        color = np.ones(3) if image is not None else to_linear(_unit(getattr(source, "diffuse", None), 0.8))
        return Material(color=color, color_texture=None if image is None else Texture(image))
    base = source.baseColorTexture if has_uv else None
    surface = source.metallicRoughnessTexture if has_uv else None
    metallic, roughness = (1.0 if value is None else float(value) for value in (source.metallicFactor, source.roughnessFactor))
    emission = np.zeros(3) if source.emissiveFactor is None else np.asarray(source.emissiveFactor, dtype=np.float64)
    return Material(
        "glossy",
        color=_unit(source.baseColorFactor, 1.0),
        metallic=float(np.clip(metallic, 0.0, 1.0)),
        roughness=float(np.clip(roughness, 0.0, 1.0)),
        emission=np.zeros(3) if source.emissiveTexture is not None else np.maximum(emission, 0.0),
        color_texture=None if base is None else Texture(base),
        surface_texture=None if surface is None else Texture(surface),
        alpha_cutoff=alpha_cutoff(source),
    )


def alpha_cutoff(source: Any) -> float | None:
    """Of a glTF material of trimesh; None if its alpha is no mask."""
    if getattr(source, "alphaMode", None) != "MASK":
        return None
    factor = np.asarray(1.0 if source.baseColorFactor is None else source.baseColorFactor)
    alpha = float(factor[3]) / (255.0 if factor.dtype.kind in "iu" else 1.0) if factor.shape == (4,) else 1.0
    return cutoff_of_image(0.5 if source.alphaCutoff is None else float(source.alphaCutoff), alpha)


def to_linear(color: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] to linear, float32."""
    color = np.asarray(color, dtype=np.float64)
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _unit(color: Any, default: float) -> np.ndarray:
    """(3,) in [0, 1] of 8 bits or of floats."""
    if color is None:
        return np.full(3, default)
    array = np.asarray(color)
    return np.clip(array[:3] / (255.0 if array.dtype.kind in "iu" else 1.0), 0.0, 1.0).astype(np.float64)
