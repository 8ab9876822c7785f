"""Every builder x traversal x triangle test against brute force with the same triangle test, hit for hit, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from support.algorithms import ENGINE_TESTS, OTHER_WAYS_TO_PACKETS
from support.hits import assert_same_hits, brute_force, mixed_rays

import wrt
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

TREES = [wrt.KdTree(builder="in_place"), wrt.KdTree(builder="binned")] + [wrt.Bvh(builder=name) for name in BVH_BUILDERS]
WALKS = [(tree, name) for name, way in TRAVERSALS.items() for tree in way.trees if tree != "none"]


@pytest.mark.width
@pytest.mark.parametrize("builder", KDTREE_BUILDERS)
def test_every_kdtree_builder_gives_the_same_hits(scene_mesh, builder):
    if scene_mesh.triangle_count > KDTREE_BUILDERS[builder].max_triangles:
        pytest.skip("too many triangles for this builder")
    scene = wrt.Scene(scene_mesh, wrt.KdTree(builder=builder), device="cpu")
    origins, directions = mixed_rays(scene_mesh, 3000)
    expected = brute_force(scene, wrt.Rays(origins, directions))
    assert_same_hits(scene.intersect(origins, directions, traversal="single"), expected)


def compared(traversal: str, tree: str, triangle_test: str) -> tuple[str, ...]:
    """Queries that a traversal answers with a triangle test below: all, but for those that meet leaves as another does.

    All tests but one look for closest hits in the first tree of a traversal: leaves are the same in all of its trees, and what
    ends the search of a ray does not know the test.
    """
    asked = compared_with_any(traversal, tree, triangle_test)
    if triangle_test == ENGINE_TESTS[0]:
        return asked
    return tuple(query for query in asked if query == CLOSEST and tree == TRAVERSALS[traversal].trees[0])


def compared_with_any(traversal: str, tree: str, triangle_test: str) -> tuple[str, ...]:
    """The same with closest hits in all trees, and any hit by all tests in the first one."""
    if TRAVERSALS[traversal].needs_shared_origin and not TRIANGLE_TESTS[triangle_test].needs_shared_origin:
        return ()  # the rays have their own origins: see test_eye_frusta.py
    if triangle_test == ENGINE_TESTS[0]:
        return (CLOSEST, ANY)
    if traversal in OTHER_WAYS_TO_PACKETS:
        return (CLOSEST,) if TRIANGLE_TESTS[triangle_test].needs_shared_origin else ()
    return (CLOSEST, ANY) if tree == TRAVERSALS[traversal].trees[0] else (CLOSEST,)


def fits(traversal: str, scene: wrt.Scene, triangle_test: str = ENGINE_TESTS[0]) -> bool:
    """Whether a traversal walks nodes of the scene's width, by a triangle test. Those of width 2 have tests of their own
    (test_persistent.py), where scenes are wider."""
    way = TRAVERSALS[traversal]
    return way.width in (None, scene.state.width) and way.takes_test(triangle_test)


@pytest.mark.parametrize(
    ("triangle_test", "compared"),
    [
        *(pytest.param(name, compared, id=name) for name in ENGINE_TESTS),
        *(pytest.param(name, compared_with_any, id=f"{name}-any", marks=pytest.mark.exhaustive) for name in ENGINE_TESTS[1:]),
    ],
)
@pytest.mark.parametrize("accelerator", TREES, ids=lambda tree: f"{tree.kind}-{tree.builder}")
def test_hits_equal_brute_force(scene_mesh, accelerator, triangle_test, compared, device):
    scene = wrt.Scene(scene_mesh, accelerator, device=device)
    origins, directions = mixed_rays(scene_mesh, 3000)
    if TRIANGLE_TESTS[triangle_test].needs_shared_origin:
        targets = np.where(np.isfinite(origins).all(1, keepdims=True), origins + directions, np.nan)
        origins = np.asarray(scene_mesh.bounds[0] + (0.41, 0.57, 1.31) * np.ptp(scene_mesh.bounds, axis=0), np.float32)
        directions = (targets - origins).astype(np.float32)
    expected = brute_force(scene, wrt.Rays(origins, directions), triangle_test=triangle_test)
    assert 0.05 < expected.is_hit.mean() < 0.99
    for traversal in (name for tree, name in WALKS if tree == accelerator.kind and fits(name, scene, triangle_test)):
        queries = compared(traversal, accelerator.kind, triangle_test)
        if CLOSEST in queries:
            hits = scene.intersect(origins, directions, traversal=traversal, triangle_test=triangle_test)
            assert_same_hits(hits, expected)
        if ANY in queries:
            dark = scene.occluded(origins, directions, traversal=traversal, triangle_test=triangle_test)
            np.testing.assert_array_equal(dark, expected.is_hit)
    if accelerator == TREES[0]:  # brute force knows no tree
        dark = scene.occluded(origins, directions, traversal="brute", triangle_test=triangle_test)
        np.testing.assert_array_equal(dark, expected.is_hit)


@pytest.mark.width
@pytest.mark.parametrize(("tree", "traversal"), [walk for walk in WALKS if not TRAVERSALS[walk[1]].needs_shared_origin])
def test_bounded_ranges_equal_brute_force(scene_mesh, tree, traversal, device):
    """Per-ray t_min and t_max that cut between hits, exactly at hits, and empty ranges."""
    width = TRAVERSALS[traversal].width
    scene = wrt.Scene(scene_mesh, tree if width is None else wrt.Bvh(width=width), device=device)
    origins, directions = mixed_rays(scene_mesh, 3000, seed=1)
    first = brute_force(scene, wrt.Rays(origins, directions))
    rng = np.random.default_rng(2)
    t_min = np.where(first.is_hit & (rng.random(3000) < 0.5), first.t, rng.random(3000)).astype(np.float32)
    t_max = np.where(rng.random(3000) < 0.3, t_min, t_min + rng.random(3000) - 0.1).clip(0).astype(np.float32)
    expected = brute_force(scene, wrt.Rays(origins, directions, t_min, t_max))
    assert_same_hits(scene.intersect(origins, directions, t_min, t_max, traversal=traversal), expected)
    np.testing.assert_array_equal(scene.occluded(origins, directions, t_min, t_max, traversal=traversal), expected.is_hit)
    # the interval is closed: a range that is just the first hit's t holds it
    only = scene.intersect(origins, directions, np.where(first.is_hit, first.t, 0), first.t, traversal=traversal)
    np.testing.assert_array_equal(only.t[first.is_hit], first.t[first.is_hit])


@pytest.mark.width
@pytest.mark.parametrize("width", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 33])
def test_block_sizes(width, count):
    """Triangle counts below, at and above a block, as one leaf and as a tree."""
    mesh = wrt.scenes.build("random_triangles", count=count, size=0.8, seed=count)
    origins, directions = mixed_rays(mesh, 500)
    expected = None
    for block_cost in (100.0, 0.01):  # as many splits as there can be, and none
        scene = wrt.Scene(mesh, wrt.KdTree(width=width, block_cost=block_cost), device="cpu")
        expected = expected or scene.intersect(origins, directions, traversal="brute")
        assert_same_hits(scene.intersect(origins, directions), expected)


@pytest.mark.width
def test_bad_rays_miss(device):
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, device=device)
    good = np.array([[0, -10, 1.0]] * 9, dtype=np.float32)
    towards = np.array([[0, 1.0, 0]] * 9, dtype=np.float32)
    assert scene.intersect(good, towards).is_hit.all()
    for i, value in enumerate((np.nan, np.inf, -np.inf)):
        good[i, i] = value
        towards[i + 3, i] = value
    towards[6] = 0
    towards[7] = (0, 1e-41, 0)  # below the smallest normal number
    hits = scene.intersect(good, towards)
    assert hits.is_hit.tolist() == [False] * 8 + [True]
    assert np.isinf(hits.t[:8]).all()
    assert (hits.uv[:8] == 0).all()
    assert not scene.occluded(good, towards)[:8].any()
    assert not scene.intersect(good, towards, traversal="brute").is_hit[:8].any()


@pytest.mark.width
@pytest.mark.parametrize("scale", [1e-4, 1e-2, 1.0, 1e4, 1e8])
def test_scales(scale):
    """Brute force's hits at every scale, and at all scales the same but for rounding."""
    mesh = wrt.scenes.build("teapot", level=3, ground=False)
    special = mixed_rays(mesh, 2000, seed=4)
    rng = np.random.default_rng(5)
    origins, targets = rng.uniform(*(1.5 * mesh.bounds), (2, 3000, 3)).astype(np.float32)
    reference = wrt.Scene(mesh, device="cpu").intersect(origins, targets - origins)
    scene = wrt.Scene(wrt.TriangleMesh(mesh.vertices.astype(np.float64) * scale, mesh.faces), device="cpu")
    with np.errstate(invalid="ignore", over="ignore"):
        special = [rays * np.float32(scale) for rays in special]
    assert_same_hits(scene.intersect(*special), scene.intersect(*special, traversal="brute"))
    hits = scene.intersect(origins * np.float32(scale), (targets - origins) * np.float32(scale))
    assert (hits.primitive_id == reference.primitive_id).mean() > 0.999
    both = hits.is_hit & (hits.primitive_id == reference.primitive_id)
    assert both.sum() > 500
    np.testing.assert_allclose(hits.t[both], reference.t[both], rtol=1e-4, atol=1e-6)


