"""Spatial splits in trees for known rays: invariants, hits and counts of brute force, lower costs, bounds, bad input."""

from __future__ import annotations

import functools
import gc

import numpy as np
import pytest
import warp as wp
from support.built_bvhs import arrays_of, assert_same_tree
from support.hits import assert_same_hits, mixed_rays
from support.known_areas import AREA_KINDS, area_of, described, rays_of
from support.meshes import SCENES

import wrt
from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.bvh.bvh_statistics import bvh_statistics, unpack
from wrt.builders.bvh.spatial import spatial_build
from wrt.builders.core.clip import PAD
from wrt.builders.triangle_boxes import boxes_of, triangle_boxes
from wrt.engine.plan.plan import stack_levels
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import use_threads


def build(mesh: wrt.TriangleMesh, description: wrt.known_rays.ProjectedBvh):
    """Its tree."""
    return description.build(triangle_boxes(*arrays_of(mesh)), 8)


@functools.cache
def scene_and_rays(name: str):
    """A scene's mesh, rays of every kind, and their hits and counts by brute force."""
    mesh = SCENES[name]()
    kinds = [mixed_rays(mesh, 300), *(rays_of(area_of(mesh, kind), 150) for kind in AREA_KINDS)]
    rays = [np.concatenate(part).astype(np.float32) for part in zip(*kinds, strict=True)]
    plain = wrt.Scene(mesh, wrt.Bvh(width=8))
    return mesh, rays, plain.intersect(*rays, traversal="brute"), plain.count(*rays, traversal="brute")


@pytest.mark.parametrize(
    ("name", "kind", "options"),
    [
        ("atrium", "point inside", {"max_leaf_triangles": 4}),
        ("atrium", "plane", {"share": 4.0, "max_leaf_triangles": 1}),
        ("stadium", "plane along an axis", {"max_leaf_triangles": 2}),
        ("random_triangles", "point inside", {"share": 2.0, "max_leaf_triangles": 2, "axes": "facing"}),
        ("degenerate", "plane", {"share": 1.0, "max_leaf_triangles": 3, "cost": "sah"}),
        ("needles", "point inside", {"share": 1.0, "max_leaf_triangles": 2}),
    ],
)
def test_every_ray_has_its_hits(name, kind, options):
    """Closest hits, occlusion, counts and lists, bit for bit, although a triangle is in several leaves."""
    mesh, rays, expected, counts = scene_and_rays(name)
    scene = wrt.Scene(mesh, described(mesh, kind, **options))
    assert scene.tree.shared
    assert_same_hits(scene.intersect(*rays, traversal="single", counters=True), expected)
    np.testing.assert_array_equal(scene.occluded(*rays), expected.is_hit)
    np.testing.assert_array_equal(scene.count(*rays), counts)
    lists, all_expected = (s.intersect_all(*rays) for s in (scene, wrt.Scene(mesh, wrt.Bvh(width=8))))
    np.testing.assert_array_equal(lists.offsets, all_expected.offsets)
    np.testing.assert_array_equal(lists.primitive_id, all_expected.primitive_id)
    assert expected.is_hit.any()
    assert counts.max() > 1


def test_few_rays_do_not_take_the_queries_of_other_trees():
    """Queries of few rays outlive their scenes and serve others of the kind: after a scene of as many lanes and levels was
    gone, crossings of triangles in several leaves were counted several times."""
    mesh, rays, _, counts = scene_and_rays("random_triangles")
    few = [array[:8] for array in rays]
    plain = wrt.Scene(mesh, wrt.Bvh(width=8, max_leaf_triangles=1))
    scene = wrt.Scene(mesh, described(mesh, "point inside", 2.0, max_leaf_triangles=2, axes="facing"))
    assert stack_levels(plain.state.depth) == stack_levels(scene.state.depth)
    np.testing.assert_array_equal(plain.count(*few), counts[:8])
    del plain
    gc.collect()
    np.testing.assert_array_equal(scene.count(*few), counts[:8])


