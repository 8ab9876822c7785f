"""Trees of fuzzy boxes: in every frame the hits of a tree of its own; and the motion that is found in an animation."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.hits import assert_same_hits, mixed_rays
from support.ptx import compile_to_ptx
from support.selection import slow

import wrt
from wrt.builders.motion_clusters import assign_triangles, decompose, fit_maps, fuzzy_boxes
from wrt.kernels.runtime.launch import CUDA_BLOCK
from wrt.kernels.traversal.traversal_config import StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level.fuzzy_boxes import make_fuzzy_kernel

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2))
TWO = wrt.TriangleMesh.concatenate([BALL, BALL.transformed(trimesh.transformations.translation_matrix([4, 0, 0]))])


def turns(count: int, seed: int) -> np.ndarray:
    """(count, 4, 4): the identity, then rigid motions."""
    rng = np.random.default_rng(seed)
    maps = [np.eye(4)]
    for _ in range(count - 1):
        maps.append(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        maps[-1][:3, 3] = rng.uniform(-3, 3, 3)
    return np.array(maps)


def moved(points: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """(F, N, 3)"""
    return points @ maps[:, :3, :3].swapaxes(1, 2) + maps[:, None, :3, 3]


def two_bodies(noise: float = 0.0) -> np.ndarray:
    """(6, V, 3): two balls that move by themselves, and tremble."""
    count, rng = BALL.vertex_count, np.random.default_rng(5)
    halves = [moved(TWO.vertices[:count], turns(6, 1)), moved(TWO.vertices[count:], turns(6, 2))]
    frames = np.concatenate(halves, axis=1)
    frames[1:] += rng.normal(0, noise, frames[1:].shape) if noise else 0.0
    return frames


def stretched() -> np.ndarray:
    """(6, V, 3): one ball, sheared and flattened from frame to frame, and far from the origin."""
    rng = np.random.default_rng(8)
    maps = np.eye(4) + np.pad(rng.uniform(-0.6, 0.6, (6, 3, 4)), ((0, 0), (0, 1), (0, 0)))
    maps[4, 2, :3] = 0.0  # flat
    frames = moved(TWO.vertices, maps) + np.array([100.0, -50.0, 1e3])
    frames[5] = rng.permutation(frames[5])  # what no map explains
    return frames


ANIMATIONS = {"rigid": two_bodies, "trembling": lambda: two_bodies(0.05), "stretched": stretched}


@pytest.mark.parametrize("name", ANIMATIONS)
@pytest.mark.parametrize("clusters", [1, 7])
def test_every_frame_as_a_fresh_tree(name, clusters):
    """To the bit, whatever the maps, in every query."""
    scene = wrt.moving.FuzzyScene(ANIMATIONS[name](), TWO.faces, clusters=clusters, device="cpu")
    tree = scene.tree.parts.bounds
    for frame in (3, 4, 5, 0):
        scene.show(frame)
        fresh = wrt.Scene(scene.meshes, device="cpu")
        rays = mixed_rays(scene.flattened(), 1500)
        hits = scene.intersect(*rays)
        assert hits.is_hit.sum() >= 20
        assert_same_hits(hits, fresh.intersect(*rays, traversal="single"))
        np.testing.assert_array_equal(scene.count(*rays), fresh.count(*rays, traversal="single"))
        np.testing.assert_array_equal(scene.bounds, fresh.bounds)
    np.testing.assert_array_equal(scene.occluded(*rays), hits.is_hit)
    lists = scene.intersect_all(*rays, max_hits=1)
    np.testing.assert_array_equal(lists.count > 0, scene.count(*rays) > 0)
    np.testing.assert_array_equal(scene.intersect(*rays, traversal="brute").t, hits.t)
    assert scene.tree.parts.bounds is tree  # built once


@pytest.mark.parametrize("name", ["trembling", *slow("stretched")])
def test_every_frame_of_kdtrees(name):
    """The paper's trees, in every query. Crossings once came from the root of another cluster's tree, and were lost."""
    scene = wrt.moving.FuzzyScene(ANIMATIONS[name](), TWO.faces, clusters=7, accelerator=wrt.KdTree(), device="cpu")
    for frame in (3, 4, 5, 0):
        scene.show(frame)
        fresh = wrt.Scene(scene.meshes, device="cpu")
        rays = mixed_rays(scene.flattened(), 1500)
        hits = scene.intersect(*rays)
        assert hits.is_hit.sum() >= 20
        assert_same_hits(hits, fresh.intersect(*rays, traversal="brute"))
        np.testing.assert_array_equal(scene.count(*rays), fresh.count(*rays, traversal="single"))
    np.testing.assert_array_equal(scene.occluded(*rays), hits.is_hit)
    assert "kdtree, single" in str(hits.plan)
    assert scene.tree.bytes > 0


def test_skinned_mesh():
    """Bones make the clusters: each ball goes with its own."""
    maps = np.stack([turns(6, 1), turns(6, 2), turns(6, 3)], axis=1)
    scene = wrt.moving.FuzzyScene(two_bodies(), TWO.faces, transforms=maps, device="cpu")
    np.testing.assert_array_equal(scene.labels, np.repeat([0, 1], BALL.triangle_count))
    scene.show(2)
    rays = mixed_rays(scene.flattened(), 500)
    assert_same_hits(scene.intersect(*rays), wrt.Scene(scene.meshes, device="cpu").intersect(*rays, traversal="single"))


def test_rays_from_afar_in_sheared_space():
    """Rounding is that of the scene, however small the ray's numbers are in the cluster's space: boxes there allow for it."""
    ball = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(3))
    to_own = np.eye(4)
    to_own[:3, :3] = [[1.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1e-3, 0.0, 1e-3]]  # (1, 0, 1) has a small image
    scene = wrt.moving.FuzzyScene(ball.vertices[None], ball.faces, transforms=np.linalg.inv(to_own)[None, None], device="cpu")
    rng = np.random.default_rng(0)
    origins = (np.array([1e4, 0.0, 1e4]) + rng.uniform(-1, 1, (2000, 3))).astype(np.float32)
    directions = (ball.vertices[rng.integers(0, ball.vertex_count, 2000)] - origins).astype(np.float32)
    expected = wrt.Scene(ball, device="cpu").intersect(origins, directions, traversal="single")
    assert expected.is_hit.mean() > 0.9
    assert_same_hits(scene.intersect(origins, directions), expected)


def test_rigid_parts_are_found():
    """Two clusters, one a body, are all that two bodies need."""
    frames = two_bodies()
    found = decompose(frames, TWO.faces, 8, 1e-3, 0)
    assert found.matrices.shape[1] == 2
    assert len(np.unique(found.labels[: BALL.triangle_count])) == 1
    assert found.labels[0] != found.labels[-1]
    assert found.residual.max() < 1e-3
    one = decompose(frames, TWO.faces, 1, 1e-3, 0)
    assert one.residual.max() > 1.0
    trembling = [decompose(two_bodies(0.05), TWO.faces, count, 0.0, 0).residual.sum() for count in (1, 2, 6)]
    assert trembling[0] > 2 * trembling[1] > 2 * trembling[2] * 0.9


def test_the_best_rest_pose():
    """Frame 0 is crumpled: maps that are fitted from it shrink, and boxes in their spaces are large."""
    frames = two_bodies()
    frames[0] += np.random.default_rng(3).normal(0.0, 1.0, frames[0].shape)
    first, best = (wrt.moving.FuzzyScene(frames, TWO.faces, clusters=2, rest=rest, device="cpu") for rest in (0, "best"))
    sizes = [
        float(np.prod(scene.tree.clusters.numpy()["high"] - scene.tree.clusters.numpy()["low"], axis=1).sum())
        for scene in (first, best)
    ]
    assert sizes[1] < 0.7 * sizes[0]
    best.show(4)
    rays = mixed_rays(best.flattened(), 500)
    assert_same_hits(best.intersect(*rays), wrt.Scene(best.meshes, device="cpu").intersect(*rays, traversal="single"))


def test_fitted_maps_are_those_that_moved_the_points():
    """Of flat point sets too, as a rotation; never singular."""
    points = np.random.default_rng(0).normal(size=(50, 3))
    maps = np.eye(4) + np.pad(np.random.default_rng(1).uniform(-0.3, 0.3, (4, 3, 4)), ((0, 0), (0, 1), (0, 0)))
    matrices, origins = fit_maps(points, moved(points, maps))
    np.testing.assert_allclose(matrices, maps[:, :3, :3], atol=5e-3)
    np.testing.assert_allclose(origins, moved(points, maps).mean(axis=1))
    flat = points * [1.0, 1.0, 0.0]
    matrices, _ = fit_maps(flat, moved(flat, turns(4, 0)))
    np.testing.assert_allclose(matrices, turns(4, 0)[:, :3, :3], atol=1e-9)
    matrices, _ = fit_maps(points, np.zeros((2, 50, 3)))
    np.testing.assert_allclose(matrices @ matrices.swapaxes(1, 2), np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)


def test_fuzzy_boxes_hold_their_triangles():
    frames, rng = two_bodies(0.05), np.random.default_rng(0)
    found = decompose(frames, TWO.faces, 2, 0.0, 0)
    own = found.labels == 1
    points = frames[:, TWO.faces[own]]
    corners = np.stack([points.min(axis=2), points.max(axis=2)], axis=1)
    low, high = fuzzy_boxes(corners, found.matrices[:, 1], found.origins[:, 1])
    inside = corners[:, 0] + rng.random(points[:, :, 0].shape) * (corners[:, 1] - corners[:, 0])
    mapped = np.linalg.solve(found.matrices[:, 1], (inside - found.origins[:, 1, None]).swapaxes(1, 2)).swapaxes(1, 2)
    assert (mapped >= low).all()
    assert (mapped <= high).all()
    unused = assign_triangles(frames, TWO.faces, found.matrices[:, [0, 1, 1]], found.origins[:, [0, 1, 1]])
    assert unused.matrices.shape[1] == 2  # the third is never nearer than the second


PROJECTED = wrt.known_rays.ProjectedBvh(
    areas=wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=1, height=1, depth=1)
)

BAD = {
    "shape": (lambda f: wrt.moving.FuzzyScene(f[0], TWO.faces), ValueError, r"shape \(F, V, 3\)"),
    "nan": (lambda f: wrt.moving.FuzzyScene(f * np.nan, TWO.faces), ValueError, "finite"),
    "clusters": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, clusters=0), ValueError, "clusters is 0"),
    "rest": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, rest=6), ValueError, "from 0 to 5"),
    "rest by name": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, rest="first"), ValueError, "'best' or the number"),
    "bones": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, transforms=np.eye(4)), ValueError, r"\(6, B, 4, 4\)"),
    "singular": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, transforms=np.zeros((6, 1, 4, 4))), ValueError, "affine"),
    "projected": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces, accelerator=PROJECTED), TypeError, r"must be a wrt\.Bvh"),
    "lazy": (
        lambda f: wrt.moving.FuzzyScene(f, TWO.faces, accelerator=wrt.KdTree(builder="lazy")),
        ValueError,
        "cannot be lazy",
    ),
    "clips": (
        lambda f: wrt.moving.FuzzyScene(f, TWO.faces, accelerator=wrt.KdTree(split_clipping=True)),
        ValueError,
        "cannot clip",
    ),
    "frame": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces).show(6), ValueError, "frame indices go from 0 to 5"),
    "update": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces).update(0, vertices=f[0]), ValueError, r"show\(frame\)"),
    "packets": (
        lambda f: wrt.moving.FuzzyScene(f, TWO.faces).intersect(f[0], f[0] + 1.0, traversal="stream"),
        ValueError,
        "their own spaces",
    ),
    "precise": (
        lambda f: wrt.moving.FuzzyScene(f, TWO.faces).intersect(f[0], f[0] + 1.0, precise=True),
        ValueError,
        "single tree",
    ),
    "handle": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces).handle(), ValueError, "single tree"),
    "statistics": (lambda f: wrt.moving.FuzzyScene(f, TWO.faces).statistics(), ValueError, "several trees"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    call, error, message = BAD[case]
    with pytest.raises(error, match=message):
        call(two_bodies())


@pytest.mark.slow
def test_compiles_for_cuda(tmp_path):
    config = TraversalConfig("woop", 2, "closest", stack=StackConfig(24, CUDA_BLOCK))
    text = compile_to_ptx(make_fuzzy_kernel(config).module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text
