"""The trees of groups, and how they are joined: into one BVH, or by links between kd-trees."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh, KdTree
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.placement import check_index, hierarchy_of
from wrt.scene.updates import MovedTriangles, TreeRecipe
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.builders.convert.kdtree_links import Hierarchy, LinkedKdTrees
    from wrt.engine.facts.scene_settings import Settings
    from wrt.meshes.placement import PlacedMeshes

TREE, LIST = "tree", "list"
TOPS = {
    TREE: "a tree over the boxes of groups, at each level of the hierarchy",
    LIST: "a list: every ray visits every group whose box it meets",
}
"""What lies above the trees of groups, by name."""

VISIT_COST = 16.0
"""Cost of visiting a group over that of an inner node, for the planes of upper kd-trees."""


@dataclass(frozen=True)
class GroupLayout:
    """How the groups of a scene are arranged.

    Attributes:
        hierarchy: the number of a group, or a tuple of hierarchies.
        recipes: how the tree of each group is made.
        top: key in `TOPS`.
    """

    hierarchy: Hierarchy
    recipes: tuple[TreeRecipe, ...]
    top: str

    @classmethod
    def of(cls, geometry: Any, count: int, settings: Settings, accelerators: Mapping[int, Any], top: str) -> GroupLayout:
        """The layout that a caller wants; count: number of meshes in `geometry`.

        Raises:
            TypeError, ValueError: as `wrt.moving.GroupedScene`.
        """
        lookup(TOPS, top, "top")
        chosen = [settings.accelerator] * count
        for index, accelerator in accelerators.items():
            chosen[check_index(index, count, "mesh")] = accelerator
        for accelerator in chosen:
            if not isinstance(accelerator, (Bvh, KdTree)):
                raise TypeError(f"accelerator must be a wrt.Bvh or a wrt.KdTree, not {accelerator!r}: groups are joined")
            if isinstance(accelerator, KdTree) and accelerator.is_lazy:
                raise ValueError(
                    f"builder {accelerator.builder!r} cannot build the trees of groups; choose one that is not lazy"
                )
        width = native_width(settings.device)
        forms = {f"{one.kind} of width {one.width or width}": None for one in chosen}
        if len(forms) > 1:
            raise ValueError(f"accelerators must be trees of one kind and width, not {' and '.join(forms)}")
        if top == LIST and chosen[0].kind != "kdtree":
            raise ValueError("top='list' needs groups with kd-trees; pass accelerator='kdtree', or leave top out")
        return cls(hierarchy_of(geometry), tuple(TreeRecipe(one, width, settings.device) for one in chosen), top)

    @property
    def is_linked(self) -> bool:
        """Whether the groups have kd-trees, joined by links."""
        return isinstance(self.recipes[0].accelerator, KdTree)

    def join(self, trees: Sequence[Any], placed: PlacedMeshes, device: wp.Device) -> common.Bvh | LinkedTrees:
        """The trees of all groups as one. trees: each numbers triangles from the first of its group."""
        members = [np.arange(a, b) for a, b in pairwise(placed.first)]
        if self.is_linked:
            return self._link(trees, members, device)
        tree = join_bvhs(trees, members, self.hierarchy, device)
        if tree.depth > MAX_WIDE_DEPTH:
            tree = self.recipes[0].build(MovedTriangles.of(placed, np.zeros(3)))  # type: ignore[assignment]
        return tree

    def _link(self, trees: Sequence[common.KdTree], members: Sequence[np.ndarray], device: wp.Device) -> LinkedTrees:
        from wrt.builders.convert.kdtree_links import link_kdtrees

        upper = KdTree(width=1, block_cost=VISIT_COST)
        build = None if self.top == LIST else partial(upper.build, width=1)
        return LinkedTrees.on(device, link_kdtrees(trees, members, self.hierarchy, build))


@dataclass(frozen=True)
class LinkedTrees:
    """kd-trees joined by links, on a device, with the interface that a scene needs of its tree.

    Attributes:
        nodes, links: arrays of `wrt.kernels.traversal.two_level.linked_kdtrees.LinkedNodes`.
        primitive: (blocks * width,) int32 triangle ids, leaf after leaf, -1 in unused lanes.
        low, high: the box of all triangles.
        width: triangles of a block.
        depth: most cells that wait on the stack of a walk.
        ends: the root, and the first link of the list of all trees.
    """

    nodes: wp.array
    links: wp.array
    primitive: wp.array
    low: wp.vec3
    high: wp.vec3
    width: int
    depth: int
    ends: tuple[int, int]

    @classmethod
    def on(cls, device: wp.Device, made: LinkedKdTrees) -> LinkedTrees:
        """Copies trees to a device."""
        from wrt.kernels.traversal.two_level.linked_kdtrees import Link

        return cls(  # type: ignore[call-arg]
            wp.array(made.nodes, dtype=wp.vec2i, device=device),
            wp.array(np.array(made.links, dtype=Link.numpy_dtype()), dtype=Link, device=device),  # type: ignore[arg-type, attr-defined]
            wp.array(made.primitive, dtype=int, device=device),
            *(wp.vec3(*map(float, corner)) for corner in (made.low, made.high)),
            made.width,
            made.room,
            (made.root, made.every),
        )

    @property
    def bytes(self) -> int:
        """Bytes of nodes, links and leaf lists."""
        return self.nodes.capacity + self.links.capacity + self.primitive.capacity

    @property
    def kernel_factory(self) -> Callable[[Any], wp.Kernel]:
        """Makes the kernel that walks the trees, from a `TraversalConfig`."""
        from wrt.kernels.traversal.two_level.linked_kdtrees import make_linked_kernel

        return make_linked_kernel

    def struct(self) -> Any:
        """The trees as a traversal kernel reads them."""
        from wrt.kernels.traversal.two_level.linked_kdtrees import LinkedNodes

        tree = LinkedNodes()
        tree.nodes, tree.links, tree.low, tree.high = self.nodes, self.links, self.low, self.high
        tree.root, tree.every = self.ends
        return tree


def join_bvhs(
    trees: Sequence[common.Bvh], members: Sequence[np.ndarray], hierarchy: Hierarchy, device: wp.Device
) -> common.Bvh:
    """Joins the BVHs of groups into one, of any depth, level by level of the hierarchy.

    Args:
        trees: on the device.
        members: for each tree, the ids of its triangles 0, 1 and so on.
        hierarchy: the number of a tree, or a tuple of hierarchies.
        device: device of the result.
    """
    from wrt.builders.bvh.update.bvh_grafting import merge_below, with_triangle_ids
    from wrt.builders.triangle_boxes import boxes_of

    if not isinstance(hierarchy, tuple):
        return with_triangle_ids(trees[hierarchy], members[hierarchy])
    below = [join_bvhs(trees, members, part, device) if isinstance(part, tuple) else trees[part] for part in hierarchy]
    every = np.arange(sum(map(len, members)))  # the triangles of nested groups have their ids already
    ids = [every if isinstance(part, tuple) else members[part] for part in hierarchy]
    width = below[0].width
    boxes = boxes_of(np.array([tree.low for tree in below]), np.array([tree.high for tree in below]))
    top = Bvh(width=width, max_leaf_triangles=1).build(boxes, width).to(device)
    return merge_below(top, below, ids)