@pytest.mark.width
def test_origin_on_a_splitting_plane_and_ray_in_it():
    """Havran's two failures of the classic traversal, on a grid of boxes whose faces are the splitting planes."""
    import trimesh

    boxes = [
        trimesh.creation.box(bounds=[[x, y, z], [x + 1, y + 1, z + 1]])
        for x in range(0, 6, 2)
        for y in range(0, 6, 2)
        for z in range(0, 6, 2)
    ]
    mesh = wrt.TriangleMesh.from_trimesh(trimesh.util.concatenate(boxes))
    scene = wrt.Scene(mesh, wrt.KdTree(width=1, block_cost=2.0), device="cpu")
    steps = np.arange(-1, 7) * 1.0
    origins = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    directions = [d for d in np.stack(np.meshgrid(*[[-1.0, 0.0, -0.0, 1.0]] * 3), axis=-1).reshape(-1, 3) if np.any(d)]
    origins, directions = np.repeat(origins, len(directions), axis=0), np.tile(directions, (len(origins), 1))
    expected = scene.intersect(origins, directions, traversal="brute")
    assert_same_hits(scene.intersect(origins, directions), expected)
    assert expected.is_hit.any()


@pytest.mark.width
def test_ties_go_to_the_smaller_primitive():
    """Coincident triangles listed in many orders: the first one wins, in every tree."""
    corners = np.random.default_rng(0).random((40, 3, 3))
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(40), 5))
    mesh = wrt.TriangleMesh(corners[order].reshape(-1, 3), np.arange(600).reshape(-1, 3))
    first = np.array([np.flatnonzero(order == which)[0] for which in range(40)])
    origins = np.full((40, 3), -3.0)
    directions = corners.mean(axis=1) - origins
    for accelerator in (wrt.KdTree(width=1, block_cost=3.0), wrt.KdTree(width=16)):
        hits = wrt.Scene(mesh, accelerator, device="cpu").intersect(origins, directions)
        assert (hits.primitive_id == first[order[hits.primitive_id]]).all()


