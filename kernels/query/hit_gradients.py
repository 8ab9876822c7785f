"""Where a ray meets the plane of a given triangle, as a kernel that Warp can run backwards.

**Problem.** Which triangle a ray hits first is a step function of ray and vertices: it has no useful derivative. Once the
triangle is known, where it is hit is a smooth function of both, and that is what fits to measured ranges, poses and shapes
descend along.

**Idea.** The search stays as it is. Its winners are intersected once more, by the formulas of Moeller and Trumbore, which are
short, and smooth as long as the ray is not in the plane:

    e1 = b - a, e2 = c - a, s = o - a, det = e1 . (d x e2),
    u = s . (d x e2) / det, v = d . (s x e1) / det, t = e2 . (s x e1) / det,
    position = o + t d, normal = (e1 x e2) / |e1 x e2|.

All in float64, whatever the arrays hold, so that points far from the origin keep their digits. Warp derives the adjoint; it
adds up what rays have in common (vertices, a shared origin) with atomics, which on the CPU one thread at a time must do.

**Limits.** With the triangle held fixed, derivatives know nothing of silhouettes: what changes because a ray slides from one
surface to another has no part in them. Towards grazing angles they grow as 1 / sine, as t itself moves.

References:
    T. Moeller, B. Trumbore: Fast, minimum storage ray-triangle intersection. Journal of Graphics Tools 2(1), 1997.
    T.-M. Li, M. Aittala, F. Durand, J. Lehtinen: Differentiable Monte Carlo ray tracing through edge sampling.
        ACM Transactions on Graphics 37(6), 2018 (on the part that is left out here).
"""

from functools import cache

import warp as wp

wp.set_module_options({"fuse_fp": False})


@cache
def make_kernel(Origin: type, Direction: type, Vertex: type, double: bool) -> wp.Kernel:
    """The kernel for arrays of these types, each vec3 or vec3d; `double`: whether it writes float64.

    A stride of 0 shares element 0 among all rays. What it does not write it leaves as it is: rays that hit nothing.
    """
    Scalar, Pair, Vector = (wp.float64, wp.vec2d, wp.vec3d) if double else (wp.float32, wp.vec2, wp.vec3)

    def meet_triangles(
        origins: wp.array(dtype=Origin),
        origin_stride: int,
        directions: wp.array(dtype=Direction),
        direction_stride: int,
        vertices: wp.array(dtype=Vertex),
        faces: wp.array(dtype=wp.vec3i),
        primitive: wp.array(dtype=int),
        t: wp.array(dtype=Scalar),
        uv: wp.array(dtype=Pair),
        positions: wp.array(dtype=Vector),
        normals: wp.array(dtype=Vector),
    ):
        i = wp.tid()
        if primitive[i] >= 0:
            face = faces[primitive[i]]
            a = wp.vec3d(vertices[face[0]])
            edge1 = wp.vec3d(vertices[face[1]]) - a
            edge2 = wp.vec3d(vertices[face[2]]) - a
            origin = wp.vec3d(origins[i * origin_stride])
            direction = wp.vec3d(directions[i * direction_stride])
            across = wp.cross(direction, edge2)
            det = wp.dot(edge1, across)
            if det != wp.float64(0.0):
                s = origin - a
                q = wp.cross(s, edge1)
                at = wp.dot(edge2, q) / det
                t[i] = Scalar(at)
                uv[i] = Pair(Scalar(wp.dot(s, across) / det), Scalar(wp.dot(direction, q) / det))
                positions[i] = Vector(origin + at * direction)
                normals[i] = Vector(wp.normalize(wp.cross(edge1, edge2)))

    return wp.kernel(meet_triangles, module="unique", enable_backward=True, module_options={"fuse_fp": False})
