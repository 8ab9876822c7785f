"""The kernels that search triangles near points in trees. The walks are in kernels/native/points.h."""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, WideNodes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH, KdNodes
from wrt.kernels.points.point_batch import NearestBatch, NearLists, PointBatch
from wrt.kernels.points.point_triangle import FACE_SHARE, FACE_SLACK, FLAT, MAX_AREA, MIN_AREA
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows
from wrt.kernels.traversal.two_level.instance_single import PARTS, InstanceTree
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS, TriangleBlocks

GROUP = 32
"""Points of an item: each begins with what was nearest to the one before it."""

TREES: dict[str, tuple[type, type, str]] = {
    "bvh": (WideNodes, TriangleBlocks, "BoxTree<{width}, {rows}>"),
    "kdtree": (KdNodes, TriangleBlocks, "CellTree<{width}, {rows}>"),
    "binary": (BinaryNodes, PackedTriangles, "PackedTree"),
}
"""Structs of each kind of tree and of its triangles, and its walk in C++. "binary": a BVH of width 2 as persistent threads walk
it."""

GUARDS = f"""
    static_assert(wrt::FLAT == {float(FLAT)!r}f && wrt::TREE_DEPTH == {MAX_WIDE_DEPTH} && wrt::TREE_DEPTH == {MAX_TREE_DEPTH});
    static_assert(wrt::FACE_SHARE == {float(FACE_SHARE)!r}f && wrt::FACE_SLACK == {float(FACE_SLACK)!r}f);
    static_assert(wrt::MIN_AREA == {float(MIN_AREA)!r}f && wrt::MAX_AREA == {float(MAX_AREA)!r}f);
"""
"""C++: constants that kernels/native has too."""

TASKS = {
    "nearest": "wrt::nearest_of_group<wrt::NearestTriangle, {group}>({space}, points, lists.found, work, begin);",
    "counted": "wrt::nearest_of_group<wrt::CountedNearest, {group}>({space}, points, lists.found, work, begin);",
    "some": "wrt::nearest_lists_of_group<{group}>({space}, points, lists.found, lists.room, begin);",
    "count": "wrt::count_within_group<{group}>({space}, points, lists, begin);",
    "list": "wrt::list_within_group<{group}>({space}, points, lists, begin);",
}
"""C++ of what is searched: the nearest triangle, the same with its work, the `room` nearest, or those within a distance: their
numbers, and themselves."""


class PointConfig(NamedTuple):
    """A specialisation.

    Attributes:
        tree: key of `TREES`.
        width: lanes of a block, and of a wide node.
        group: points of an item.
        task: key of `TASKS`.
        instances: whether the trees are those of instances.
    """

    tree: str
    width: int
    group: int = GROUP
    task: str = "nearest"
    instances: bool = False


@cache
def space_type(tree: str, instances: bool) -> type:
    """The struct of where points are searched; arguments as in `PointConfig`."""
    if instances:
        Part = BinaryPart if tree == "binary" else PARTS[tree]

        class PointInstances:
            top: InstanceTree
            parts: wp.array(dtype=Part)

        PointInstances.__qualname__ = f"PointInstances_{tree}"
        return wp.struct(PointInstances)
    Tree, Triangles, _ = TREES[tree]

    class PointTree:
        tree: Tree
        triangles: Triangles

    PointTree.__qualname__ = f"PointTree_{tree}"
    return wp.struct(PointTree)


def space_code(tree: str, width: int, instances: bool, rows: int = VERTEX_COMPONENTS) -> str:
    """C++ that makes it of a `scene` with such fields; rows: of a triangle record."""
    kind = "wrt::" + TREES[tree][-1].format(width=width, rows=rows)
    return (
        f"wrt::point_instances<{kind}, {max(width, 2)}>(scene.top, scene.parts)"
        if instances
        else f"wrt::point_tree<{kind}>(scene.tree, scene.triangles)"
    )


@cache
def make_points_kernel(config: PointConfig) -> wp.Kernel:
    """The kernel for one specialisation. Item: a group of points."""
    group, Space = config.group, space_type(config.tree, config.instances)
    space = space_code(config.tree, config.width, config.instances)

    code = TASKS[config.task].format(group=group, space=space)

    @native.func_native("point_groups.h", GUARDS + code)
    def search_group(scene: Space, points: PointBatch, lists: NearLists, work: CounterRows, begin: int): ...

    def nearest_triangles(first: int, scene: Space, points: PointBatch, lists: NearLists, work: CounterRows):
        search_group(scene, points, lists, work, (first + wp.tid()) * wp.static(group))

    return specialised_kernel(nearest_triangles)


def as_space(config: PointConfig, *parts: Any) -> Any:
    """Its first argument, of its two fields."""
    space = space_type(config.tree, config.instances)()
    for name, value in zip(space._cls.vars, parts, strict=True):
        setattr(space, name, value)
    return space


def as_lists(found: NearestBatch) -> NearLists:
    """Its third argument, for tasks that write one triangle for each point."""
    lists = NearLists()
    lists.found = found
    return lists
