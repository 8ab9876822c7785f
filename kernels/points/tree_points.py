"""The kernels that search the nearest triangle of points in trees. The walks are in kernels/native/points.h."""

from functools import cache
from typing import NamedTuple

import warp as wp

from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.point_triangle import FACE_SHARE, FACE_SLACK, FLAT, GREATEST_AREA, LEAST_AREA
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)

GROUP = 32
"""Points of an item: each begins with what was nearest to the one before it."""

TREES = {"bvh": (WideNodes, "BoxTree"), "kdtree": (KdNodes, "CellTree")}
"""Struct of each kind of tree, and of its walk in C++."""

GUARDS = f"""
    static_assert(wrt::FLAT == {float(FLAT)!r}f && wrt::TREE_DEPTH == {MAX_WIDE_DEPTH} && wrt::TREE_DEPTH == {MAX_TREE_DEPTH});
    static_assert(wrt::FACE_SHARE == {float(FACE_SHARE)!r}f && wrt::FACE_SLACK == {float(FACE_SLACK)!r}f);
    static_assert(wrt::LEAST_AREA == {float(LEAST_AREA)!r}f && wrt::GREATEST_AREA == {float(GREATEST_AREA)!r}f);
"""
"""C++: constants that kernels/native has too."""


class PointConfig(NamedTuple):
    """A specialisation.

    Attributes:
        tree: key of `TREES`.
        width: lanes of a block, and of a wide node.
        group: points of an item.
    """

    tree: str
    width: int
    group: int = GROUP


@cache
def make_points_kernel(config: PointConfig) -> wp.Kernel:
    """The kernel for one specialisation. Item: a group of points."""
    Tree, walk = TREES[config.tree]
    form, group = f"wrt::{walk}, {config.width}, {config.group}", config.group

    @native.func_native("points.h", f"{GUARDS}wrt::nearest_of_group<{form}>(tree, triangles, points, found, begin);")
    def search_group(tree: Tree, triangles: TriangleBlocks, points: PointBatch, found: NearestBatch, begin: int): ...

    def nearest_triangles(first: int, tree: Tree, triangles: TriangleBlocks, points: PointBatch, found: NearestBatch):
        search_group(tree, triangles, points, found, (first + wp.tid()) * wp.static(group))

    return specialised_kernel(nearest_triangles)
