"""All hits and counts: each crossing once, whatever the tree, the traversal, the scale or the edge it meets."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from support.bodies import BODIES, feature_points
from support.hits import mixed_rays

import wrt
from wrt.engine.facts.query_kinds import ALL, COUNT
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.query import all_hits

pytestmark = pytest.mark.width

TREES = ["bvh", "kdtree", wrt.KdTree(builder="sweep", block_cost=4.0, width=4)]
SMOOTH = wrt.scenes.build("teapot", level=3, ground=False)
SOUP = wrt.scenes.build("random_triangles", count=300, size=0.6)
WAYS = {
    kind: [name for name, way in TRAVERSALS.items() if kind in way.trees and way.supports(ALL, kind) and way.width is None]
    for kind in ("bvh", "kdtree")
}
"""Those for trees of any width; of width 2: tests/traversals/test_persistent.py."""


def assert_same_lists(lists: wrt.AllHits, expected: wrt.AllHits) -> None:
    """Equal to the bit."""
    np.testing.assert_array_equal(lists.offsets, expected.offsets)
    np.testing.assert_array_equal(lists.primitive_id, expected.primitive_id)
    np.testing.assert_array_equal(lists.geometry_id, expected.geometry_id)
    np.testing.assert_array_equal(lists.t.view(np.int32), expected.t.view(np.int32))
    np.testing.assert_array_equal(lists.uv.view(np.int32), expected.uv.view(np.int32))


def enumerate64(mesh: wrt.TriangleMesh, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Triangles that a ray hits and where, sorted, in float64; and whether none of it is a matter of rounding."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) - origin for k in range(3))
    direction = direction.astype(np.float64)
    volumes = np.stack([np.cross(c, b) @ direction, np.cross(a, c) @ direction, np.cross(b, a) @ direction])
    total = volumes.sum(axis=0)
    with np.errstate(all="ignore"):
        weights = volumes / total
        t = (weights * np.stack([a, b, c]).dot(direction)).sum(axis=0) / direction.dot(direction)
    least = weights.min(axis=0)
    steep = np.abs(total) < 1e-3 * np.linalg.norm(direction) * ((b - a) ** 2 + (c - a) ** 2).sum(axis=1)
    unsure = (np.abs(least) < np.where(steep, 1.0, 1e-3)) | ((least > 0) & (np.abs(t) < 1e-4))
    hit = np.flatnonzero((weights > 0).all(axis=0) & (t >= 0))
    hit = hit[np.argsort(t[hit], kind="stable")]
    clear = not unsure.any() and (len(hit) < 2 or np.diff(t[hit]).min() > 1e-4)
    return hit, t[hit], clear


def test_lists_and_counts_equal_brute_force(scene_mesh, device):
    """On every tree and traversal, also between bounds of t that cut at hits."""
    scenes = [wrt.Scene(scene_mesh, tree, device=device) for tree in TREES]
    origins, directions = mixed_rays(scene_mesh, 3000)
    expected = scenes[0].intersect_all(origins, directions, traversal="brute")
    assert 0.05 < (expected.count > 1).mean() < 0.99
    np.testing.assert_array_equal(expected.count, scenes[0].count(origins, directions, traversal="brute"))
    rng = np.random.default_rng(2)
    own = expected.t[np.minimum(expected.offsets[:-1], len(expected) - 1)]  # for many rays, just a hit's t
    t_min = np.where(rng.random(3000) < 0.5, own, rng.random(3000)).astype(np.float32)
    t_max = np.where(rng.random(3000) < 0.3, t_min, t_min + rng.random(3000) - 0.1).clip(0).astype(np.float32)
    bounded = scenes[0].intersect_all(origins, directions, t_min, t_max, traversal="brute")
    assert 0.01 < (bounded.count > 0).mean() < 0.9
    for scene in scenes:
        for traversal in WAYS[scene.accelerator.kind]:
            lists = scene.intersect_all(origins, directions, traversal=traversal)
            assert lists.plan.traversal == traversal
            assert_same_lists(lists, expected)
            np.testing.assert_array_equal(scene.count(origins, directions, traversal=traversal), expected.count)
            assert_same_lists(scene.intersect_all(origins, directions, t_min, t_max, traversal=traversal), bounded)
            np.testing.assert_array_equal(scene.count(origins, directions, t_min, t_max, traversal=traversal), bounded.count)


def test_narrow_trees():
    """Up to four children a node, a walk keeps what waits on a stack: so on CUDA."""
    origins, directions = mixed_rays(SOUP, 2000, seed=5)
    expected = wrt.Scene(SOUP, device="cpu").intersect_all(origins, directions)
    scene = wrt.Scene(SOUP, wrt.Bvh(width=2), device="cpu")
    assert_same_lists(scene.intersect_all(origins, directions, traversal="single"), expected)
    np.testing.assert_array_equal(scene.count(origins, directions, traversal="single"), expected.count)


@pytest.mark.parametrize("mesh", [SMOOTH, SOUP], ids=["smooth", "soup"])
def test_lists_equal_float64(mesh):
    """Where float64 leaves no doubt: the same triangles in the same order, at the same t; the first is the closest hit."""
    scene = wrt.Scene(mesh, device="cpu")
    rng = np.random.default_rng(8)
    low, high = mesh.bounds
    origins = rng.uniform(low - 1, high + 1, (500, 3)).astype(np.float32)
    directions = (rng.uniform(low, high, (500, 3)) - origins).astype(np.float32)
    lists, closest = scene.intersect_all(origins, directions), scene.intersect(origins, directions)
    clear = 0
    for i, (begin, end) in enumerate(zip(lists.offsets[:-1], lists.offsets[1:], strict=True)):
        hit, t, sure = enumerate64(mesh, origins[i].astype(np.float64), directions[i])
        if sure:
            clear += 1
            np.testing.assert_array_equal(lists.primitive_id[begin:end], hit)
            np.testing.assert_allclose(lists.t[begin:end], t, rtol=2e-5, atol=1e-5)
            if len(hit):
                assert (closest.t[i], closest.primitive_id[i]) == (lists.t[begin], lists.primitive_id[begin])
                np.testing.assert_array_equal(closest.uv[i], lists.uv[begin])
    assert clear > 300
    assert lists.count.max() > 2


def test_lists_are_sorted_and_complete():
    """What follows from a list: ray numbers, counts, positions on the rays, geometries before triangles at equal t."""
    one = wrt.scenes.build("teapot", level=2, ground=False)
    scene = wrt.Scene([one, one, wrt.scenes.build("random_triangles", count=50)], device="cpu")
    origins, directions = mixed_rays(one, 1200, seed=3)
    origins, directions = origins.reshape(30, 40, 3), directions.reshape(30, 40, 3)
    lists = scene.intersect_all(origins, directions)
    assert (lists.shape, lists.count.shape, lists.count.dtype, lists.offsets.dtype) == ((30, 40), (30, 40), np.int32, np.int64)
    assert len(lists) == lists.offsets[-1] == len(lists.t) == len(lists.position) == lists.count.sum()
    np.testing.assert_array_equal(lists.ray_id, np.repeat(np.arange(1200), lists.count.ravel()))
    order = np.lexsort([lists.primitive_id, lists.geometry_id, lists.t, lists.ray_id])
    np.testing.assert_array_equal(order, np.arange(len(lists)))
    expected = (origins.astype(np.float64) + 0).reshape(-1, 3)[lists.ray_id]
    expected += lists.t[:, None].astype(np.float64) * directions.reshape(-1, 3)[lists.ray_id]
    np.testing.assert_allclose(lists.position, expected, atol=1e-4)
    assert lists.position.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(lists.normal, axis=1), 1.0, rtol=1e-5)
    # the first two geometries coincide: each of their crossings is reported twice
    count = [int((lists.geometry_id == k).sum()) for k in range(3)]
    assert count[0] == count[1] > 0 < count[2]


def aimed_rays(mesh: trimesh.Trimesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from outside a body through inside points and exactly at vertices, edges and faces, in float64."""
    rng = np.random.default_rng(4)
    weights = rng.dirichlet((1, 1, 1), len(mesh.faces))
    points = np.concatenate([feature_points(mesh), mesh.triangles_center, (mesh.triangles * weights[:, :, None]).sum(axis=1)])
    targets = points[rng.integers(0, len(points), count)]
    center = mesh.bounds.mean(axis=0)
    through = center + 0.5 * (mesh.vertices[rng.integers(0, len(mesh.vertices), count)] - center) * rng.random((count, 1))
    direction = through - targets
    origins = targets - direction * rng.uniform(0.3, 30.0, (count, 1))
    return origins, targets - origins


