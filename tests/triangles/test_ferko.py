"""Ferko and Ferko's test: every formula of it against float64, and the variants against each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.meshes import degenerate_soup
from support.triangle_pairs import all_pairs

import wrt
from studies.triangles.leaf_queries import leaf_query
from studies.triangles.pichler_tables import count_comparisons
from wrt.kernels.classics.triangle.ferko import VARIANTS
from wrt.kernels.classics.triangle.ferko import triangle_bounds as bounds
from wrt.kernels.classics.triangle.ferko.pruning import ABOVE, BELOW, FIXED_ORDER, LEFT, RIGHT, order_part, shares
from wrt.kernels.classics.triangle.ferko.record_part import join, place
from wrt.kernels.classics.triangle.ferko.similarity import SIMILARITY, Similarity
from wrt.kernels.classics.triangle.ferko.unit_triangle import UNIT_TRIANGLE
from wrt.kernels.classics.triangle.ferko.variant import PLANE, Variant
from wrt.kernels.runtime.launch import launch
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import pack_blocks

pytestmark = pytest.mark.classics

RNG = np.random.default_rng(4)
CORNERS = np.concatenate([RNG.normal(size=(120, 3, 3)), 1e3 + RNG.normal(size=(20, 3, 3))]).astype(np.float32)
EVERYTHING = (PLANE, UNIT_TRIANGLE, SIMILARITY, bounds.CIRCLE, bounds.BOX, order_part(3, False), order_part(4, True))


def floats_of(parts, corners, device="cpu"):
    """(triangles, floats) what a record keeps of triangles besides the vertices."""
    record = join(parts)
    vertices = wp.array(corners.reshape(-1, 3), dtype=wp.vec3, device=device)
    faces = wp.array(np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3), dtype=wp.vec3i, device=device)
    ids = wp.array(np.arange(len(corners), dtype=np.int32), dtype=int, device=device)
    values = pack_blocks(record, vertices, faces, ids, 1).records.numpy()
    return values.reshape(len(corners), record.components)[:, 9:].astype(np.float64)


@pytest.fixture(scope="module")
def kept():
    """The floats of every part of every triangle in CORNERS, by the names of the steps."""
    values = floats_of(EVERYTHING, CORNERS)
    return {part: values[:, place(EVERYTHING, part) :][:, : len(part.names)] for part in EVERYTHING}


def rotated(corners):
    """(3, 4) transformation of the paper: moved, turned about z, y and x, scaled, and mirrored twice where needed; and C'.

    The corners are those of A, B, C with the longest edge first.
    """
    a, b, c = corners
    move = np.eye(4)
    move[:3, 3] = -a
    bz = np.hypot(*(b - a)[:2])
    cos, sin = (1.0, 0.0) if bz == 0 else ((b - a)[:2] / bz) * (1, -1)
    about_z = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    to = (about_z @ move @ [*b, 1])[:3]
    cos, sin = np.array([to[0], to[2]]) / np.hypot(to[0], to[2])
    about_y = np.array([[cos, 0, sin, 0], [0, 1, 0, 0], [-sin, 0, cos, 0], [0, 0, 0, 1]])
    apex = (about_y @ about_z @ move @ [*c, 1])[:3]
    cos, sin = np.array([apex[1], -apex[2]]) / np.hypot(apex[1], apex[2])
    about_x = np.array([[1, 0, 0, 0], [0, cos, -sin, 0], [0, sin, cos, 0], [0, 0, 0, 1]])
    length = np.linalg.norm(b - a)
    matrix = np.diag([1 / length, 1 / length, 1, 1]) @ about_x @ about_y @ about_z @ move
    apex = matrix @ [*c, 1]
    if apex[1] < 0.0:
        matrix[1] *= -1.0
    if apex[0] < 0.5:
        matrix[0, 3] -= 1.0
        matrix[0] *= -1.0
    return matrix, matrix @ [*c, 1]


def longest_first(corners):
    """The corners in an order in which the first edge is the longest."""
    sizes = [np.linalg.norm(corners[(i + 1) % 3] - corners[i]) for i in range(3)]
    return np.roll(corners, -int(np.argmax(sizes)), axis=0)


def test_similarity_is_the_product_of_rotations(kept):
    """Translation, three rotations, scaling and both mirrorings, matrix by matrix, give the short form's rows."""
    mirrored = 0
    for corners, rows in zip(CORNERS[:120].astype(np.float64), kept[SIMILARITY], strict=False):
        matrix, apex = rotated(longest_first(corners))
        np.testing.assert_allclose(rows[:8].reshape(2, 4), matrix[:2], rtol=1e-6, atol=1e-6 * np.abs(matrix[:2]).max())
        np.testing.assert_allclose(rows[8:10], apex[:2], rtol=1e-6)
        ordered = corners[[int(rows[10]), int(rows[11])]]
        image = np.einsum("rc,vc->vr", matrix[:2, :3], ordered) + matrix[:2, 3]
        np.testing.assert_allclose(image, [[0, 0], [1, 0]], atol=1e-12)
        assert rows[8] >= 0.5
        assert rows[9] > 0.0
        mirrored += int(rows[10]) != int(np.argmax((corners == longest_first(corners)[0]).all(axis=1)))
    assert 20 < mirrored < 100


