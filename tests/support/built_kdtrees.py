"""Kd-trees built for tests, their leaves, and what must be listed there."""

from __future__ import annotations

import numpy as np
import warp as wp

import wrt
from wrt.builders.core.clip import PAD
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.triangle_boxes import triangle_boxes


def boxes_of(mesh: wrt.TriangleMesh):
    device = wp.get_device("cpu")
    vertices = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device)
    return triangle_boxes(vertices, wp.array(mesh.faces, dtype=wp.vec3i, device=device))


def build(mesh: wrt.TriangleMesh, builder: str = "in_place", **options):
    description = wrt.KdTree(builder=builder, **options)
    config = description.config(width=8)
    return KDTREE_BUILDERS[builder].build(boxes_of(mesh), config), config


def scattered_soup(count: int, seed: int) -> wrt.TriangleMesh:
    """Small random triangles all over a large cube."""
    rng = np.random.default_rng(seed)
    corners = rng.random((count, 1, 3)) * 40 + rng.random((count, 3, 3))
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def leaf_references(tree) -> np.ndarray:
    """(2, references) the leaf's node and the triangle of every reference, sorted; lanes that hold none are marked."""
    flat, primitive = unpack(tree), tree.primitive.numpy()
    leaves = np.flatnonzero(flat.is_leaf)
    counts = flat.triangles[leaves]
    lanes = -(-counts // tree.width) * tree.width
    lane = np.arange(lanes.sum()) - np.repeat(np.cumsum(lanes) - lanes, lanes)
    triangle = primitive[np.repeat(flat.first_block[leaves] * tree.width, lanes) + lane]
    used = lane < np.repeat(counts, lanes)
    assert (triangle[~used] == -1).all()
    references = np.stack([np.repeat(leaves, counts), triangle[used]])
    return references[:, np.lexsort(references[::-1])]


def hard_meshes() -> dict[str, wrt.TriangleMesh]:
    """Around the sizes at which searches change, and shapes that tempt builders to divide without end."""
    rng = np.random.default_rng(7)
    sizes = (31, 32, 33, 36, 37)
    meshes = {f"{n} triangles": scattered_soup(n, seed=n) for n in sizes}
    one = rng.random((1, 3, 3))
    tiny = rng.random((3000, 1, 3)) * 0.01 + rng.random((3000, 3, 3)) * 1e-4
    shapes = {
        "identical": np.repeat(one, 3000, axis=0),
        "across each other": np.insert(rng.random((3000, 3, 2)), 2, 0.5, axis=2),
        "coplanar": np.insert(rng.random((3000, 1, 2)) + 0.05 * rng.random((3000, 3, 2)), 2, 0.5, axis=2),
        "one huge, many tiny": np.concatenate([np.array([[[-1e3, 0, 0], [1e3, 0, 0], [0, 1e3, 1e3]]]), tiny]),
        "needles": rng.random((2000, 1, 3)) + rng.normal(size=(2000, 3, 1)) + 0.02 * rng.random((2000, 3, 3)),
    }
    for name, corners in shapes.items():
        meshes[name] = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    return meshes


def part_in(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N, 3) the corners of a triangle's part in a box, both closed: by clipping in float64, written for these tests alone."""
    polygon = corners.astype(np.float64)
    for axis in range(3):
        for sign, bound in ((1.0, low[axis]), (-1.0, high[axis])):
            if len(polygon) == 0:
                return polygon
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
    return polygon


def meets(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether a triangle has a point in a box."""
    return len(part_in(corners, low, high)) > 0


def assert_leaves_list_what_they_meet(mesh: wrt.TriangleMesh, builder: str) -> None:
    """Every triangle that meets the inside of a leaf, and none that is further away than what cells are enlarged by."""
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
