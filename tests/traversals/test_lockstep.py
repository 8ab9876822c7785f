"""What only the lockstep traversal has: lanes, runs of rays, a log of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.selection import slow

import wrt
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH
from wrt.kernels.traversal.lockstep.lockstep_kernel import lane_count, rays_per_item
from wrt.kernels.traversal.traversal_config import TraversalConfig

pytestmark = pytest.mark.width

WIDTH = 4
CONFIG = TraversalConfig("woop", WIDTH)


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=4)


def assert_equals_single(scene, origins, directions, **ranges):
    """Hits, occlusion, and the work of each ray."""
    hits = scene.intersect(origins, directions, **ranges, traversal="lockstep", counters=True)
    expected = scene.intersect(origins, directions, **ranges, traversal="single", counters=True)
    assert_same_hits(hits, expected)
    for name, work in expected.counters.items():
        np.testing.assert_array_equal(hits.counters[name], work, err_msg=name)
    dark = scene.occluded(origins, directions, **ranges, traversal="lockstep")
    np.testing.assert_array_equal(dark, expected.is_hit)


@pytest.mark.parametrize("around", [0, lane_count(CONFIG), rays_per_item(CONFIG), 3 * rays_per_item(CONFIG)])
@pytest.mark.parametrize("more", [-1, 0, 1])
def test_ray_counts(teapot, device, around, more):
    """None, one, and counts about the number of lanes and the length of a run."""
    count = max(0, around + more)
    scene = wrt.Scene(teapot, wrt.KdTree(width=WIDTH), device=device)
    assert_equals_single(scene, *mixed_rays(teapot, count, seed=count))


@pytest.mark.parametrize("width", [WIDTH, *slow(1, 2, 8, 16)])
def test_lane_counts(teapot, width):
    scene = wrt.Scene(teapot, wrt.KdTree(width=width, block_cost=4.0), device="cpu")
    assert_equals_single(scene, *mixed_rays(teapot, 3000, seed=width))


def test_deepest_tree_fills_the_log():
    """A chain of MAX_TREE_DEPTH inner nodes: rays that come from its end have as many cells waiting at a time."""
    count = MAX_TREE_DEPTH + 1
    corners = np.array([[0.5, 0, 0], [0.5, 1, 0], [0.5, 0, 1]]) + np.arange(count)[:, None, None] * [1, 0, 0]
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    scene = wrt.Scene(mesh, wrt.KdTree(width=WIDTH), device="cpu")
    nodes = np.zeros((2 * count - 1, 2), dtype=np.int32)  # inner node k splits behind triangle k; its left child is a leaf
    nodes[::2, 0][:-1] = (np.arange(1, count) - scene.center[0]).astype(np.float32).view(np.int32)
    nodes[::2, 1][:-1] = np.arange(2, 2 * count, 2) << 2
    leaves = np.append(np.arange(1, 2 * count - 2, 2), 2 * count - 2)
    nodes[leaves, 0] = np.arange(count)
    nodes[leaves, 1] = 1 << 2 | LEAF
    primitive = np.full((count, WIDTH), -1, dtype=np.int32)
    primitive[:, 0] = np.arange(count)
    tree = replace(scene.tree, nodes=wp.array(nodes, dtype=wp.vec2i), primitive=wp.array(primitive.ravel(), dtype=int))
    scene.state = scene.state.over(tree)
    rng = np.random.default_rng(0)
    ends = rng.uniform([[-1, 0, 0], [count, 0, 0]], [[0, 1, 1], [count + 1, 1, 1]], (3000, 2, 3))
    ends[::5] = ends[::5, ::-1]
    origins, directions = ends[:, 1], ends[:, 0] - ends[:, 1]
    assert_equals_single(scene, origins, directions)
    hits = scene.intersect(origins, directions, traversal="lockstep", counters=True)
    assert_same_hits(hits, scene.intersect(origins, directions, traversal="brute"))
    assert hits.counters["nodes"].max() == MAX_TREE_DEPTH


def test_only_bad_rays(teapot):
    origins, directions = np.zeros((100, 3)), np.zeros((100, 3))
    assert_equals_single(wrt.Scene(teapot, "kdtree", device="cpu"), origins, directions)
