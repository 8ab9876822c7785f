"""Split clipping: leaves list the triangles that they meet, and no others; the hits stay those of brute force."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SCENES
from test_kdtree_builders import build, leaf_references

import wrt
from wrt import scenes
from wrt.builders.kdtree import binned
from wrt.builders.kdtree.clipping import PAD
from wrt.builders.kdtree.statistics import kdtree_statistics, unpack
from wrt.kernels.launch import use_threads


def meets(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a triangle has a point in a box, both closed: by clipping in float64, written for this test alone."""
    polygon = corners.astype(np.float64)
    for axis in range(3):
        for sign, bound in ((1.0, low[axis]), (-1.0, high[axis])):
            if len(polygon) == 0:
                return False
            inside = sign * (polygon[:, axis] - bound) >= 0.0
            following, after = np.roll(polygon, -1, axis=0), np.roll(inside, -1)
            clipped = []
            for a, b, a_in, b_in in zip(polygon, following, inside, after, strict=True):
                if a_in:
                    clipped.append(a)
                if a_in != b_in:
                    share = (bound - a[axis]) / (b[axis] - a[axis])
                    clipped.append(a + share * (b - a))
            polygon = np.array(clipped).reshape(-1, 3)
    return len(polygon) > 0


@pytest.mark.parametrize("builder", ["binned", "naive"])
@pytest.mark.parametrize("name", ["random_triangles", "degenerate"])
def test_leaves_list_what_they_meet(builder, name):
    """Every triangle that meets the inside of a leaf, and none that is further away than what cells are enlarged by."""
    mesh = SCENES[name]()
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    pad = PAD * float((corners.max((0, 1)) - corners.min((0, 1))).max())
    tree, _ = build(mesh, builder, split_clipping=True)
    flat, (leaf, triangle) = unpack(tree), leaf_references(tree)
    low, high = corners.min(axis=1), corners.max(axis=1)
    checked, box_only = 0, 0
    for node in np.flatnonzero(flat.is_leaf)[::5]:
        ids = triangle[leaf == node]
        cell_low, cell_high = flat.low[node], flat.high[node]
        near = np.flatnonzero(((low <= cell_high) & (high >= cell_low)).all(axis=1))
        must = {i for i in near if meets(corners[i], cell_low + 1e-7, cell_high - 1e-7)}
        assert must <= set(ids)
        for i in ids:
            assert meets(corners[i], cell_low - 3 * pad, cell_high + 3 * pad)
        checked, box_only = checked + len(must), box_only + len(near) - len(must)
    assert checked > 100
    assert box_only > 20  # boxes alone would have listed them


def test_no_hit_is_lost(scene_mesh):
    """Closest hits and all hits, as with a tree of whole boxes, of rays from inside, from far outside, and at vertices."""
    scene = wrt.Scene(scene_mesh, wrt.KdTree(builder="binned", split_clipping=True), device="cpu")
    judge = wrt.Scene(scene_mesh, wrt.KdTree(builder="binned"), device="cpu")
    rng = np.random.default_rng(5)
    low, high = scene_mesh.vertices.min(axis=0), scene_mesh.vertices.max(axis=0)
    size = (high - low).max()
    origins = (low + high) / 2 + size * rng.normal(size=(1500, 3)) * rng.choice([0.3, 2.0, 10.0], (1500, 1))
    corner = scene_mesh.vertices[rng.integers(0, len(scene_mesh.vertices), 1500)]
    inside = low + (high - low) * rng.random((1500, 3))
    directions = np.where(rng.random((1500, 1)) < 0.5, corner, inside) - origins
    hits, expected = (s.intersect(origins, directions, traversal="single") for s in (scene, judge))
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    lists, all_expected = (s.intersect_all(origins, directions) for s in (scene, judge))
    np.testing.assert_array_equal(lists.offsets, all_expected.offsets)
    np.testing.assert_array_equal(lists.primitive_id, all_expected.primitive_id)
    assert expected.is_hit.mean() > 0.2
    brute = scene.intersect(origins[:200], directions[:200], traversal="brute")
    np.testing.assert_array_equal(hits.t[:200], brute.t)


def test_the_tree_is_cheaper_for_any_number_of_threads(monkeypatch):
    """Fewer references and a lower cost; where levels are split by several threads, the tree is the same too."""
    mesh = scenes.build("random_triangles", count=2000, size=0.3, seed=6)
    monkeypatch.setattr(binned, "CLIPPED_LARGE", 700)
    trees = []
    for threads in (1, 3):
        with use_threads(threads):
            trees.append(build(mesh, "binned", split_clipping=True)[0])
    np.testing.assert_array_equal(trees[0].nodes.numpy(), trees[1].nodes.numpy())
    np.testing.assert_array_equal(trees[0].primitive.numpy(), trees[1].primitive.numpy())
    plain, config = build(mesh, "binned")
    costs = [kdtree_statistics(tree, mesh.triangle_count, config.cost) for tree in (trees[0], plain)]
    assert costs[0].references < 0.95 * costs[1].references
    assert costs[0].sah_cost < 0.97 * costs[1].sah_cost


def test_builders_that_do_not_clip_say_so():
    with pytest.raises(ValueError, match=r"'in_place' does not clip; choose from binned"):
        wrt.KdTree(split_clipping=True)
