"""Instances: one geometry placed many times, each time by an affine map.

**Problem.** A forest of one tree, or a plant with a thousand equal bolts, would need memory for every copy if it were flattened
into one mesh. An instance is a transform and the index of a geometry; the data of the triangles is stored once.

**Idea.** A ray is transformed into the geometry's space by the inverse map. Its direction is not normalised, so t has the same
meaning in both spaces, and hits of different instances can be compared.

**Precision.** Maps, inverse maps and origins are float64; the vertices of a geometry are float32 relative to its own centre.
The ray is rounded once, in the geometry's space, so an instance far from the origin loses no precision.

**Numbering.** Triangles are numbered through all instances: first those of instance 0, then those of instance 1, and so on. A
hit stores this number, and ties at the same t go to the smaller one: the smaller instance, then the smaller triangle.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import Ray, RayBatch, is_direction, is_finite, usable_direction

ALL_BITS = wp.constant(wp.uint32(0xFFFFFFFF))
"""The mask of a geometry that is visible to every ray."""


MAX_LISTED_INSTANCES = 16
"""Largest number of instances of an environment, and of shared ones, whose boxes a thread of a GPU tests one after the other,
rather than walking their tree (notebooks/records/2026-11-28-gpu-graphs.md)."""

LIST_BITS = 5
"""Bits of the word of a list that hold the number of its nodes."""


@wp.struct
class Geometry:
    """Triangles shared by instances."""

    vertices: wp.array(dtype=wp.vec3)
    """Relative to the geometry's centre."""
    faces: wp.array(dtype=wp.vec3i)
    first_face: int
    """Number of its first triangle among those of all geometries, each counted once."""


@wp.struct
class Placement:
    """The transform of an instance and its geometry."""

    to_scene: wp.mat33d
    """From the geometry's space to the scene: a point p relative to the geometry's centre maps to to_scene p + origin."""
    origin: wp.vec3d
    """Relative to the scene's centre."""
    to_object: wp.mat33d
    """The inverse of `to_scene`."""
    geometry: int
    first: int
    """Number of its first triangle."""
    mask: wp.uint32
    """A ray can hit the instance if the two masks have a bit in common."""


@wp.func
def scene_point(placement: Placement, point: wp.vec3):
    """Transforms a point of the geometry to the scene."""
    return placement.to_scene * wp.vec3d(point) + placement.origin


@wp.func
def scene_normal(placement: Placement, normal: wp.vec3):
    """Transforms a normal of the geometry to the scene.

    The result is not normalised. It stays on the same side of the surface if the map mirrors.
    """
    return wp.transpose(placement.to_object) * wp.vec3d(normal)


@wp.func
def centered_origin(rays: RayBatch, i: int):
    """Origin of ray number i relative to the scene's centre, in float64."""
    return wp.vec3d(rays.origins[i * rays.origin_stride]) - rays.center


@wp.func
def ray_mask(rays: RayBatch, i: int):
    """Mask of ray number i; all bits if the rays have no masks."""
    mask = ALL_BITS
    if rays.mask.shape[0] > 0:
        mask = rays.mask[i * rays.mask_stride]
    return mask


@wp.func
def ray_environment(rays: RayBatch, i: int):
    """Environment of ray number i; -1 if it sees the instances of all."""
    environment = int(-1)
    if rays.environment.shape[0] > 0:
        environment = rays.environment[i * rays.environment_stride]
    return environment


@wp.func
def object_ray(placement: Placement, origin: wp.vec3d, ray: Ray, t_max: float):
    """A valid ray in the geometry's space, up to t_max; invalid if the transformed ray exceeds the range of float32.

    Args:
        placement: the instance.
        origin: origin of the ray, relative to the scene's centre.
        ray: its direction and t_min.
        t_max: end of its range.
    """
    own = Ray()
    own.origin = wp.vec3(placement.to_object * (origin - placement.origin))
    own.direction = usable_direction(wp.vec3(placement.to_object * wp.vec3d(ray.direction)))
    own.t_min = ray.t_min
    own.t_max = t_max
    own.valid = is_finite(own.origin) and is_direction(own.direction)
    return own


@wp.struct
class SceneRay:
    """A ray of a scene of instances."""

    ray: Ray
    origin: wp.vec3d
    """Its origin relative to the scene's centre, as instances far from there need it in float64."""
    mask: wp.uint32
    environment: int


@wp.func
def scene_ray(rays: RayBatch, i: int, ray: Ray):
    """Ray number i, of which `load_ray` gave `ray`."""
    seen = SceneRay()
    seen.ray = ray
    seen.origin = centered_origin(rays, i)
    seen.mask = ray_mask(rays, i)
    seen.environment = ray_environment(rays, i)
    return seen