def check(tree, mesh: wrt.TriangleMesh, share: float, leaf_limit: int) -> None:
    """Every triangle is listed, none twice by a leaf, in no more places than allowed; boxes contain the parts in them."""
    flat, corners = unpack(tree), mesh.vertices.astype(np.float32)[mesh.faces].astype(np.float64)
    primitive = tree.primitive.numpy()
    listed = primitive[primitive >= 0]
    np.testing.assert_array_equal(np.unique(listed), np.arange(mesh.triangle_count))
    assert len(listed) <= mesh.triangle_count + int(share * mesh.triangle_count)
    assert tree.shared == (len(listed) > mesh.triangle_count)
    assert flat.triangles.max() <= leaf_limit
    assert tree.depth <= MAX_WIDE_DEPTH
    # a child's box contains those of its own children
    for node, lane in np.argwhere(flat.is_inner):
        child = flat.child[node, lane]
        assert (flat.low[child].min(axis=0) >= flat.low[node, lane]).all()
        assert (flat.high[child].max(axis=0) <= flat.high[node, lane]).all()
    # any point of a triangle is in the box of some leaf that lists it
    rng = np.random.default_rng(0)
    covered = np.zeros((mesh.triangle_count, 40), dtype=bool)
    points = (rng.dirichlet((1, 1, 1), (mesh.triangle_count, 40))[..., None] * corners[:, None]).sum(axis=2)
    slack = 1e-6 * np.abs(corners).max()
    for node, lane in np.argwhere(flat.is_leaf):
        begin = flat.first_block[node, lane] * tree.width
        ids = primitive[begin : begin + flat.triangles[node, lane]]
        assert len(np.unique(ids)) == len(ids)
        low, high = flat.low[node, lane] - slack, flat.high[node, lane] + slack
        covered[ids] |= ((points[ids] >= low) & (points[ids] <= high)).all(axis=2)
        assert (corners[ids].min(axis=1) <= high).all()
        assert (corners[ids].max(axis=1) >= low).all()
    assert covered.all()


@pytest.mark.parametrize("share", [0.1, 4.0])
@pytest.mark.parametrize("name", ["atrium", "random_triangles", "degenerate", "needles", "grid", "teapot"])
def test_invariants(name, share):
    mesh = SCENES[name]()
    check(build(mesh, described(mesh, share=share, max_leaf_triangles=2)), mesh, share, 2)


@pytest.mark.parametrize("count", [1, 2, 9, 70])
def test_tiny_and_flat_meshes(count):
    """One triangle, a few, in one plane, on one line, in one point, the same one, too large for areas, too small for pads."""
    corners = np.random.default_rng(count).random((count, 3, 3))
    flat, line, point = corners.copy(), corners.copy(), np.full_like(corners, 0.5)
    flat[:, :, 1] = 0.25
    line[:, :, :2] = 0.75
    far = np.concatenate([corners * 1e-6, corners[:1] * 1e3])
    area = wrt.known_rays.PlaneInfluenceArea(position=(0.5, 0.5, -1), direction=(0, 0, 1), width=1, height=1, depth=3)
    for shaped in (corners, flat, line, point, np.repeat(corners[:1], count, axis=0), corners * 1e37, -corners, far):
        mesh = wrt.TriangleMesh(shaped.reshape(-1, 3).astype(np.float32), np.arange(3 * len(shaped)).reshape(-1, 3))
        for others in (0.0, 1.0):
            description = wrt.known_rays.ProjectedBvh(
                areas=area, others=others, width=2, max_leaf_triangles=1, spatial_splits=4.0
            )
            check(build(mesh, description), mesh, 4.0, 1)


