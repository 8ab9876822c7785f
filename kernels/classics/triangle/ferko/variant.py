"""The variants of Ferko and Ferko's test, generated from the same steps according to switches."""

from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.classics.triangle.ferko import triangle_bounds as bounds
from wrt.kernels.classics.triangle.ferko.pruning import FIXED_ORDER, order_part, prune, pruning_steps
from wrt.kernels.classics.triangle.ferko.record_part import Part, join, place
from wrt.kernels.classics.triangle.ferko.similarity import SIMILARITY, WEIGHTS, in_plane, weights
from wrt.kernels.classics.triangle.ferko.triangle_bounds import BOX, CIRCLE, in_box, in_circle, meets_sphere
from wrt.kernels.classics.triangle.ferko.unit_triangle import STEPS, UNIT_TRIANGLE, in_unit_triangle
from wrt.kernels.classics.triangle.published import FINITE, StepText, published
from wrt.kernels.triangle.support.axis_projection import main_axis
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, cross, dot, dotted, miss, three


@dataclass(frozen=True, kw_only=True)
class Variant:
    """The steps of a test. Every test intersects the plane.

    Attributes:
        fold: 0 for the unit-triangle transformation; 3 or 4 for that number of pruning comparisons.
        ordered: whether each triangle has its own order of comparisons, by the probability that they reject.
        weighted: whether the probabilities are weighted by the operations saved.
        sphere: whether the line must meet the bounding sphere; tested first.
        box: whether the point in the plane must lie in the triangle's box.
        circle: whether the point must lie in the bounding circle.
    """

    fold: int = 0
    ordered: bool = False
    weighted: bool = False
    sphere: bool = False
    box: bool = False
    circle: bool = False

    @property
    def order(self) -> Part | None:
        """The part that holds the triangle's own order; None if the order is fixed."""
        return order_part(self.fold, self.weighted) if self.ordered else None

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts of the triangle's record."""
        parts = (PLANE, SIMILARITY if self.fold else UNIT_TRIANGLE, self.order)
        bounds = (CIRCLE if self.sphere or self.circle else None, BOX if self.box else None)
        return tuple(part for part in (*parts, *bounds) if part is not None)


PlaneRow = wp.types.vector(length=4, dtype=wp.float32)


@wp.func
def derive_plane(corners: Corners):
    """The triangle's normal, scaled so that its largest component is 1, and the plane's constant. NaN for a triangle without
    area."""
    a = wp.vec3d(corners.a)
    normal = cross(wp.vec3d(corners.b) - a, wp.vec3d(corners.c) - a)
    normal = normal / normal[main_axis(normal)]
    return PlaneRow(float(normal[0]), float(normal[1]), float(normal[2]), float(dot(normal, a)))


PLANE = Part(("nx", "ny", "nz", "n0"), derive_plane)

POINT = f"""
    const float t = (n0 - {dotted("n", "o")}) / {dotted("n", "d")};
    const float px = ox + t * dx, py = oy + t * dy, pz = oz + t * dz;
"""
"""C++ for the point at which the line meets the plane. It is emitted before the first comparison that needs it. A ray parallel
to the plane has a t that is not finite and leaves at that comparison."""


@cache
def point_test(variant: Variant) -> wp.Function:
    """`wp.func(ray, own) -> vec4 (t, x, y, z)`: the point in the plane; t is NaN if a bound rejects it."""
    Own = wp.types.vector(length=join(variant.parts).own, dtype=wp.float32)
    circle_at, box_at = place(variant.parts, CIRCLE), place(variant.parts, BOX)
    sphere, circle, box = variant.sphere, variant.circle, variant.box

    @wp.func
    def find_point(ray: PlainRay, own: Own):
        none = wp.vec4(wp.nan, 0.0, 0.0, 0.0)
        kept = bool(True)
        if wp.static(sphere):
            kept = meets_sphere(ray, own, wp.static(circle_at))
        if not kept:
            return none
        normal = three(own, 0)
        t = (own[3] - dot(normal, ray.origin)) / dot(normal, ray.direction)
        point = ray.origin + t * ray.direction
        if wp.static(box):
            kept = in_box(point, t, ray, own, wp.static(box_at))
        if wp.static(circle):
            kept = kept and in_circle(point, own, wp.static(circle_at))
        if not kept:
            return none
        return wp.vec4(wp.where(t - t == 0.0, t, wp.nan), point[0], point[1], point[2])

    return find_point


@cache
def pruning_test(variant: Variant) -> wp.Function:
    """`wp.func(q, own) -> int`: number of comparisons made for a point Q of the triangle's own frame, negative if it was cut
    off."""
    Own = wp.types.vector(length=join(variant.parts).own, dtype=wp.float32)
    similarity_at = place(variant.parts, SIMILARITY)
    order_at = place(variant.parts, variant.order) if variant.ordered else 0
    fixed, ordered = FIXED_ORDER[variant.fold], variant.ordered

    @wp.func
    def make_comparisons(q: wp.vec2, own: Own):
        order = int(wp.static(fixed))
        if wp.static(ordered):
            order = int(own[wp.static(order_at)])
        return prune(order, q, own, wp.static(similarity_at))

    return make_comparisons


def make_intersect(variant: Variant) -> wp.Function:
    """`wp.func(ray, own) -> vec3 (t, u, v)`; t is NaN if the ray's line misses."""
    Own = wp.types.vector(length=join(variant.parts).own, dtype=wp.float32)
    find_point, pruned = point_test(variant), variant.fold > 0
    make_comparisons = pruning_test(variant) if pruned else None
    at = place(variant.parts, SIMILARITY if pruned else UNIT_TRIANGLE)

    @wp.func
    def by_unit_triangle(ray: PlainRay, own: Own):
        found = find_point(ray, own)
        if found[0] != found[0]:
            return miss()
        uv = in_unit_triangle(wp.vec3(found[1], found[2], found[3]), own, wp.static(at))
        return wp.vec3(wp.where(uv[0] == uv[0], found[0], wp.nan), uv[0], uv[1])

    @wp.func
    def by_pruning(ray: PlainRay, own: Own):
        found = find_point(ray, own)
        if found[0] != found[0]:
            return miss()
        q = in_plane(wp.vec3(found[1], found[2], found[3]), own, wp.static(at))
        if make_comparisons(q, own) < 0:
            return miss()
        uv = weights(q, own, wp.static(at))
        return wp.vec3(found[0], uv[0], uv[1])

    return by_pruning if pruned else by_unit_triangle


def make_steps(variant: Variant) -> list[StepText]:
    """The variant as steps. A point that passes the last comparison is a hit if t is finite."""
    steps = [bounds.BOX_STEP] * variant.box + [bounds.CIRCLE_STEP] * variant.circle
    steps += pruning_steps(variant.fold, variant.ordered) if variant.fold else STEPS
    exits, code, passes = map(list, zip(*steps, strict=True))
    code[0] = POINT + code[0]
    code[-1] += WEIGHTS if variant.fold else ""
    passes[-1] = f"({passes[-1]}) & ({FINITE})"
    return [bounds.SPHERE_STEP] * variant.sphere + list(zip(exits, code, passes, strict=True))


def make_test(name: str, variant: Variant) -> TriangleTest:
    """The triangle test of a variant."""
    names = tuple(name for part in variant.parts for name in part.names)
    return published(name, make_intersect(variant), *make_steps(variant), record=join(variant.parts), names=names)
