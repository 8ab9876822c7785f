"""Hierarchies built for tests, and what all of them must fulfil."""

from __future__ import annotations

import numpy as np
import warp as wp

import wrt
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.bvh_statistics import unpack
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, MAX_WIDE_DEPTH


def arrays_of(mesh: wrt.TriangleMesh) -> tuple[wp.array, wp.array]:
    vertices = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
    return vertices, wp.array(mesh.faces, dtype=wp.vec3i, device="cpu")


def build(mesh: wrt.TriangleMesh, builder: str = "binned", width: int = 8, **options):
    cost = SurfaceAreaCost(width=width, **{k: options.pop(k) for k in ("traversal", "block") if k in options})
    config = BvhConfig(cost=cost, **options)
    return BVH_BUILDERS[builder].build(triangle_boxes(*arrays_of(mesh)), config), config


def mesh_of(corners: np.ndarray) -> wrt.TriangleMesh:
    """A mesh of triangles (n, 3, 3) that share no vertex."""
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * len(corners)).reshape(-1, 3))


def check(tree, vertices: np.ndarray, faces: np.ndarray, config: BvhConfig) -> None:
    """Every invariant of the layout and of the contract, against boxes computed here."""
    flat, width = unpack(tree), tree.width
    corners = vertices.astype(np.float32)[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    nodes = len(flat.child)
    primitive = tree.primitive.numpy().reshape(-1, width)
    listed = primitive[primitive >= 0]
    np.testing.assert_array_equal(np.sort(listed), np.arange(len(faces)))  # every triangle once
    used = flat.is_leaf | flat.is_inner
    assert (flat.child[~used] == EMPTY_LANE).all()
    assert (flat.low[~used] == np.inf).all()
    assert (flat.high[~used] == -np.inf).all()
    assert (flat.triangles[flat.is_leaf] >= 1).all()
    assert flat.triangles.max() <= config.leaf_limit
    # leaf blocks: one after the other in the order of nodes and lanes, unused lanes of a block at its end
    sizes, first = flat.triangles[flat.is_leaf], flat.first_block[flat.is_leaf]
    blocks = -(-sizes // width)
    np.testing.assert_array_equal(first, np.cumsum(blocks) - blocks)
    assert blocks.sum() == len(primitive)
    lanes = np.arange(len(primitive) * width) - np.repeat(first, blocks * width) * width
    np.testing.assert_array_equal(primitive.reshape(-1) >= 0, lanes < np.repeat(sizes, blocks * width))
    # inner nodes: breadth-first, siblings together, levels as told
    np.testing.assert_array_equal(flat.child[flat.is_inner], np.arange(1, nodes))
    assert tree.level_first[0] == 0
    assert tree.level_first[-1] == nodes
    parent = np.zeros(nodes, dtype=int)
    parent[1:] = np.repeat(np.arange(nodes), flat.is_inner.sum(axis=1))
    np.testing.assert_array_equal(flat.depth[1:], flat.depth[parent[1:]] + 1)
    assert tree.depth <= MAX_WIDE_DEPTH
    # boxes, bottom up
    box_low, box_high = np.full((nodes, 3), np.inf, np.float32), np.full((nodes, 3), -np.inf, np.float32)
    for node in range(nodes - 1, -1, -1):
        for lane in np.flatnonzero(used[node]):
            child = flat.child[node, lane]
            if child >= 0:
                lane_low, lane_high = box_low[child], box_high[child]
            else:
                begin, count = flat.first_block[node, lane] * width, flat.triangles[node, lane]
                ids = tree.primitive.numpy()[begin : begin + count]
                lane_low, lane_high = low[ids].min(axis=0), high[ids].max(axis=0)
            assert (flat.low[node, lane] == lane_low).all()
            assert (flat.high[node, lane] == lane_high).all()
            box_low[node] = np.minimum(box_low[node], lane_low)
            box_high[node] = np.maximum(box_high[node], lane_high)
    np.testing.assert_array_equal(np.array(tree.low, np.float32), box_low[0])
    np.testing.assert_array_equal(np.array(tree.high, np.float32), box_high[0])


def assert_same_tree(a, b) -> None:
    """Equal to the bit."""
    np.testing.assert_array_equal(a.child.numpy(), b.child.numpy())
    np.testing.assert_array_equal(a.primitive.numpy(), b.primitive.numpy())
    np.testing.assert_array_equal(a.bounds.numpy().view(np.int32), b.bounds.numpy().view(np.int32))
    assert a.level_first == b.level_first
    assert (a.low, a.high) == (b.low, b.high)