def test_threads_and_tasks_do_not_show(monkeypatch):
    mesh = SCENES["atrium"]()
    description = described(mesh, "point inside", axes="facing", max_leaf_triangles=4)
    with use_threads(1):
        reference = build(mesh, description)
    monkeypatch.setattr(binned, "MIN_LARGE", 100)
    monkeypatch.setattr(binned, "TASKS_PER_THREAD", mesh.triangle_count // 100)
    with use_threads(3):
        assert_same_tree(build(mesh, description), reference)


@pytest.mark.parametrize(
    ("name", "kind", "most"),
    [("atrium", "point inside", 0.85), ("atrium", "plane along an axis", 0.7), ("stadium", "plane along an axis", 0.75)],
)
def test_long_triangles_cost_less(name, kind, most):
    """Floors, walls and stands are long triangles beside small ones: rays do less work, as the areas of boxes foresee."""
    mesh = SCENES[name]()
    area = area_of(mesh, kind)
    rays = wrt.Rays(*rays_of(area, 2000))
    plain, split = (
        wrt.known_rays.analyse(wrt.Scene(mesh, wrt.known_rays.ProjectedBvh.published(area, spatial_splits=share)), area, rays)
        for share in (0.0, 1.0)
    )
    assert split.expected_cost < most * plain.expected_cost
    assert split.passing.cost < most * plain.passing.cost
    assert split.error < 0.05


def test_trees_that_would_cost_more_are_not_kept():
    """In the atrium seen obliquely, splits that each cost less gave a tree of 8 children a node that cost 4 % more."""
    mesh = SCENES["atrium"]()
    split, plain = (build(mesh, described(mesh, "plane", share=share)) for share in (0.3, 0.0))
    assert_same_tree(split, plain)
    assert not split.shared


def test_without_overlap_nothing_is_split():
    """Small triangles far apart: no box overlaps another, and the tree has the nodes and leaves of the plain build."""
    corners = np.random.default_rng(2).random((500, 1, 3)) * 100 + np.eye(3) * 1e-3
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(1500).reshape(-1, 3))
    plain, split = (build(mesh, described(mesh, share=share)) for share in (0.0, 4.0))
    assert not split.shared
    np.testing.assert_array_equal(split.child.numpy(), plain.child.numpy())
    np.testing.assert_array_equal(split.bounds.numpy(), plain.bounds.numpy())


def test_statistics_count_references():
    mesh = SCENES["atrium"]()
    description = described(mesh, max_leaf_triangles=2)
    tree = build(mesh, description)
    listed = int((tree.primitive.numpy() >= 0).sum())
    found = bvh_statistics(tree, mesh.triangle_count, description.config(8).cost)
    assert found.duplication == listed / mesh.triangle_count > 1.0
    assert found.block_fill == pytest.approx(listed / len(tree.primitive))


def test_areas_of_a_scene():
    """`wrt.known_rays.RayAwareBvh` clips the triangles of each area, with the pads of the whole scene."""
    mesh, rays, expected, counts = scene_and_rays("atrium")
    area = area_of(mesh, "point inside")
    local = described(mesh, "point inside", max_leaf_triangles=2)
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[area], whole=wrt.Bvh(width=8), local=local))
    assert scene.state.area_trees.scenes[0].tree.shared
    assert not scene.tree.shared
    assert_same_hits(scene.intersect(*rays, traversal="single"), expected)
    np.testing.assert_array_equal(scene.count(*rays), counts)


def test_moved_scenes_are_built_anew():
    """A refitted box would be that of the whole triangle, in every leaf that lists it."""
    mesh, rays, *_ = scene_and_rays("atrium")
    scene = wrt.Scene(mesh, described(mesh, max_leaf_triangles=2))
    moved = wrt.TriangleMesh(mesh.vertices * (1.0, 0.8, 1.0), mesh.faces)
    scene.update(0, vertices=moved.vertices)
    assert scene.tree.shared
    check(build(moved, scene.accelerator), moved, 0.5, 2)
    expected = wrt.Scene(moved, wrt.Bvh(width=8)).intersect(*rays, traversal="brute")
    np.testing.assert_array_equal(scene.intersect(*rays).primitive_id, expected.primitive_id)


@wrt.device.kernel
def count_in_kernel(
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    counts: wp.array(dtype=int),
):
    """Counts crossings inside a kernel."""
    i = wp.tid()
    counts[i] = wrt.device.count_hits(scene, origins[i], directions[i], 0.0, wp.inf)


