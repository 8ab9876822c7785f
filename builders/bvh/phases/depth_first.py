"""Copies of binary trees in depth-first order: without gaps between pairs, however a build used its memory."""

from dataclasses import dataclass, replace

import warp as wp

from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, empty_tree
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

STACK = MAX_WIDE_DEPTH + 2


@wp.struct
class Links:
    """Additional data of a tree whose nodes may move."""

    parent: wp.array(dtype=int)
    """(pairs,) the parent of a pair; -1 for pair 0, the root's."""
    height: wp.array(dtype=int)
    """(nodes,) inner nodes on the longest path down from a node, itself included."""
    stamp: wp.array(dtype=int)
    """(nodes,) number of the last move during which the node was an ancestor of the moving one."""


@native.func_native("reference.h", "wrt::join_boxes(out.data + (size_t)o * 8, a.data + (size_t)i * 8, b.data + (size_t)j * 8);")
def join_boxes(out: wp.array(dtype=float), o: int, a: wp.array(dtype=float), i: int, b: wp.array(dtype=float), j: int):
    """Sets box o of `out` to the box around box i of `a` and box j of `b`."""


@exact_kernel
def lay_out(first: int, tree: BinaryTree, result: BinaryTree, links: Links, pairs: wp.array(dtype=int)):
    """One item. Copies the tree depth first: pairs without gaps, parents before children, and triangles in the leaves' order.

    pairs: (1,) number of pairs plus one.
    """
    old = wp.zeros(shape=(STACK,), dtype=int)
    new = wp.zeros(shape=(STACK,), dtype=int)
    links.parent[0] = -1
    waiting = int(1)
    next_pair = int(1)
    cursor = int(0)
    while waiting > 0:
        waiting -= 1
        node = load_int(old, waiting)
        to = load_int(new, waiting)
        pair = load_int(tree.pair, node)
        join_boxes(result.box, to, tree.box, node, tree.box, node)
        if pair == LEAF:
            held = tree.range[node]
            result.pair[to] = LEAF
            result.range[to] = wp.vec2i(cursor, held[1])
            links.height[to] = 0
            for i in range(held[1]):
                result.order[cursor + i] = tree.order[held[0] + i]
            cursor += held[1]
        else:
            result.pair[to] = next_pair
            links.parent[next_pair] = to
            for side in range(2):
                store_int(old, waiting + side, 2 * pair + 1 - side)
                store_int(new, waiting + side, 2 * next_pair + 1 - side)
            waiting += 2
            next_pair += 1
    for i in range(1, next_pair):
        pair = next_pair - i
        node = links.parent[pair]
        left = result.range[2 * pair]
        result.range[node] = wp.vec2i(left[0], left[1] + result.range[2 * pair + 1][1])
        links.height[node] = 1 + wp.max(links.height[2 * pair], links.height[2 * pair + 1])
    pairs[0] = next_pair


@dataclass
class DepthFirstTree:
    """A copy of a binary tree, without gaps and with links to parents.

    Attributes:
        binary: the tree.
        links: its additional data.
        end: number of its pairs plus one.
    """

    binary: BinaryBuild
    links: Links
    end: int

    @classmethod
    def of(cls, binary: BinaryBuild, triangles: int) -> "DepthFirstTree":
        """A copy of the tree in depth-first order."""
        device = binary.space.device
        links, tree, pairs = Links(), empty_tree(triangles, device), wp.empty(1, dtype=int, device=device)
        links.parent = wp.empty(triangles, dtype=int, device=device)
        links.height = wp.empty(2 * triangles, dtype=int, device=device)
        links.stamp = wp.empty(2 * triangles, dtype=int, device=device)
        launch(lay_out, 1, [binary.tree, tree, links, pairs], device=device)
        end = int(pairs.numpy()[0])
        subtrees = wp.array([(1, end)], dtype=wp.vec2i, device=device)
        return cls(replace(binary, tree=tree, subtrees=subtrees, top=None), links, end)
