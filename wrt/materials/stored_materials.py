"""Materials of meshes in files: plain values as JSON, images and values at corners as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from wrt.materials.material import Material, Texture
from wrt.materials.mesh_materials import MeshMaterials

AT_TRIANGLES = ("of_face", "corner_uv", "corner_color")


def pack_materials(mesh: MeshMaterials) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """What JSON holds of each material, and arrays by name. Images are shared: a material has the number of its own."""
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
