"""What rays of a scene pass through: chosen triangles, and the holes of alpha masks.

**Triangles.** Rays meet the triangle records of a scene, which are made of its vertices and faces. A triangle that is left out
has corners that are NaN there, as the unused lanes of a block have: every triangle test turns it into a miss. So each engine
answers as without it, by the kernels of other scenes, and the tree stays. Boxes of the tree may be larger than what is left,
which costs time and changes no hit.

**Alpha masks.** Whether a point of a triangle is there depends on an image, so that hits are decided one by one in the walk
(`wrt.kernels.answers.alpha_mask`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import kept
from wrt.materials.material import WRAPS, Material
from wrt.materials.mesh_materials import MeshMaterials, joined_materials

if TYPE_CHECKING:
    from collections.abc import Sequence

    from wrt.kernels.query.hit_attributes import SceneMesh
    from wrt.meshes.mesh import TriangleMesh


@dataclass(frozen=True, eq=False)
class HitFilter:
    """What the rays of a scene, or of one mesh of its instances, pass through.

    Attributes:
        ignored: (F,) bool, the triangles that are left out; None for none.
        alpha: whether alpha masks of materials count.
        images: what `mask_images` has made of the materials that there are, which updates keep.
    """

    ignored: np.ndarray | None = None
    alpha: bool = False
    images: dict[Any, Any] = field(default_factory=dict, repr=False)


def shown_triangles(mesh: SceneMesh, ignored: np.ndarray) -> tuple[wp.array, wp.array]:
    """Vertices and faces in which the corners of some triangles are NaN: a vertex behind all others."""
    vertices, faces = mesh.vertices.numpy(), mesh.faces.numpy().copy()
    faces[ignored] = len(vertices)
    nowhere = np.full((1, 3), np.nan, dtype=np.float32)
    device = mesh.vertices.device
    with kept(device):
        return (
            wp.array(np.concatenate([vertices, nowhere]), dtype=wp.vec3, device=device),
            wp.array(faces, dtype=wp.vec3i, device=device),
        )


def has_masks(meshes: Sequence[TriangleMesh]) -> bool:
    """Whether a material of meshes has an alpha mask."""
    listed = [one for mesh in meshes if mesh.materials is not None for one in mesh.materials.materials]
    return any(one.alpha_cutoff is not None for one in listed)


def alpha_masks(hit_filter: HitFilter, meshes: Sequence[TriangleMesh], geometry_ids: Sequence[int], first: wp.array) -> Any:
    """The alpha masks of meshes, as kernels read them.

    Args:
        hit_filter: of their scene.
        meshes: in the order of their geometry ids.
        geometry_ids: the mesh of each instance; none in scenes without.
        first: (N + 1,) number of the first triangle of each instance or mesh, on the scene's device.
    """
    from wrt.kernels.answers.alpha_mask import AlphaMasks

    counts = tuple(mesh.triangle_count for mesh in meshes)
    key = tuple(mesh.materials for mesh in meshes), counts
    made = hit_filter.images.get(key)
    if made is None:
        made = mask_images(*key, first.device)
        hit_filter.images.clear()
        hit_filter.images[key] = made
    masks = AlphaMasks()
    for name in ("of_face", "corner_uv", "first_texel", "size", "wrap", "cutoff", "texels"):
        setattr(masks, name, getattr(made, name))
    faces = np.cumsum([0, *counts[:-1]])[list(geometry_ids)] if geometry_ids else np.zeros(0)
    with kept(first.device):
        masks.first_face = wp.array(faces.astype(np.int32), dtype=int, device=first.device)
    masks.first_triangle = first
    return masks


def mask_images(materials: tuple[MeshMaterials | None, ...], counts: tuple[int, ...], device: wp.Device) -> Any:
    """The part of `alpha_masks` that does not depend on instances: of the materials of meshes, and their triangle counts."""
    from wrt.kernels.answers.alpha_mask import AlphaMasks

    joined = joined_materials(materials, counts, Material()) or MeshMaterials((Material(),))
    numbers, cutoffs, wraps, images = [], [], [], []
    for material in joined.materials:
        if material.alpha_cutoff is None:
            numbers.append(-1)
            continue
        numbers.append(len(images))
        texture = material.color_texture if joined.corner_uv is not None else None
        opaque = texture is None or texture.alpha is None
        images.append(np.full((1, 1), 255, dtype=np.uint8) if opaque else texture.alpha)
        wraps.append([WRAPS.index(wrap) for wrap in (("repeat", "repeat") if texture is None else texture.wrap)])
        cutoffs.append(255.0 * material.alpha_cutoff)
    uv, total = joined.corner_uv, sum(counts)
    masks, sizes = AlphaMasks(), np.array([image.shape[::-1] for image in images], dtype=np.int32)
    with kept(device):
        masks.of_face = wp.array(np.array(numbers, dtype=np.int32)[joined.numbers(total)], dtype=int, device=device)
        corners = np.zeros((3 * total, 2), dtype=np.float32) if uv is None else uv.reshape(-1, 2)
        masks.corner_uv = wp.array(corners, dtype=wp.vec2, device=device)
        first = np.cumsum([0, *sizes.astype(np.int64).prod(axis=1)[:-1]])
        masks.first_texel = wp.array(first, dtype=wp.int64, device=device)
        masks.size = wp.array(sizes, dtype=wp.vec2i, device=device)
        masks.wrap = wp.array(np.array(wraps, dtype=np.int32), dtype=wp.vec2i, device=device)
        masks.cutoff = wp.array(np.array(cutoffs, dtype=np.float32), dtype=float, device=device)
        masks.texels = wp.array(np.concatenate([image.ravel() for image in images]), dtype=wp.uint8, device=device)
    return masks
