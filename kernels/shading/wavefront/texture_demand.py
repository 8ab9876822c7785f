"""Which tiles of images the rays of a generation need, before they are shaded.

Textures by tiles on demand, as in memory-coherent ray tracing (Pharr et al. 1997): the hits of a generation are known before
any of them is shaded, so what they read of the images is known, too. `wrt.imaging.integrators.texture_tiles` loads it.

References: pharr-1997.
"""

import warp as wp

from wrt.kernels.images.image_footprint import footprint
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.hit_attributes import triangle_of
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.bsdf.material_table import Materials, corner_uv_at, tile_of
from wrt.kernels.shading.wavefront.scene_light import LitScene


@wp.func
def mark_texels(materials: Materials, texture: int, uv: wp.vec2, needed: wp.array(dtype=int)):
    """Marks the tiles of the four texels at texture coordinates. Threads may mark the same tile: they write the same value."""
    if texture >= 0:
        at = footprint(materials.texture_size[texture], materials.texture_wrap[texture], uv)
        needed[tile_of(materials, texture, at.left, at.top)] = 1
        needed[tile_of(materials, texture, at.right, at.top)] = 1
        needed[tile_of(materials, texture, at.left, at.bottom)] = 1
        needed[tile_of(materials, texture, at.right, at.bottom)] = 1


@exact_kernel
def mark_tiles(first: int, start: int, scene: LitScene, hits: HitBatch, needed: wp.array(dtype=int)):
    """Marks the tiles that the material at a hit is read from, with 1. Item: a ray from `start` on."""
    i = start + first + wp.tid()
    primitive = hits.primitive[i]
    if primitive >= 0:
        face = int(primitive)
        if scene.shaded.records.shape[0] == 0:
            face = triangle_of(scene.shaded.mesh, primitive).face
        materials = scene.materials
        number = materials.of_face[face * materials.of_face_stride]
        uv = hits.uv[i]
        at = corner_uv_at(materials, face, wp.vec3(1.0 - uv[0] - uv[1], uv[0], uv[1]))
        mark_texels(materials, materials.color_texture[number], at, needed)
        mark_texels(materials, materials.surface_texture[number], at, needed)
