"""Nodes with large boxes: how far they are divided, and what their leaves may hold.

**Problem.** A block of W lanes costs as much with one triangle as with W, so the surface area heuristic fills leaves: it adds
the steps of a stair to the two triangles of the ground. The heuristic has rays that start outside. But shadow rays, ambient
rays and reflections start on surfaces, most of them on large ones. A ray that leaves the ground is never in the ground's own
box, which is flat, and always in that of the joint leaf. Camera rays gain, too, since most hit large triangles.

**Rules.** A box is large if its surface area exceeds a share of the root's (`BvhConfig.large`).

1. A node with a large box is divided down to single triangles (`is_small`), so that the collapse can choose.
2. A leaf that is not flat has no large flat part (`holds_large_part`; the collapse asks).

Both concern a few dozen nodes; of scanned meshes, only the uppermost. The cost that the heuristic expects can increase.

**Limits.** A wall that is not parallel to an axis has no flat box.

References: fabianowski-2009.
"""

import warp as wp

from wrt.builders.bvh.bvh_config import MAX_WIDTH, BuildRules
from wrt.builders.bvh.phases.binary_tree import BOTH, LEAF, BinaryTree, half_area
from wrt.kernels.runtime import native

THIN = 2.0**-10
"""Ratio of the shortest and the longest side up to which a box is flat."""


@native.func_native("reference.h", f"return wrt::sides_of(boxes.data + (size_t)node * 8).is_flat({THIN}f);")
def is_flat(boxes: wp.array(dtype=float), node: int) -> bool:
    """Whether a node's box is flat."""


@native.func_native("reference.h", f"return {BOTH}.is_flat({THIN}f);")
def are_flat(boxes: wp.array(dtype=float), pair: int) -> bool:
    """Whether the box around both nodes of a pair is flat."""


@wp.func
def is_large_area(rules: BuildRules, tree: BinaryTree, area: float):
    """Whether a box with half this surface area is large."""
    return area > rules.large * half_area(tree.box, 0)


@wp.func
def is_small(rules: BuildRules, tree: BinaryTree, node: int, count: int):
    """Whether a node of the binary tree has so few triangles, for its size, that it is a leaf; the collapse merges leaves."""
    if count > rules.grain:
        return False
    return count == 1 or not is_large_area(rules, tree, half_area(tree.box, node))


@wp.func
def holds_large_part(rules: BuildRules, tree: BinaryTree, costs: wp.array(dtype=float), node: int):
    """Whether a node is or contains one that is large and flat. costs: of the collapse, see `combine` there."""
    pair = tree.pair[node]
    if pair == LEAF:
        return is_flat(tree.box, node) and is_large_area(rules, tree, half_area(tree.box, node))
    return costs[pair * MAX_WIDTH + MAX_WIDTH - 1] > 0.0
