"""Instances: one geometry in many places, each an affine map of its own.

**Problem.** A forest of one tree, or a plant's thousand equal bolts, would take the memory of each copy if it were flattened
into one mesh. An instance is a transform and the number of a geometry; whatever is stored for triangles is stored once.

**Idea.** A ray is brought into the geometry's own space by the inverse map; its direction is transformed but not normalised,
so that t means the same in both spaces, and hits of different instances compare by it.

**Precision.** Maps, inverse maps and origins are float64, and a geometry's vertices are float32 relative to its own centre.
What is rounded is the ray in the geometry's space, once: an instance far from everything loses nothing by where it is.

**Numbers.** Triangles are numbered through all instances: those of instance 0, those of instance 1 and so on. A hit holds one
such number, and ties between hits at the same t go to the smaller one: the smaller instance, then the smaller triangle.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import Ray, RayBatch, is_direction, is_finite, usable_direction

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

ALL_BITS = wp.constant(wp.uint32(0xFFFFFFFF))
"""The mask that every geometry shows itself to."""


@wp.struct
class Geometry:
    """Triangles that instances share."""

    vertices: wp.array(dtype=wp.vec3)
    """Relative to the geometry's centre."""
    faces: wp.array(dtype=wp.vec3i)
    first_face: int
    """Number of its first triangle among those of all geometries, each counted once."""


@wp.struct
class Placement:
    """Where an instance is."""

    to_scene: wp.mat33d
    """From the geometry's space to the scene's: a point p relative to the geometry's centre goes to to_scene p + origin,"""
    origin: wp.vec3d
    """relative to the scene's centre."""
    to_object: wp.mat33d
    """The inverse of `to_scene`."""
    geometry: int
    first: int
    """Number of its first triangle."""
    mask: wp.uint32
    """Rays see the instance if they have a bit in common with it."""


@wp.func
def scene_point(placement: Placement, point: wp.vec3):
    """A point of the geometry, in the scene."""
    return placement.to_scene * wp.vec3d(point) + placement.origin


@wp.func
def scene_normal(placement: Placement, normal: wp.vec3):
    """A normal of the geometry, in the scene, not of unit length: it stays on the side that it was on, mirrored or not."""
    return wp.transpose(placement.to_object) * wp.vec3d(normal)


@wp.func
def centered_origin(rays: RayBatch, i: int):
    """Origin of ray number i relative to the scene's centre, not rounded to float32."""
    return wp.vec3d(rays.origins[i * rays.origin_stride]) - rays.center


@wp.func
def ray_mask(rays: RayBatch, i: int):
    """Mask of ray number i; all bits if rays have none."""
    mask = ALL_BITS
    if rays.mask.shape[0] > 0:
        mask = rays.mask[i * rays.mask_stride]
    return mask


@wp.func
def object_ray(placement: Placement, origin: wp.vec3d, ray: Ray, t_max: float):
    """A valid ray in the geometry's space, up to t_max; invalid if the map takes it beyond float32.

    Args:
        placement: the instance.
        origin: of the ray, relative to the scene's centre.
        ray: its direction and t_min.
        t_max: where it ends.
    """
    own = Ray()
    own.origin = wp.vec3(placement.to_object * (origin - placement.origin))
    own.direction = usable_direction(wp.vec3(placement.to_object * wp.vec3d(ray.direction)))
    own.t_min = ray.t_min
    own.t_max = t_max
    own.valid = is_finite(own.origin) and is_direction(own.direction)
    return own