@pytest.mark.parametrize("body", BODIES)
def test_convex_bodies_are_crossed_twice(body):
    """At every scale, far from the origin, at vertices and edges: never one, three or four."""
    mesh = BODIES[body]
    origins, directions = aimed_rays(mesh, 4000)
    for scale, offset in ((1.0, 0.0), (1e-4, 0.0), (1e8, 0.0), (1.0, 1e7)):
        moved = wrt.TriangleMesh(mesh.vertices * scale + offset, mesh.faces)
        for tree in ("bvh", "kdtree"):
            scene = wrt.Scene(moved, tree, device="cpu")
            rays = origins * scale + offset, directions * scale
            counts = scene.count(*rays)
            assert (counts == 2).all(), f"{(counts != 2).sum()} wrong at scale {scale}, {offset} from the origin, {tree}"
            lists = scene.intersect_all(*rays)
            np.testing.assert_array_equal(np.diff(lists.offsets), 2)


def test_rays_along_edges_and_in_planes():
    """Axis-parallel rays in the planes of a grid of boxes, through their edges and corners: an even number each, and as many
    as along the same line moved by (e, e^2) within the projection."""
    boxes = [trimesh.creation.box(bounds=[[x, y, z], [x + 1, y + 1, z + 1]]) for x in (0, 2) for y in (0, 2) for z in (0, 2)]
    mesh = wrt.TriangleMesh.from_trimesh(trimesh.util.concatenate(boxes))
    steps = np.linspace(-0.5, 3.5, 9)
    across = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    for axis in range(3):
        x, y = (axis + 1) % 3, (axis + 2) % 3  # as the triangle test orders the axes
        for sign in (1.0, -1.0):
            directions = np.zeros(3)
            directions[axis] = sign
            origins = np.empty((len(across), 3))
            origins[:, [x, y]], origins[:, axis] = across, -10.0 * sign
            moved = origins.copy()
            moved[:, x] += 1e-2
            moved[:, y] += 1e-4
            for tree in ("bvh", wrt.KdTree(width=1, block_cost=3.0)):
                scene = wrt.Scene(mesh, tree, device="cpu")
                counts = scene.count(origins, directions)
                assert set(np.unique(counts)) == {0, 4}
                np.testing.assert_array_equal(counts, scene.count(moved, directions))
                np.testing.assert_array_equal(scene.intersect_all(origins, directions).count, counts)


