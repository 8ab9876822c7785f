"""Brute force over triangle fans: every ray against every fan (Galin and Akkouche 2005).

**Idea.** Let s be the vector from a fan's centre to the origin, and n = s x D. The sign of n . e tells on which side of the
plane through ray and centre a rim vertex at e (relative to the centre) lies. If two neighbours on the rim are on the same side,
the ray misses their triangle. A triangle therefore costs one dot product, which the next triangle reuses. If the signs differ,
with N = e_k x e_(k+1):

    u = -(n . e_(k+1)) / (N . D)    v = (n . e_k) / (N . D)    t = -(N . s) / (N . D)

are the weights of the two rim vertices and the distance. Both triangles at a spoke use the same number, so no ray passes
between them there; at the rim a ray may.

**Data.** A centre and M + 1 rim vertices for M triangles, as positions or (`edges`) as vectors from the centre, which saves the
subtraction, the only other operation per rim vertex. With `normals`, those of the triangles are precomputed too; they are read
only where signs differ. `planes` is Havel and Herout's test: each triangle has its normal and two planes through spokes, all
relative to the fan's centre, so that constants vanish and the ray is moved once for the fan. Speed:
notebooks/records/2026-11-21-fan-traversal.md, notebooks/records/2026-11-22-fan-normals.md and, with boxes and in trees,
notebooks/records/2026-11-23-fan-trees.md.

**Boxes.** A candidate is a hit if the ray meets the widened box of its triangle, as everywhere
(`wrt.kernels.simd.boxes`), so that trees with leaves of fans (`wrt.kernels.traversal.fan_trees`) give the same bits.

**Differences from the paper.** The determinant is not compared with a threshold: the comparisons reject the results of a
division by zero. The matrix form of the formula in Rahikainen (2013, equation 2.17) has the signs of u and v exchanged.

References: galin-akkouche-2005; havel-herout-2010; rahikainen-2013 (equations 2.17 and 2.18).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves, start
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch, load_ray, store_hit
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import RaySlabs, clamp_to_box, max_of, min_of, ray_slabs, reach
from wrt.kernels.triangle.support.vectors import cross, dot, miss


@wp.struct
class FanSet:
    """Fans on the device; `wrt.builders.triangle_fans.TriangleFans` documents the layout."""

    count: int
    first: wp.array(dtype=int)
    centre: wp.array(dtype=wp.vec3)
    """Relative to the scene's centre."""
    rim: wp.array(dtype=wp.vec3)
    """Relative to the scene's centre or, with `edges`, to the fan's centre."""
    primitive: wp.array(dtype=int)
    corner: wp.array(dtype=int)
    normal: wp.array(dtype=wp.vec3)
    """Of each triangle, with `normals`: the cross product of its two rim vertices relative to the fan's centre."""
    planes: wp.array2d(dtype=wp.vec3)
    """(F, 2) with `planes`: dot products with a point relative to the fan's centre are the weights of the two rim vertices."""
    low: wp.vec3
    """`low` and `high` bound all triangles."""
    high: wp.vec3


@wp.func
def meet(direction: wp.vec3, s: wp.vec3, normal: wp.vec3, x: float, x_following: float):
    """(t, u, v) for the triangle of two rim vertices on opposite sides of the ray; t is NaN for a miss."""
    scale = 1.0 / dot(normal, direction)
    u = -x_following * scale
    v = x * scale
    t = -dot(normal, s) * scale
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t - t == 0.0:
        return wp.vec3(t, u, v)
    return miss()


@wp.func
def weight(corner: int, vertex: int, u: float, v: float):
    """Weight of the triangle's vertex 1 or 2, where u and v are the weights of the rim vertices."""
    after = (vertex - corner + 6) % 3
    flipped = corner >= 3
    return wp.where(after == 0, (1.0 - u) - v, wp.where((after == 1) != flipped, u, v))


@wp.func
def meet_planes(direction: wp.vec3, s: wp.vec3, normal: wp.vec3, first: wp.vec3, second: wp.vec3):
    """(t, u, v) by Havel and Herout's test; the triangle's data relative to the fan's centre. t is NaN for a miss."""
    det = dot(normal, direction)
    t_scaled = -dot(normal, s)
    point = det * s + t_scaled * direction
    u_scaled = dot(first, point)
    v_scaled = dot(second, point)
    scale = 1.0 / det
    u = u_scaled * scale
    v = v_scaled * scale
    t = t_scaled * scale
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t - t == 0.0:
        return wp.vec3(t, u, v)
    return miss()


VERTICES, EDGES, NORMALS, PLANES = "vertices", "edges", "normals", "planes"
VERTICES_NORMALS = "vertices_normals"
FAN_FORMS = {
    VERTICES: "positions of the rim",
    VERTICES_NORMALS: "positions of the rim, and the triangles' normals",
    EDGES: "the rim relative to the fan's centre",
    NORMALS: "the rim relative to the fan's centre, and the triangles' normals",
    PLANES: "the same, with two planes of each triangle: Havel and Herout's test",
}
"""What is stored of a fan, by name."""


@cache
def make_fan_step(form: str) -> wp.Function:
    """`wp.func(fans, fan, ray, slabs, best) -> best`: tests the triangles of a fan; form: key in `FAN_FORMS`."""
    relative, known = form not in (VERTICES, VERTICES_NORMALS), form in (NORMALS, VERTICES_NORMALS)
    by_planes = form == PLANES

    @wp.func
    def step(fans: wp.ref[FanSet], fan: int, ray: Ray, slabs: wp.ref[RaySlabs], best: BestHit):
        centre = fans.centre[fan]
        s = ray.origin - centre
        n = cross(s, ray.direction)
        place = fans.first[fan]
        end = fans.first[fan + 1]
        e = fans.rim[place]
        if wp.static(not relative):
            e = e - centre
        x = dot(n, e)
        place += 1
        while place < end:
            following = fans.rim[place]
            if wp.static(not relative):
                following = following - centre
            x_following = dot(n, following)
            triangle = place - 1 - fan
            hit = miss()
            if wp.static(by_planes):
                hit = meet_planes(ray.direction, s, fans.normal[triangle], fans.planes[triangle, 0], fans.planes[triangle, 1])
            elif x * x_following <= 0.0:
                normal = wp.vec3()
                if wp.static(known):
                    normal = fans.normal[triangle]
                if wp.static(not known):
                    normal = cross(e, following)
                hit = meet(ray.direction, s, normal, x, x_following)
            if hit[0] == hit[0]:
                rim_low = min_of(centre + e, centre + following)
                rim_high = max_of(centre + e, centre + following)
                t = clamp_to_box(slabs, min_of(centre, rim_low), max_of(centre, rim_high), hit[0])
                if improves(t, fans.primitive[triangle], ray.t_min, best):
                    corner = fans.corner[triangle]
                    best.t = t
                    best.primitive = fans.primitive[triangle]
                    best.u = weight(corner, 1, hit[1], hit[2])
                    best.v = weight(corner, 2, hit[1], hit[2])
            e = following
            x = x_following
            place += 1
        return best

    return step


@cache
def make_fan_kernel(form: str) -> wp.Kernel:
    """The kernel for closest hits; form: key in `FAN_FORMS`."""
    step = make_fan_step(form)

    def brute_force_fans(first: int, fans: FanSet, rays: RayBatch, hits: HitBatch):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, fans.low, fans.high))
            for fan in range(fans.count):
                best = step(fans, fan, ray, slabs, best)
        store_hit(hits, i, best.t, best.primitive, best.u, best.v)

    return specialised_kernel(brute_force_fans)