def test_unit_triangle_takes_vertices_to_corners(kept):
    """The two rows and the axis left out, and the plane, at the vertices, in float64."""
    for corners, plane, rows in zip(CORNERS.astype(np.float64), kept[PLANE], kept[UNIT_TRIANGLE], strict=True):
        others = (int(rows[0]) + np.array([1, 2])) % 3
        scale = np.abs(rows[1:7]).max() * max(1.0, np.abs(corners).max())
        np.testing.assert_allclose(corners[:, others] @ rows[1:3] + rows[3], [0, 1, 0], atol=3e-7 * scale)
        np.testing.assert_allclose(corners[:, others] @ rows[4:6] + rows[6], [0, 0, 1], atol=3e-7 * scale)
        np.testing.assert_allclose(corners @ plane[:3], plane[3], atol=3e-7 * 3 * np.abs(corners).max())
        assert np.abs(plane[:3]).max() == plane[int(rows[0])] == 1.0


def smallest_circle(corners):
    """Centre and radius by Ericson's equations, as the paper solves them, in float64."""
    a, b, c = corners
    e1, e2 = b - a, c - a
    s, t = np.linalg.solve([[e1 @ e1, e1 @ e2], [e1 @ e2, e2 @ e2]], [e1 @ e1 / 2, e2 @ e2 / 2])
    if s <= 0:
        centre = (a + c) / 2
    elif t <= 0:
        centre = (a + b) / 2
    elif s + t >= 1:
        centre = (b + c) / 2
    else:
        centre = a + s * e1 + t * e2
    return centre, max(np.linalg.norm(corners - centre, axis=1))


def test_circle(kept):
    """As Ericson's; the radius is a little wider, and holds the vertices in float32 also."""
    for corners, circle in zip(CORNERS.astype(np.float64), kept[bounds.CIRCLE], strict=True):
        centre, radius = smallest_circle(corners)
        size = np.abs(corners).max()
        np.testing.assert_allclose(circle[:3], centre, atol=1e-7 * size)
        assert radius < np.sqrt(circle[3]) < radius + 4e-6 * size
        assert (np.linalg.norm(corners - circle[:3], axis=1) <= np.sqrt(circle[3])).all()


def shares_of(apexes, above, device="cpu"):
    """(N, 4) shares below, above, left, right."""
    out = wp.empty(len(apexes), dtype=wp.vec4d, device=device)

    def run(first: int, apex: wp.array(dtype=wp.vec2d), result: wp.array(dtype=wp.vec4d)):
        frame = Similarity()
        frame.x = apex[wp.tid()][0]
        frame.y = apex[wp.tid()][1]
        result[first + wp.tid()] = shares(frame, wp.static(above))

    kernel = wp.kernel(run, module="unique", enable_backward=False)
    launch(kernel, len(apexes), [wp.array(apexes, dtype=wp.vec2d, device=device), out], device=wp.get_device(device), chunk=999)
    return out.numpy()


