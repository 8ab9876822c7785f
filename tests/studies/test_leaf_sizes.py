"""Vertex culling by the size of leaves: what is counted."""

from __future__ import annotations

import wrt
from studies.kdtrees.leaf_sizes import compare_leaf_sizes


def test_larger_leaves():
    mesh = wrt.scenes.build("random_triangles", count=2000, size=0.05)
    small, large = compare_leaf_sizes(mesh, leaves=(0, 256), cullings=("vertex",), size=32, rounds=1)
    assert small.same
    assert large.same
    assert large.nodes < 0.5 * small.nodes
    assert large.mean_leaf > small.mean_leaf
    assert 0.0 < small.culled < 1.0