def test_triangles_too_small_for_float32_areas():
    """A body whose projected areas underflow is still crossed twice, between its ends."""
    mesh = BODIES["turned box"]
    for scale in (1e-19, 1e-21):
        scene = wrt.Scene(wrt.TriangleMesh(mesh.vertices * scale, mesh.faces), device="cpu")
        origins, directions = (rays * scale for rays in aimed_rays(mesh, 500))
        directions /= scale  # of ordinary length, so that t is tiny
        for traversal in ("single", "stream", "brute"):
            lists = scene.intersect_all(origins, directions, traversal=traversal)
            np.testing.assert_array_equal(lists.count, 2)
            assert (lists.t <= 100 * scale).all()


def test_every_copy_counts_and_edge_on_does_not():
    """Coincident triangles are each reported, also when wound the other way; those seen edge-on, needles and points never."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    copies = [corners, corners, corners[::-1], corners[[1, 2, 0]]]
    edge_on = [corners[:, [0, 2, 1]], corners[:, [0, 2, 1]] * 0.5]
    thin = [corners[[0, 1, 1]], corners[[2, 2, 2]], corners * (1, 0, 0)]
    vertices = np.concatenate(copies + edge_on + thin)
    mesh = wrt.TriangleMesh(vertices, np.arange(len(vertices)).reshape(-1, 3))
    targets = np.array([[0.25, 0.25, 0], [0.25, 0, 0], [0, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0.2, -0.1, 0]])
    origins = targets + np.array([0, 0, 3.0])
    for tree in ("bvh", "kdtree", wrt.KdTree(width=1)):
        scene = wrt.Scene(mesh, tree, device="cpu")
        for traversal in (*WAYS[scene.accelerator.kind], "brute"):
            lists = scene.intersect_all(origins, [0, 0, -1.0], traversal=traversal)
            assert lists.count[0] == 4
            assert set(lists.count.tolist()) <= {0, 4}, "an edge belongs to all copies or to none"
            assert lists.count[5] == 0
            assert lists.primitive_id[:4].tolist() == [0, 1, 2, 3]
            assert (lists.primitive_id < 4).all()


def test_scalar_and_lane_form_agree_on_edges():
    """The rule for edges in its two forms, on projected vertices of a coarse grid: all ties, bit for bit, at every width."""
    rng = np.random.default_rng(6)
    corners = rng.integers(-2, 3, (400, 3, 3)).astype(np.float32)
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(1200).reshape(-1, 3))
    origins = rng.integers(-2, 3, (300, 3)).astype(np.float32)
    directions = rng.integers(-2, 3, (300, 3)).astype(np.float32)
    for width in (1, 16):
        scene = wrt.Scene(mesh, wrt.KdTree(width=width), device="cpu")
        assert_same_lists(scene.intersect_all(origins, directions), scene.intersect_all(origins, directions, traversal="brute"))


# -- batches, bounds, errors -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wood() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("wood", trees=3), device="cpu")


@pytest.fixture(scope="module")
def wood_rays(wood) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(wrt.TriangleMesh(*wood_arrays(wood)), 3000, seed=9)


def wood_arrays(scene: wrt.Scene) -> tuple[np.ndarray, np.ndarray]:
    return scene.meshes[0].vertices, scene.meshes[0].faces


def test_blocks_and_threads_do_not_show(wood, wood_rays, monkeypatch):
    """Whatever the blocks, the threads and the rays that must be traced again: the same lists to the bit."""
    expected = wood.intersect_all(*wood_rays)
    assert (expected.count > all_hits.ROOM).sum() > 20, "some rays are traced again"
    assert (expected.count == 0).any()
    threaded = wrt.Scene(wood.meshes, device="cpu", num_threads=3)
    assert_same_lists(threaded.intersect_all(*wood_rays), expected)
    for block in (1000, 2999, 3000):
        monkeypatch.setattr(all_hits, "BLOCK", block)
        assert_same_lists(wood.intersect_all(*wood_rays), expected)
    shared = wood.intersect_all(wood_rays[0][5], wood_rays[1])  # one origin, many blocks
    np.testing.assert_array_equal(shared.count, wood.count(np.tile(wood_rays[0][5], (3000, 1)), wood_rays[1]))


def test_rays_in_another_order(wood, wood_rays):
    from dataclasses import replace

    plan = replace(wood.explain(*wood_rays, query="all"), reorder="cells")
    assert_same_lists(wood.intersect_all(*wood_rays, traversal=plan), wood.intersect_all(*wood_rays))
    np.testing.assert_array_equal(wood.count(*wood_rays, traversal=plan), wood.count(*wood_rays))


@pytest.mark.parametrize("bound", [1, 3, 8, 11, 10**12])
def test_max_hits_keeps_the_nearest(wood, wood_rays, bound):
    every, some = wood.intersect_all(*wood_rays), wood.intersect_all(*wood_rays, max_hits=bound)
    np.testing.assert_array_equal(some.count, np.minimum(every.count.astype(np.int64), bound))
    rank = np.arange(len(every)) - every.offsets[every.ray_id]
    for name in ("t", "primitive_id", "uv", "ray_id"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[rank < bound])


def test_long_lists_are_sorted():
    """A thousand parallel sheets, numbered at random: more hits than are sorted by insertion."""
    heights = np.random.default_rng(3).permutation(1000) / 1000
    corners = np.array([[-1, -1, 0], [2, -1, 0], [-1, 2, 0]]) + heights[:, None, None] * (0, 0, 1)
    scene = wrt.Scene(wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3000).reshape(-1, 3)), device="cpu")
    lists = scene.intersect_all([[0.1, 0.1, 2.0], [0.2, 0.1, -1.0], [9, 9, 9]], [[0, 0, -1.0], [0, 0, 0.5], [1, 0, 0]])
    assert lists.count.tolist() == [1000, 1000, 0]
    np.testing.assert_array_equal(lists.primitive_id[:1000], np.argsort(-heights))
    np.testing.assert_array_equal(lists.primitive_id[1000:], np.argsort(heights))
    np.testing.assert_allclose(lists.t[1000:], 2 * (1 + np.sort(heights)), rtol=1e-5)


def test_empty_batches_and_bad_rays(device):
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device=device)
    for shape in ((0,), (3, 0)):
        lists = scene.intersect_all(np.empty((*shape, 3)), np.ones(3))
        assert (lists.shape, lists.count.shape, len(lists), lists.offsets.tolist()) == (shape, shape, 0, [0])
        assert lists.uv.shape == (0, 2)
        assert lists.position.shape == (0, 3)
        assert lists.geometry_id.shape == lists.ray_id.shape == (0,)
        assert scene.count(np.empty((*shape, 3)), np.ones(3)).shape == shape
    origins, directions = np.full((7, 3), (0, -10, 1.0)), np.full((7, 3), (0, 1.0, 0))
    for i, value in enumerate((np.nan, np.inf, -np.inf)):
        origins[i, i], directions[i + 3, i] = value, value
    directions[6] = 0
    assert not scene.count(origins, directions).any()
    assert len(scene.intersect_all(origins, directions)) == 0
    one = scene.intersect_all((0, -10, 1.0), (0, 1, 0))
    assert one.shape == one.count.shape == ()
    assert one.count == len(one) >= 2


def test_warp_arrays_stay_on_the_device(device):
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, device=device)
    origins, directions = mixed_rays(mesh, 600)
    expected = scene.intersect_all(origins, directions)
    native = [wp.array(values.reshape(20, 30, 3), dtype=wp.vec3, device=device) for values in (origins, directions)]
    lists = scene.intersect_all(*native)
    for name in ("offsets", "count", "t", "primitive_id", "geometry_id", "uv", "ray_id", "position", "normal"):
        values = getattr(lists, name)
        assert isinstance(values, wp.array), name
        assert str(values.device) == device
        np.testing.assert_array_equal(values.numpy().reshape(getattr(expected, name).shape), getattr(expected, name))
    assert lists.count.shape == scene.count(*native).shape == scene.contains(native[0]).shape == (20, 30)
    np.testing.assert_array_equal(scene.contains(native[0]).numpy().ravel(), scene.contains(origins))


def test_too_many_hits_for_one_answer(wood, wood_rays, monkeypatch):
    monkeypatch.setattr(all_hits, "MAX_TOTAL", 100)
    with pytest.raises(ValueError, match=r"these rays have [\d,]+ hits or more, and one result holds 100; pass fewer rays"):
        wood.intersect_all(*wood_rays)
    assert all_hits.sum_up(np.zeros(3, dtype=np.int32)).tolist() == [0, 0, 0, 0]
    monkeypatch.setattr(all_hits, "MAX_TOTAL", (1 << 31) - 1)
    with pytest.raises(ValueError, match=r"4,294,967,294 hits"):
        all_hits.sum_up(np.full(2, (1 << 31) - 1, dtype=np.int32))


BAD_CALLS = {
    "max_hits zero": ({"max_hits": 0}, ValueError, "max_hits is 0; it must be at least 1"),
    "max_hits float": ({"max_hits": 2.0}, TypeError, "max_hits must be an int, not float"),
    "max_hits bool": ({"max_hits": True}, TypeError, "max_hits must be an int, not bool"),
    "traversal": (
        {"traversal": "packet"},
        ValueError,
        "'packet' does not answer the query 'all' on a bvh; choose from auto, brute",
    ),
    "unknown traversal": ({"traversal": "walk"}, ValueError, "traversal 'walk' is unknown"),
    "triangle test": ({"triangle_test": "moeller_trumbore"}, ValueError, "choose from auto, woop"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_bad_calls(wood, case):
    options, error, message = BAD_CALLS[case]
    with pytest.raises(error, match=message):
        wood.intersect_all([0, 0, 0], [0, 0, 1], **options)


def test_plans():
    """`explain` takes the query; a plan that was made for another query is refused by name."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), "kdtree", device="cpu")
    rays = np.zeros((2000, 3)), np.ones((2000, 3))
    assert scene.explain(*rays, query="all").traversal == scene.explain(*rays, query="count").traversal == "single"
    assert scene.explain(*rays).traversal != "single"
    with pytest.raises(ValueError, match="query 'some' is unknown; choose from closest, any, count, all"):
        scene.explain(*rays, query="some")
    with pytest.raises(ValueError, match="does not answer the query 'count' on a kdtree; choose from auto, brute, single"):
        scene.count(*rays, traversal=scene.explain(*rays))
    from dataclasses import replace

    plan = replace(scene.explain(*rays, query="all"), mailbox="hashed")
    with pytest.raises(ValueError, match="has to test a triangle in every leaf"):
        scene.intersect_all(*rays, traversal=plan)


def test_tables_say_what_is_answered():
    assert all(way.supports("closest", tree) for way in TRAVERSALS.values() for tree in way.trees)
    assert WAYS == {"bvh": ["single", "stream", "interleaved", "queued"], "kdtree": ["single"]}
    assert TRAVERSALS["brute"].supports(COUNT, "none")
    assert [name for name, test in TRIANGLE_TESTS.items() if test.crossing is not None] == ["woop"]
