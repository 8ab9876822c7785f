"""kd-trees joined by links (`wrt.kernels.traversal.two_level.linked_kdtrees`): groups below upper trees, or in lists.

**Algorithm.** The nodes and leaf lists of all trees are pooled in one array each. A hierarchy of groups is then linked from
below: the boxes of a group's members are the input of a kd-tree of its own, whose leaves become lists of links to the trees of
the members. Its planes are those of the members' boxes, so it takes little time whatever the number of triangles.

**Complexity.** O(M log M) for M groups, and a copy of all nodes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes, boxes_of
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH

LEAF = 3
"""Axis bits of a leaf (`wrt.kernels.layout.kdtree_nodes`)."""

Hierarchy = Any
"""The number of a tree; or a tuple of hierarchies, which are a group."""

Target = tuple[int, int, np.ndarray, np.ndarray]
"""A link: root, whether more follow in its list (1 or 0), lower and upper corner."""


@dataclass(frozen=True)
class Pool:
    """kd-trees side by side.

    Attributes:
        nodes: (N, 2) int32 words of all nodes; children and blocks are numbered through the pool.
        primitive: (blocks * width,) int32 triangle ids.
        roots: (trees,) the root of each.
    """

    nodes: np.ndarray
    primitive: np.ndarray
    roots: np.ndarray


def pool_kdtrees(trees: Sequence[KdTree], members: Sequence[np.ndarray]) -> Pool:
    """Trees side by side in the same arrays.

    Args:
        trees: trees with blocks of the same width.
        members: for each tree, the ids of its triangles 0, 1 and so on.
    """
    nodes, lists, roots, node_base, block_base = [], [], [], 0, 0
    for tree, own in zip(trees, members, strict=True):
        words, ids = tree.nodes.numpy().copy(), tree.primitive.numpy()
        leaf = (words[:, 1] & 3) == LEAF
        words[leaf, 0] += block_base
        words[~leaf, 1] += node_base << 2
        nodes.append(words)
        lists.append(np.where(ids >= 0, own[ids], -1).astype(np.int32))
        roots.append(node_base)
        node_base, block_base = node_base + len(words), block_base + len(ids) // tree.width
    return Pool(np.concatenate(nodes), np.concatenate(lists), np.array(roots))


@dataclass(frozen=True)
class LinkedKdTrees:
    """kd-trees joined by links, on the host.

    Attributes:
        nodes: (N, 2) int32 words of all nodes.
        links: (root, more, low, high) of each link.
        root, every, low, high: as in `wrt.kernels.traversal.two_level.linked_kdtrees.LinkedNodes`.
        primitive: (blocks * width,) int32 triangle ids, leaf after leaf, -1 in unused lanes.
        width: triangles of a block.
        room: most cells that wait on the stack of a walk.
    """

    nodes: np.ndarray
    links: list[Target]
    root: int
    every: int
    low: np.ndarray
    high: np.ndarray
    primitive: np.ndarray
    width: int
    room: int


class _Links:
    """The upper trees of a hierarchy, while they are made."""

    def __init__(self, pool: Pool, trees: Sequence[KdTree], build: Callable[[TriangleBoxes], KdTree] | None) -> None:
        self.nodes, self.size, self.rows = [pool.nodes], len(pool.nodes), []
        self.known = [
            (int(root), np.array(tree.low), np.array(tree.high)) for root, tree in zip(pool.roots, trees, strict=True)
        ]
        self.build = build

    def list(self, targets: Sequence[tuple[int, np.ndarray, np.ndarray]]) -> int:
        """Adds a list of links to roots with their boxes; the number of the first."""
        first = len(self.rows)
        last = len(targets) - 1
        self.rows += [(root, int(place < last), low, high) for place, (root, low, high) in enumerate(targets)]
        return first

    def add(self, part: Hierarchy) -> tuple[int, np.ndarray, np.ndarray, int]:
        """Links a hierarchy: its node as in `LinkedNodes`, its box, and the room that its walk needs on the stack."""
        if not isinstance(part, tuple):
            return *self.known[part], MAX_TREE_DEPTH
        if len(part) == 1:  # a group of one is its member
            return self.add(part[0])
        below = [self.add(member) for member in part]
        low, high = np.min([one[1] for one in below], axis=0), np.max([one[2] for one in below], axis=0)
        targets, room = [one[:3] for one in below], max(one[3] for one in below)
        if self.build is None:
            return -1 - self.list(targets), low, high, room + 1
        top = self.build(boxes_of(np.array([one[1] for one in below]), np.array([one[2] for one in below])))
        words, ids = top.nodes.numpy().copy(), top.primitive.numpy()
        leaf = (words[:, 1] & 3) == LEAF
        words[~leaf, 1] += self.size << 2
        for node in np.flatnonzero(leaf & (words[:, 1] >> 2 > 0)):
            block, count = int(words[node, 0]), int(words[node, 1]) >> 2
            words[node] = self.list([targets[own] for own in ids[block : block + count]]), (-count << 2) | LEAF
        root = self.size
        self.nodes.append(words)
        self.size += len(words)
        return root, low, high, room + int(unpack(top).depth.max()) + 1


def link_kdtrees(
    trees: Sequence[KdTree],
    members: Sequence[np.ndarray],
    hierarchy: Hierarchy,
    build: Callable[[TriangleBoxes], KdTree] | None,
) -> LinkedKdTrees:
    """Joins kd-trees by a hierarchy.

    Args:
        trees: the trees with triangles.
        members: for each tree, the ids of its triangles 0, 1 and so on.
        hierarchy: the number of a tree, or a tuple of hierarchies.
        build: makes a tree over the boxes of a group's members, with blocks of one; None for lists, which are visited whole.
    """
    pool = pool_kdtrees(trees, members)
    links = _Links(pool, trees, build)
    root, low, high, room = links.add(hierarchy)
    every = links.list(links.known)
    return LinkedKdTrees(
        np.concatenate(links.nodes), links.rows, root, every, low, high, pool.primitive, trees[0].width, room + 1
    )
