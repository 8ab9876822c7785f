"""What is built does not depend on the number of threads; kernels that took the place of NumPy give its results."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.layout.mesh_placement import relative_to
from wrt.kernels.query.nearest64 import nearest_hits, vertex_rows
from wrt.kernels.runtime.launch import use_threads

COUNT = 20_000
"""Triangles: enough for nodes that several threads split together."""


def soup() -> wrt.TriangleMesh:
    """Small triangles of all kinds; some are flat along an axis, some are points, some there twice."""
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(COUNT, 1, 3)) + 0.02 * rng.normal(size=(COUNT, 3, 3))
    corners[::7, :, 1] = np.round(corners[::7, :1, 1], 1)
    corners[::31] = corners[::31, :1]
    corners[5::50] = corners[4::50]
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * COUNT).reshape(-1, 3))


BUILDERS = [(wrt.Bvh, name) for name in BVH_BUILDERS] + [
    (wrt.KdTree, name)
    for name, builder in KDTREE_BUILDERS.items()
    if builder.start is None and builder.max_triangles > COUNT and name != "sorting_sweep"
]


@pytest.mark.parametrize(("tree", "builder"), BUILDERS)
def test_tree_is_the_same_for_any_number_of_threads(tree, builder):
    mesh, accelerator, trees = soup(), tree(builder=builder), []
    for threads in (1, 2, 7):
        tree = wrt.Scene(mesh, accelerator, device="cpu", num_threads=threads).tree
        arrays = (tree.nodes,) if accelerator.kind == "kdtree" else (tree.bounds, tree.child)
        trees.append([array.numpy().tobytes() for array in (*arrays, tree.primitive)])
    assert trees[0] == trees[1] == trees[2]


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_relative_positions_are_those_of_numpy(dtype, threads):
    rng = np.random.default_rng(0)
    for scale in (1e-42, 1e-5, 1.0, 1e30, 1e37) + ((1e300,) if dtype is np.float64 else ()):
        vertices = (rng.uniform(-1, 1, (9001, 3)) * scale).astype(dtype)
        vertices[5] = -0.0
        for center in (np.zeros(3), vertices[7].astype(np.float64), np.array([1e38, 0.1, -5e5])):
            with np.errstate(over="ignore"):  # what no triangle uses may become infinite
                expected = (vertices - center).astype(np.float32)
            with use_threads(threads):
                assert relative_to(center, vertices).tobytes() == expected.tobytes()


@pytest.mark.parametrize("count", [1, 7, 8, 9, 1024, 1500])
def test_nearest_hits_in_float64(count):
    """Against closed-form answers: triangles that rays along z meet at their own heights, however many lanes are in use."""
    rng = np.random.default_rng(count)
    heights = rng.permutation(count) + 1.0
    corners = np.array([[-1.0, -1.0], [3.0, -1.0], [-1.0, 3.0]])
    vertices = np.concatenate([np.tile(corners, (count, 1)), np.repeat(heights, 3)[:, None]], axis=1)
    faces = np.arange(3 * count).reshape(-1, 3)
    origins = np.array(
        [[0.0, 0, 0], [0, 0, 0], [5, 5, 0], [0, 0, 0], [-1, -1, 0.0], [np.nan, 0, 0], [0, 0, 0], [0, 0, count + 2.0]]
    )
    directions = np.array([[0, 0, 2.0], [0, 0, -1], [0, 0, 1], [0, 0, 0], [0, 0, 1], [0, 0, 1], [0, np.inf, 1], [0, 0, -1]])
    low, high = int(heights.argmin()), int(heights.argmax())
    for threads in (1, 2, 5):
        with use_threads(threads):
            triangle, t = nearest_hits(vertex_rows(vertices, faces), origins, directions)
        assert triangle.tolist() == [low, -1, -1, -1, low, -1, -1, high]
        assert t.tolist() == [0.5, np.inf, np.inf, np.inf, 1.0, np.inf, np.inf, 2.0]
    vertices[:, 2] = 1.0
    triangle, _ = nearest_hits(vertex_rows(vertices, faces), origins[:1], directions[:1])
    assert triangle.tolist() == [0]  # of equally near ones the first