def test_counts_inside_kernels():
    mesh, rays, _, counts = scene_and_rays("random_triangles")
    scene = wrt.Scene(mesh, described(mesh, "point inside", share=2.0, max_leaf_triangles=2), device="cpu")
    assert scene.tree.shared
    found = wp.zeros(len(counts), dtype=int, device="cpu")
    inputs = [scene.handle(), *(wp.array(part, dtype=wp.vec3, device="cpu") for part in rays), found]
    wp.launch(count_in_kernel, len(counts), inputs=inputs, device="cpu")
    np.testing.assert_array_equal(found.numpy(), counts)


def test_other_traversals_say_so():
    mesh, rays, _, _ = scene_and_rays("atrium")
    scene = wrt.Scene(mesh, described(mesh, max_leaf_triangles=2))
    for traversal in ("stream", "interleaved", "queued"):
        with pytest.raises(ValueError, match=r"'count' on a BVH with spatial splits; choose from auto, brute, single"):
            scene.count(*rays, traversal=traversal)
    with pytest.raises(ValueError, match="trees of instances cannot have spatial splits"):
        wrt.Scene(wrt.Instance(mesh), described(mesh))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spatial_splits": -0.1}, "spatial_splits is -0.1; it must be from 0 to 4"),
        ({"spatial_splits": 4.5}, "spatial_splits is 4.5"),
        ({"spatial_splits": float("nan")}, "spatial_splits is nan"),
        ({"spatial_splits": 0.5, "subset": 0.5}, "spatial_splits and subset are both given"),
    ],
)
def test_bad_descriptions(change, message):
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 0), direction=(0, 0, 1), width=1, height=1, depth=1)
    with pytest.raises(ValueError, match=message):
        wrt.known_rays.ProjectedBvh(areas=area, **change)


def test_boxes_alone_cannot_be_split():
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 0), direction=(0, 0, 1), width=1, height=1, depth=1)
    with pytest.raises(ValueError, match="spatial splits clip triangles, and these boxes have none"):
        wrt.known_rays.ProjectedBvh(areas=area, spatial_splits=0.5).build(boxes_of(np.zeros((3, 3)), np.ones((3, 3))), 8)


def test_pads_are_those_of_the_scene():
    mesh = SCENES["teapot"]()
    triangles = triangle_boxes(*arrays_of(mesh))
    assert spatial_build.scene_mesh(triangles).pad == pytest.approx(PAD * triangles.size)
    triangles.of_size = 100.0
    assert spatial_build.scene_mesh(triangles).pad == pytest.approx(100.0 * PAD)


@pytest.mark.parametrize("far", [1.0, 1e2, 1e4])
def test_no_hit_is_lost(far):
    """Rays at triangles, their edges and vertices, from up to 10,000 times the size of the scene away."""
    for name, options in (("needles", {"share": 1.0}), ("random_triangles", {"share": 2.0})):
        mesh = SCENES[name]()
        rng = np.random.default_rng(4)
        corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, 10000)]].astype(np.float64)
        weights, kind = rng.dirichlet((1, 1, 1), 10000), rng.integers(0, 3, 10000)
        weights[kind == 1, 2] = 0.0
        weights[kind == 2] = [1.0, 0.0, 0.0]
        targets = (corners * (weights / weights.sum(axis=1, keepdims=True))[:, :, None]).sum(axis=1)
        origins = mesh.center + far * mesh.extent * rng.normal(size=(10000, 3))
        scene = wrt.Scene(mesh, described(mesh, "point inside", max_leaf_triangles=2, **options))
        reference = wrt.Scene(mesh, wrt.Bvh(width=8))
        assert scene.tree.shared
        hits, expected = (s.intersect(origins, targets - origins, traversal="single") for s in (scene, reference))
        assert_same_hits(hits, expected)
        counts = [s.count(origins, targets - origins) for s in (scene, reference)]
        np.testing.assert_array_equal(*counts)
        assert counts[1].mean() > 0.3