@pytest.mark.parametrize("above", [False, True])
def test_shares(above):
    """Acute, obtuse and right triangles, against points strewn over the circle, sorted by the comparisons themselves."""
    apexes = np.array([(0.5, 0.8), (0.6, 0.7), (0.5, 0.5), (0.9, 0.3), (0.7, 0.2), (0.95, 0.01), (0.9, 0.4), (0.8, 0.45)])
    got = shares_of(apexes, above)
    for (x, y), share in zip(apexes, got, strict=True):
        centre, radius = smallest_circle(np.array([[0, 0, 0], [1, 0, 0], [x, y, 0]]))
        points = radius * (2 * np.random.default_rng(0).random((400_000, 2)) - 1)
        points = points[(points**2).sum(axis=1) <= radius**2] + centre[:2]
        below, left = points[:, 1] < 0, points[:, 1] * x > points[:, 0] * y
        right = y * (points[:, 0] - 1) + points[:, 1] * (1 - x) > 0
        top = points[:, 1] > y if above and share[1] >= 0 else np.zeros(len(points), dtype=bool)
        expected = [below.mean(), top.mean(), (left & ~top).mean(), (right & ~left & ~top).mean()]
        np.testing.assert_allclose(np.maximum(share, 0), expected, atol=4e-3)
        clear = abs((x - 0.5) ** 2 + y**2 - 0.25) > 1e-12
        obtuse = (x - 0.5) ** 2 + y**2 < 0.25
        assert not clear or (share[1] >= 0) == (above and obtuse)
    np.testing.assert_allclose(got[2:6, 0], 0.5, atol=1e-12)


def test_orders(kept):
    """The largest share first; weighted by the other comparisons' operations; acute triangles are not asked above.

    Of three, the order is always the same: a longer edge cuts off more of the circle.
    """
    apexes = kept[SIMILARITY][:, 8:10]
    for part, above, weights in ((order_part(3, False), False, (1, 0, 1, 1)), (order_part(4, True), True, (12, 12, 8, 7))):
        values = shares_of(apexes, above) * weights
        orders = kept[part][:, 0].astype(int)
        seen = set()
        for order, value in zip(orders, values, strict=True):
            digits = [order >> 3 * k & 7 for k in range(4)]
            digits = digits[: digits.index(0)] if 0 in digits else digits
            allowed = {BELOW, LEFT, RIGHT} | ({ABOVE} if above and value[1] >= 0 else set())
            assert set(digits) == allowed
            sizes = [value[digit - 1] for digit in digits]
            assert all(a >= b - 1e-5 for a, b in pairwise(sizes))
            seen.add(tuple(digits))
        assert len(seen) > 2 if above else seen == {(BELOW, LEFT, RIGHT)}
    assert [FIXED_ORDER[3] >> 3 * k & 7 for k in range(4)] == [BELOW, LEFT, RIGHT, 0]


def barycentric(corners, origins, directions):
    """(rays, triangles) u and v in float64; NaN or infinite where a ray lies in a triangle's plane."""
    a, b, c = (corners.astype(np.float64)[None, :, i] for i in range(3))
    o, d = (x.astype(np.float64)[:, None] for x in (origins, directions))
    p, q = np.cross(d, c - a), np.cross(o - a, b - a)
    with np.errstate(all="ignore"):
        scale = 1.0 / ((b - a) * p).sum(axis=-1)
        return ((o - a) * p).sum(axis=-1) * scale, (d * q).sum(axis=-1) * scale


def test_bounds_lose_nothing(device):
    """Sphere, box and circle reject no ray that clearly hits, and take none that misses, also from afar and in thin boxes."""
    mesh = degenerate_soup()
    corners = mesh.vertices[mesh.faces]
    near, far = mixed_rays(mesh, 500), mixed_rays(mesh, 300, seed=1)
    finite = [np.isfinite(np.hstack(rays)).all(axis=1) & rays[1].any(axis=1) for rays in (near, far)]
    origins = np.concatenate([near[0][finite[0]], (far[0] - 3e3 * far[1])[finite[1]]])
    directions = np.concatenate([near[1][finite[0]], 1e-3 * far[1][finite[1]]]) * np.float32(0.01)
    plain = all_pairs("ferko_utm", corners, origins, directions, 4, "scalar", device)
    bounded = all_pairs("ferko_utm_bounds", corners, origins, directions, 4, "scalar", device)
    assert (~np.isnan(plain[..., 0])).sum() > 500
    u, v = barycentric(corners, origins, directions)
    with np.errstate(invalid="ignore"):
        clear = np.minimum(np.minimum(u, v), 1 - u - v) > 1e-3  # the point in the plane is as far off as t is rounded
    assert (clear & ~np.isnan(plain[..., 0])).sum() > 300
    kept = clear | ~np.isnan(bounded[..., 0])
    np.testing.assert_array_equal(plain.view(np.int32)[kept], bounded.view(np.int32)[kept])


