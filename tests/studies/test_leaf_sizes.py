"""Vertex culling by the size of leaves: what is counted, and a verdict that the figures decide."""

from __future__ import annotations

from dataclasses import replace

import wrt
from studies.kdtrees.leaf_sizes import LeafFigures, compare_leaf_sizes, judge_leaves


def test_larger_leaves():
    mesh = wrt.scenes.build("random_triangles", count=2000, size=0.05)
    small, large = compare_leaf_sizes(mesh, leaves=(0, 256), cullings=("vertex",), size=32, rounds=1)
    assert small.same
    assert large.same
    assert large.nodes < 0.5 * small.nodes
    assert large.mean_leaf > small.mean_leaf
    assert 0.0 < small.culled < 1.0


def test_verdicts():
    small = LeafFigures(0, "vertex", 1000, 5.0, 0.5, 10.0, True)
    large = LeafFigures(512, "vertex", 100, 300.0, 0.95, 5.0, True)
    assert [*judge_leaves([small, large]).values()] == [True, True, True, False]
    assert all(judge_leaves([small, replace(large, megarays=11.0)]).values())
    assert [*judge_leaves([small, replace(large, nodes=101)]).values()] == [False] * 4
    assert [*judge_leaves([small, replace(large, culled=0.9)]).values()] == [True, True, False, False]
