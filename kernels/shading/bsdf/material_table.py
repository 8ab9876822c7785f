"""Materials as arrays, and what a material is at a point: its colour and roughness may come from images and vertex colours."""

import warp as wp

from wrt.kernels.images.image_footprint import footprint
from wrt.kernels.shading.bsdf.ggx import MIN_ALPHA

DIFFUSE = wp.constant(0)
MIRROR = wp.constant(1)
DIELECTRIC = wp.constant(2)
GLOSSY = wp.constant(3)

TILE = wp.constant(64)
"""Edge of the tiles of images, in texels: 16 KB a tile."""


@wp.struct
class Materials:
    """M materials, and the material of each triangle. Geometry shared by instances counts once."""

    of_face: wp.array(dtype=int)
    """(F,) or (1,) material of each triangle."""
    of_face_stride: int
    kind: wp.array(dtype=int)
    """(M,) `DIFFUSE`, `MIRROR`, `DIELECTRIC` or `GLOSSY`."""
    color: wp.array(dtype=wp.vec3)
    """(M,) linear: share of light that is scattered."""
    shape: wp.array(dtype=wp.vec4)
    """(M,) roughness, metallic, index of refraction, translucency."""
    emission: wp.array(dtype=wp.vec3)
    """(M,) emitted radiance."""
    two_sided: wp.array(dtype=int)
    """(M,) whether the back emits, too."""
    absorption: wp.array(dtype=wp.vec3)
    """(M,) per unit of length, inside dielectrics."""
    priority: wp.array(dtype=int)
    """(M,) of nested dielectrics."""
    color_texture: wp.array(dtype=int)
    """(M,) -1 for none."""
    surface_texture: wp.array(dtype=int)
    """(M,) roughness in green and metallic in blue; -1 for none."""
    has_uv: bool
    corner_uv: wp.array(dtype=wp.vec2)
    """(3 F,) texture coordinates, if `has_uv`."""
    has_color: bool
    corner_color: wp.array(dtype=wp.vec3)
    """(3 F,) linear, if `has_color`; multiplied with the colour."""
    texture_first: wp.array(dtype=int)
    """(T,) first texel of each image; its first tile if `tiled`."""
    texture_size: wp.array(dtype=wp.vec2i)
    """(T,) width and height."""
    texture_wrap: wp.array(dtype=wp.vec2i)
    """(T,) how each image goes on in u and v: `REPEAT`, `CLAMP` or `MIRROR_REPEAT`."""
    texels: wp.array(dtype=wp.uint32)
    """8 bits each of red, green, blue; row 0 is at the top, v = 1. If `tiled`, (places, TILE, TILE), flat."""
    tiled: bool
    """Whether `texels` holds only some tiles of the images."""
    tile_place: wp.array(dtype=int)
    """(tiles,) where each tile is in `texels`, if `tiled`; -1 for nowhere."""
    linear: wp.array(dtype=float)
    """(512,) values of the 256 levels: linear data, then sRGB."""


@wp.struct
class MaterialAtHit:
    """A material at a point."""

    number: int
    kind: int
    color: wp.vec3
    alpha: float
    """0 for a smooth surface."""
    metallic: float
    index: float
    translucency: float
    ratio: float
    """Of a dielectric: index of refraction on the side of the ray, divided by that beyond."""
    schlick: bool


@wp.func
def texel(materials: Materials, place: int, decode: int):
    """A texel, linear."""
    packed = materials.texels[place]
    return wp.vec3(
        materials.linear[decode + int(packed & wp.uint32(255))],
        materials.linear[decode + int((packed >> wp.uint32(8)) & wp.uint32(255))],
        materials.linear[decode + int((packed >> wp.uint32(16)) & wp.uint32(255))],
    )


@wp.func
def tile_of(materials: Materials, texture: int, column: int, row: int):
    """The tile that holds a texel."""
    return (
        materials.texture_first[texture]
        + (row / TILE) * ((materials.texture_size[texture][0] + TILE - 1) / TILE)
        + column / TILE
    )


@wp.func
def texel_place(materials: Materials, texture: int, column: int, row: int):
    """Where a texel is in `texels`."""
    place = int(0)
    if materials.tiled:
        tile = materials.tile_place[tile_of(materials, texture, column, row)]
        place = (tile * TILE + row % TILE) * TILE + column % TILE
    else:
        place = materials.texture_first[texture] + row * materials.texture_size[texture][0] + column
    return place


@wp.func
def texture_at(materials: Materials, texture: int, uv: wp.vec2, decode: int):
    """An image at texture coordinates, with bilinear interpolation."""
    at = footprint(materials.texture_size[texture], materials.texture_wrap[texture], uv)
    upper_left = texel(materials, texel_place(materials, texture, at.left, at.top), decode)
    upper_right = texel(materials, texel_place(materials, texture, at.right, at.top), decode)
    lower_left = texel(materials, texel_place(materials, texture, at.left, at.bottom), decode)
    lower_right = texel(materials, texel_place(materials, texture, at.right, at.bottom), decode)
    upper = (1.0 - at.across) * upper_left + at.across * upper_right
    lower = (1.0 - at.across) * lower_left + at.across * lower_right
    return (1.0 - at.down) * upper + at.down * lower


@wp.func
def corner_uv_at(materials: Materials, face: int, weights: wp.vec3):
    """Texture coordinates at a point of a triangle."""
    return (
        weights[0] * materials.corner_uv[3 * face]
        + weights[1] * materials.corner_uv[3 * face + 1]
        + weights[2] * materials.corner_uv[3 * face + 2]
    )


@wp.func
def material_at(materials: Materials, face: int, weights: wp.vec3):
    """The material at a point of a triangle."""
    number = materials.of_face[face * materials.of_face_stride]
    shape = materials.shape[number]
    material = MaterialAtHit()
    material.number = number
    material.kind = materials.kind[number]
    material.color = materials.color[number]
    roughness = shape[0]
    material.metallic = shape[1]
    material.index = shape[2]
    material.translucency = shape[3]
    if materials.has_color:
        material.color = wp.cw_mul(
            material.color,
            weights[0] * materials.corner_color[3 * face]
            + weights[1] * materials.corner_color[3 * face + 1]
            + weights[2] * materials.corner_color[3 * face + 2],
        )
    if materials.has_uv:
        texture = materials.color_texture[number]
        surface = materials.surface_texture[number]
        if texture >= 0 or surface >= 0:
            uv = corner_uv_at(materials, face, weights)
            if texture >= 0:
                material.color = wp.cw_mul(material.color, texture_at(materials, texture, uv, 256))
            if surface >= 0:
                found = texture_at(materials, surface, uv, 0)
                roughness = roughness * found[1]
                material.metallic = material.metallic * found[2]
    material.alpha = roughness * roughness
    if material.alpha < MIN_ALPHA:
        material.alpha = 0.0
    if material.kind == GLOSSY:
        material.alpha = wp.max(material.alpha, MIN_ALPHA)
    return material