@pytest.mark.width
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_do_not_show(threads):
    mesh = wrt.scenes.build("wood", trees=4)
    origins, directions = mixed_rays(mesh, 20_000)
    one = wrt.Scene(mesh, device="cpu", num_threads=1).intersect(origins, directions)
    many = wrt.Scene(mesh, device="cpu", num_threads=threads).intersect(origins, directions)
    assert_same_hits(many, one)


@pytest.mark.width
def test_counters():
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, wrt.KdTree(width=8), device="cpu")
    origins, directions = mixed_rays(mesh, 300)
    hits = scene.intersect(origins, directions, counters=True)
    work = hits.counters
    assert set(work) == {"nodes", "leaves", "triangles", "boxes", "culled", "lanes", "active", "avoided"}
    assert work["nodes"].shape == (300,)
    assert (work["triangles"][hits.is_hit] > 0).all()
    assert (work["leaves"][hits.is_hit] > 0).all()
    assert work["triangles"].max() < mesh.triangle_count
    assert_same_hits(hits, scene.intersect(origins, directions))
    brute = scene.intersect(origins, directions, traversal="brute", counters=True)
    valid = np.isfinite(origins).all(1) & np.isfinite(directions).all(1) & directions.any(1)
    np.testing.assert_array_equal(brute.counters["triangles"], np.where(valid, mesh.triangle_count, 0))
    with pytest.raises(ValueError, match="counters=True"):
        _ = scene.intersect(origins, directions).counters


def test_bunny_equals_brute_force(bunny):
    scene = wrt.Scene(bunny, device="cpu")
    origins, directions = mixed_rays(bunny, 2000)
    assert_same_hits(scene.intersect(origins, directions), scene.intersect(origins, directions, traversal="brute"))
