"""Points and what is near them, on the device."""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_kernel, specialised_kernel


@wp.struct
class PointBatch:
    """N points."""

    count: int
    position: wp.array(dtype=wp.vec3)
    """(N,) relative to the scene's centre."""
    exact: wp.array(dtype=wp.vec3d)
    """(N,) the same in float64, which scenes of instances read."""
    order: wp.array(dtype=int)
    """(N,) the order in which they are searched; (0,) for that in which they are given."""
    max_distance: wp.array(dtype=float)
    """(N,) or (1,) greatest distance at which a triangle is found; 0 or more."""
    distance_stride: int
    """1, or 0 if all points have the same."""
    mask: wp.array(dtype=wp.uint32)
    """(N,) or (1,) a point sees the instances whose masks have a bit in common with it; (0,) for all."""
    mask_stride: int
    environment: wp.array(dtype=int)
    """(N,) or (1,) a point sees the instances of this environment and those of -1; -1, or (0,), for those of all."""
    environment_stride: int


@wp.struct
class NearestBatch:
    """Triangles near points: the nearest to each of N points, or a list for each of them."""

    distance: wp.array(dtype=float)
    """inf if nothing was found."""
    primitive: wp.array(dtype=int)
    """-1 if nothing was found."""
    uv: wp.array(dtype=wp.vec2)
    """Weights of the triangle's second and third vertex; 0 if nothing was found."""
    feature: wp.array(dtype=wp.int8)
    """0 on a vertex, 1 on an edge, 2 on the face; -1 if nothing was found."""


@wp.struct
class NearLists:
    """Lists of triangles for N points."""

    found: NearestBatch
    room: int
    """Length of each list of nearest triangles, which begin at its multiples."""
    begin: wp.array(dtype=int)
    """(N,) where the list of each point begins."""
    count: wp.array(dtype=int)
    """(N,) its length."""


@cache
def make_widen(dtype: type) -> wp.Kernel:
    """The kernel that makes points of a type, vec3 or vec3d, relative to a scene's centre, in float64. Item: a point."""

    def relative_in_float64(first: int, center: wp.vec3d, given: wp.array(dtype=dtype), relative: wp.array(dtype=wp.vec3d)):
        i = first + wp.tid()
        relative[i] = wp.vec3d(given[i]) - center

    return specialised_kernel(relative_in_float64)


@exact_kernel
def copy_lists(first: int, lists: NearLists, begin: wp.array(dtype=int), to: NearestBatch):
    """Copies the list of a point to where it begins among others. Item: a point."""
    i = first + wp.tid()
    source = lists.begin[i]
    target = begin[i]
    for j in range(lists.count[i]):
        to.distance[target + j] = lists.found.distance[source + j]
        to.primitive[target + j] = lists.found.primitive[source + j]
        to.uv[target + j] = lists.found.uv[source + j]
        to.feature[target + j] = lists.found.feature[source + j]
