"""Tables of materials and textures for kernels, and the records by which triangles are shaded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.imaging.integrators.texture_tiles import TextureTiles, packed_texels
from wrt.imaging.sampled_picture import corner_normals
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading.bsdf import material_table
from wrt.kernels.shading.shading_point import FaceRecord, ShadedMesh, make_face_records
from wrt.materials.material import KINDS, WRAPS, Material, Texture, check_materials
from wrt.materials.mesh_materials import MeshMaterials, joined_materials
from wrt.scene.scene import Scene

__all__ = ["SceneMaterials", "device_materials", "scene_materials", "shaded_mesh"]

_shaded: WeakKeyDictionary[Scene, tuple[SceneMesh, float | None, ShadedMesh]] = WeakKeyDictionary()

MAX_MATERIALS = (1 << 16) - 2
"""Materials have 16 bits in the list of nested dielectrics."""


@dataclass(frozen=True)
class SceneMaterials:
    """The materials of all triangles of a scene, geometry shared by instances once.

    Attributes:
        mesh: of the triangles of all meshes, in the order of `scene.meshes`.
        of_face: (F,) int32.
        emission: (M, 3) float64.
    """

    mesh: MeshMaterials
    of_face: np.ndarray
    emission: np.ndarray


def scene_materials(scene: Scene, materials: Any, default: Material) -> SceneMaterials:
    """The materials of a scene.

    Args:
        scene: the scene.
        materials: None for those of the meshes; a `Material` for all triangles, or one for each mesh. They replace those of the
            meshes, but keep their texture coordinates.
        default: of meshes without materials.

    Raises:
        TypeError, ValueError: not this many materials; more than 65534 together.
    """
    meshes = scene.meshes
    counts = [mesh.triangle_count for mesh in meshes]
    own: list[MeshMaterials | None] = [mesh.materials for mesh in meshes]
    if materials is not None:
        given = check_materials(materials, len(meshes), "meshes in the scene")
        uvs = [None if one is None else one.corner_uv for one in own]
        own = [MeshMaterials((material,), corner_uv=uv) for material, uv in zip(given, uvs, strict=True)]
    joined = joined_materials(own, counts, default) or MeshMaterials((default,))
    if len(joined.materials) > MAX_MATERIALS:
        raise ValueError(f"the scene has {len(joined.materials)} materials; at most {MAX_MATERIALS} are supported")
    emission = np.array([material.emission for material in joined.materials], dtype=np.float64)
    return SceneMaterials(joined, joined.numbers(sum(counts)), emission)


def device_materials(found: SceneMaterials, device: wp.Device) -> material_table.Materials:
    """The table of materials on a device, with whole images."""
    return tiled_materials(found, device, None)[0]


def tiled_materials(
    found: SceneMaterials, device: wp.Device, budget: int | None
) -> tuple[material_table.Materials, TextureTiles | None]:
    """The table of materials on a device, and the tiles of its images if the whole ones take more than this many bytes."""
    listed = found.mesh.materials
    table = material_table.Materials()
    same = not found.of_face.any()
    table.of_face = wp.array(found.of_face[:1] if same else found.of_face, dtype=int, device=device)
    table.of_face_stride = 0 if same else 1

    def column(dtype: type, values: list[Any]) -> wp.array:
        return wp.array(np.array(values, dtype=np.int32 if dtype is int else np.float32), dtype=dtype, device=device)

    table.kind = column(int, [KINDS.index(one.kind) for one in listed])
    table.color = column(wp.vec3, [one.color for one in listed])
    table.shape = column(wp.vec4, [(one.roughness, one.metallic, one.index, one.translucency) for one in listed])
    table.emission = column(wp.vec3, [one.emission for one in listed])
    table.two_sided = column(int, [one.two_sided for one in listed])
    table.absorption = column(wp.vec3, [one.absorption for one in listed])
    table.priority = column(int, [one.priority for one in listed])
    tiles = _add_textures(table, listed, found.mesh.corner_uv, device, budget)
    table.has_color = found.mesh.corner_color is not None
    if table.has_color:
        table.corner_color = wp.array(found.mesh.corner_color.reshape(-1, 3), dtype=wp.vec3, device=device)
    return table, tiles


def _add_textures(
    table: material_table.Materials,
    listed: tuple[Material, ...],
    corner_uv: np.ndarray | None,
    device: wp.Device,
    budget: int | None,
) -> TextureTiles | None:
    """Adds texture coordinates and all images, each once."""
    known: dict[Texture, int] = {}

    def number(texture: Texture | None) -> int:
        return -1 if texture is None or corner_uv is None else known.setdefault(texture, len(known))

    columns = [[number(one.color_texture) for one in listed], [number(one.surface_texture) for one in listed]]
    table.color_texture, table.surface_texture = (
        wp.array(np.array(values, dtype=np.int32), dtype=int, device=device) for values in columns
    )
    table.has_uv = bool(known)
    if not known:
        return None
    table.corner_uv = wp.array(corner_uv.reshape(-1, 2), dtype=wp.vec2, device=device)
    sizes = np.array([texture.pixels.shape[1::-1] for texture in known], dtype=np.int32)
    table.texture_size = wp.array(sizes, dtype=wp.vec2i, device=device)
    wraps = np.array([[WRAPS.index(wrap) for wrap in texture.wrap] for texture in known], dtype=np.int32)
    table.texture_wrap = wp.array(wraps, dtype=wp.vec2i, device=device)
    levels = np.arange(256) / 255.0
    curved = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    table.linear = wp.array(np.concatenate([levels, curved]).astype(np.float32), dtype=float, device=device)
    texels = sizes.astype(np.int64).prod(axis=1)
    if budget is not None and 4 * texels.sum() > budget:
        return TextureTiles(table, list(known), budget, device)
    firsts = np.cumsum([0, *texels[:-1]]).astype(np.int32)
    table.texture_first = wp.array(firsts, dtype=int, device=device)
    words = np.concatenate([packed_texels(texture.pixels).reshape(-1) for texture in known])
    table.texels = wp.array(words, dtype=wp.uint32, device=device)
    return None


def shaded_mesh(scene: Scene, crease_angle: float | None) -> ShadedMesh:
    """The triangles of a scene as shading reads them; smooth normals if there is a crease angle.

    The last one is kept until the scene changes: 64 bytes a triangle.
    """
    mesh, angle, made = _shaded.get(scene, (None, None, None))
    if made is None or mesh is not scene.state.device_mesh or angle != crease_angle:
        made = _new_shaded_mesh(scene, crease_angle)
        _shaded[scene] = scene.state.device_mesh, crease_angle, made
    return made


def _new_shaded_mesh(scene: Scene, crease_angle: float | None) -> ShadedMesh:
    made = ShadedMesh()
    made.mesh = scene.state.device_mesh
    made.is_smooth = crease_angle is not None
    if made.is_smooth:
        made.corner_normals = corner_normals(scene, crease_angle)
    if not scene.instances:
        made.records = wp.empty(scene.triangle_count, dtype=FaceRecord, device=scene.device)
        normals = made.corner_normals if made.is_smooth else wp.empty(0, dtype=wp.vec3, device=scene.device)
        inputs = [made.mesh, made.is_smooth, normals, made.records]
        launch(make_face_records, scene.triangle_count, inputs, device=scene.device)
    return made
