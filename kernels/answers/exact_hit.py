"""The closest hit in float64, found through a float32 tree; asked by `wrt.kernels.query.exact_closest`.

**Problem.** A float32 tree is half as large as a float64 tree, faster to traverse, and precise enough to find the
triangles that a ray may hit. It does not decide which of two triangles is hit first if they are closer together than float32
resolves, nor on which side of an edge the ray passes, nor t to more than seven digits. Recomputing the t of the float32 hit in
float64 would solve only the last problem.

**Idea.** Boxes are conservative: the slack of `wrt.kernels.simd.boxes`, 16 roundings of half a unit in the last place of the
ray's reach, also covers the rounding of origin, direction and vertices to float32 (one each) and the rounding of the box test
(three). Every triangle that the exact ray hits therefore lies in a leaf that the rounded ray visits, and the rounded ray enters
its box no later than at its exact t. In the leaf the triangle is tested in float64, with ray and vertices as the caller gave
them. The result is that of brute force in float64 over all triangles.

**Bounds on t.** The float32 walk uses the rounded t of the best hit and of both ends of the range. These need no margin:

    u, R              2^-24; reach of the ray
    t                 of the exact hit; along any axis t |d| <= R
    origin            rounded once, |o| <= R                              1 u R
    direction         rounded once: t d moves by u t |d|                  1 u R
    vertices          rounded once, |v| <= R                              1 u R
    in, plane - in    as in the proof of `wrt.kernels.simd.boxes`         2 u R
    1 / d             likewise                                            1 u R
    slack                                                               -16 u R
    entry             is a product, fl(y) with y |d| <= t |d| - 10 u R

The last step of computing the entry is itself a rounding, and rounding is monotone: y <= t, so the entry is at most float32(t),
also near zero, where float32 has few digits. Likewise boxes are left no earlier than float32(t_min). Ten of 16 roundings are
slack. Searched by `exact` of tests/bounds.

**Test.** Woop's test: the vertices are sheared so that the ray is an axis; three signed areas decide whether it passes through.
An area is the difference of two products, and rounding is monotone, so its sign is correct or it is zero. Zero counts as
inside: no ray passes through at an edge or a vertex.

**Limits.** If a triangle is so thin that even float64 cannot locate the ray along it (its height is below 1e-16 of the ray's
reach), its t may precede the entry of its box. Whether that hit is found then depends on the tree.

References: woop-2013; ize-2013.
"""

import warp as wp

from wrt.kernels.answers.answer_kind import HIT_COLUMNS, AnswerKind, BestHit, Rules, Search, Stored


@wp.struct
class ExactSearch:
    """Ray and triangles in float64, as the caller gave them, and the closest hit so far."""

    origin: wp.vec3d
    direction: wp.vec3d
    t_min: wp.float64
    vertices: wp.array(dtype=wp.vec3d)
    faces: wp.array(dtype=wp.vec3i)
    t: wp.float64
    """t of the closest hit; before the first hit, the ray's t_max."""
    primitive: int
    """-1 before the first hit."""
    u: wp.float64
    v: wp.float64


@wp.func
def shear(point: wp.vec3d, origin: wp.vec3d, direction: wp.vec3d, axis: int):
    """A point in the sheared frame of the ray: (x, y) relative to the ray, and its t. axis: `dominant_axis(direction)`."""
    x = (axis + 1) % 3
    y = (axis + 2) % 3
    t = (point[axis] - origin[axis]) / direction[axis]
    return wp.vec3d((point[x] - origin[x]) - direction[x] * t, (point[y] - origin[y]) - direction[y] * t, t)


@wp.func
def dominant_axis(direction: wp.vec3d):
    """Axis of the component with the largest absolute value."""
    size = wp.vec3d(wp.abs(direction[0]), wp.abs(direction[1]), wp.abs(direction[2]))
    axis = wp.where(size[1] > size[0], 1, 0)
    return wp.where(size[2] > wp.max(size[0], size[1]), 2, axis)


@wp.func
def test_exactly(search: wp.ref[ExactSearch], primitive: int):
    """Tests a triangle in float64 and keeps the hit if it is the closest so far; at the same t the smaller triangle id wins."""
    axis = dominant_axis(search.direction)
    face = search.faces[primitive]
    a = shear(search.vertices[face[0]], search.origin, search.direction, axis)
    b = shear(search.vertices[face[1]], search.origin, search.direction, axis)
    c = shear(search.vertices[face[2]], search.origin, search.direction, axis)
    zero = wp.float64(0.0)
    area_a = b[0] * c[1] - b[1] * c[0]
    area_b = c[0] * a[1] - c[1] * a[0]
    area_c = a[0] * b[1] - a[1] * b[0]
    total = (area_a + area_b) + area_c
    front = area_a >= zero and area_b >= zero and area_c >= zero
    back = area_a <= zero and area_b <= zero and area_c <= zero
    if (front or back) and total != zero:
        t = ((area_a * a[2] + area_b * b[2]) + area_c * c[2]) / total + zero  # never -0
        nearer = t < search.t or (t == search.t and (search.primitive < 0 or primitive < search.primitive))
        if nearer and t >= search.t_min:
            search.t = t
            search.primitive = primitive
            search.u = area_b / total
            search.v = area_c / total


@wp.func
def exact_best(search: wp.ref[ExactSearch], best: BestHit):
    """The closest hit so far, with its t rounded to float32, by which the walk goes on."""
    if search.primitive >= 0:
        best.primitive = search.primitive
        best.t = wp.min(best.t, wp.float32(search.t))
    return best


KIND = AnswerKind(
    "exact",
    Rules(shortens=True, front_to_back=True),
    Stored(HIT_COLUMNS),
    Search(ExactSearch, own_test=test_exactly, best_of=exact_best),
)