def test_variants_of_pruning_agree(device):
    """Neither the order nor the number of comparisons shows in the result."""
    mesh = degenerate_soup()
    scene = wrt.Scene(mesh, "bvh", device=device)
    rays = mixed_rays(mesh, 400)
    expected = scene.intersect(*rays, triangle_test="ferko_prune3", traversal="brute")
    names = [name for name, variant in VARIANTS.items() if variant.fold]
    for name in names:
        if name != "ferko_prune4":  # asks acute triangles, too, where rounding at C' may show
            assert_same_hits(scene.intersect(*rays, triangle_test=name, traversal="brute"), expected)
    by_unit = scene.intersect(*rays, triangle_test="ferko_utm", traversal="brute")
    same = by_unit.is_hit & (by_unit.primitive_id == expected.primitive_id)
    assert same.sum() > 0.9 * expected.is_hit.sum()  # many rays are aimed at edges and vertices
    np.testing.assert_allclose(by_unit.uv[same], expected.uv[same], atol=2e-3)


def test_hybrid(device):
    """Closest hits are the unit triangle's, any hits those of pruning, each with its own records."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device=device)
    rays = mixed_rays(mesh, 500)
    assert_same_hits(scene.intersect(*rays, triangle_test="ferko_hybrid"), scene.intersect(*rays, triangle_test="ferko_utm"))
    before = scene.state.record_bytes
    occluded = scene.occluded(*rays, triangle_test="ferko_hybrid")
    assert scene.state.record_bytes > before  # the paper's second record
    np.testing.assert_array_equal(occluded, scene.occluded(*rays, triangle_test=TRIANGLE_TESTS["ferko_hybrid"].any_hit))
    assert scene.explain(*rays, triangle_test="ferko_hybrid").triangle_test == "ferko_hybrid"


def test_comparisons_are_counted():
    """One triangle: rays through known regions make known numbers of comparisons; bounds and orders lower them."""
    mesh = wrt.TriangleMesh(np.array([[0, 0, 0], [4, 0, 0], [3, 1, 0]], dtype=np.float32), np.array([[0, 1, 2]]))
    targets = np.array([[2.9, 0.5, 0], [0.5, 0.9, 0], [3.9, 0.9, 0]])
    origins = targets + np.array([0, 0, 5])
    rays = wrt.Rays(origins, targets - origins)
    scene = wrt.Scene(mesh, "bvh")
    fixed = count_comparisons(scene, rays, Variant(fold=3))
    assert fixed == {"tests": 3, "points": 3, "comparisons": 3 + 2 + 3, "kept": 1}
    own = count_comparisons(scene, rays, Variant(fold=3, ordered=True))  # below, left, right: the shares are in that order
    assert own["comparisons"] == 8
    four = count_comparisons(scene, rays, Variant(fold=4))
    assert four["comparisons"] == 4 + 3 + 4
    circled = count_comparisons(scene, rays, Variant(fold=3, circle=True))
    assert circled["points"] == 3 - 1 + 1 * (np.linalg.norm(targets[2] - (2, 0, 0)) <= 2)


def test_one_by_one(device):
    """The scalar form in the leaves of a tree finds what the lanes find, closest and any."""
    mesh = degenerate_soup()
    rays = wrt.Rays(*mixed_rays(mesh, 300))
    for tree in ("bvh", "kdtree"):
        scene, test = wrt.Scene(mesh, tree, device=device), "ferko_prune4_weights"
        hits = scene.intersect(rays, traversal="single", triangle_test=test)
        dark = scene.occluded(rays, traversal="single", triangle_test=test)
        assert 0 < hits.is_hit.sum() == dark.sum() < 300
        for scalar_test in (True, False):
            closest = leaf_query(scene, rays, test, "closest", scalar_test=scalar_test)()
            for name, expected in (("t", hits.t), ("primitive", hits.primitive_id), ("uv", hits.uv)):
                np.testing.assert_array_equal(getattr(closest, name).numpy(), expected)
            any_hit = leaf_query(scene, rays, test, "any", scalar_test=scalar_test)()
            np.testing.assert_array_equal(any_hit.occluded.numpy(), dark)
