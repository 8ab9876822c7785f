"""On which side of a surface points are, by the pseudonormal at what is nearest to them.

**Problem.** The nearest point of the surface may be on an edge or a vertex, where triangles have different normals, and the
point may be in front of one of them and behind another.

**Idea.** The sum of the normals of all triangles there, each weighted with its angle at the vertex, tells the side rightly for
every closed surface that does not meet itself (Baerentzen and Aanaes 2005); at an edge, both angles are pi. Any point of the
vertex, the edge or the plane of the face serves as its foot, because the pseudonormal is perpendicular to the edge and to the
face.

References: baerentzen-aanaes-2005.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import is_finite
from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class Pseudonormals:
    """Normals of the vertices and of the edges of F triangles, not of unit length, and the triangles."""

    vertices: wp.array(dtype=wp.vec3)
    """(V,) relative to the scene's centre."""
    faces: wp.array(dtype=wp.vec3i)
    """(F,)"""
    of_vertex: wp.array(dtype=wp.vec3)
    """(V,)"""
    of_edge: wp.array2d(dtype=wp.vec3)
    """(F, 3), of the edges behind the first, the second and the third vertex."""
    scale: float
    """A power of two by which edges are multiplied, so that their products are normal numbers in tiny scenes, too."""


@exact_kernel
def find_sides(
    first: int,
    normals: Pseudonormals,
    points: wp.array(dtype=wp.vec3),
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    feature: wp.array(dtype=wp.int8),
    side: wp.array(dtype=wp.int8),
):
    """Writes -1 for a point behind the surface, 1 for one in front of it or on it, 0 if nothing was found. Item: a point."""
    i = first + wp.tid()
    found = primitive[i]
    side[i] = wp.int8(0)
    if found >= 0:
        face = normals.faces[found]
        weights = wp.vec3(1.0 - uv[i][0] - uv[i][1], uv[i][0], uv[i][1])
        kind = int(feature[i])
        at = int(0)
        normal = wp.cross(
            normals.scale * (normals.vertices[face[1]] - normals.vertices[face[0]]),
            normals.scale * (normals.vertices[face[2]] - normals.vertices[face[0]]),
        )
        if kind == 0:
            at = wp.where(weights[1] > weights[0], 1, 0)
            at = wp.where(weights[2] > weights[at], 2, at)
            normal = normals.of_vertex[face[at]]
        if kind == 1:
            smallest = wp.where(weights[1] < weights[0], 1, 0)
            smallest = wp.where(weights[2] < weights[smallest], 2, smallest)
            edge = (smallest + 1) % 3
            at = edge
            normal = normals.of_edge[found, edge]
        apart = points[i] - normals.vertices[face[at]]
        side[i] = wp.where(wp.dot(apart, normal) < 0.0, wp.int8(-1), wp.int8(1))


@exact_kernel
def sides_of_rule(first: int, inside: wp.array(dtype=wp.bool), side: wp.array(dtype=wp.int8)):
    """Writes -1 for a point that is inside, else 1. Item: a point."""
    i = first + wp.tid()
    side[i] = wp.where(inside[i], wp.int8(-1), wp.int8(1))


@exact_kernel
def sides_of_numbers(first: int, number: wp.array(dtype=float), side: wp.array(dtype=wp.int8)):
    """Writes -1 where a winding number is above 1/2 or below -1/2, else 1. Item: a point."""
    i = first + wp.tid()
    side[i] = wp.where(wp.abs(number[i]) > 0.5, wp.int8(-1), wp.int8(1))


@exact_kernel
def apply_signs(
    first: int,
    points: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    side: wp.array(dtype=wp.int8),
    found: wp.array(dtype=float),
):
    """Writes a distance with its sign, 0 without one; NaN for a point that is not finite, or has no side. Item: a point."""
    i = first + wp.tid()
    value = distance[i]
    if value > 0.0:
        value = value * float(side[i])
    if int(side[i]) == 0 or not is_finite(points[i]):
        value = wp.nan
    found[i] = value
