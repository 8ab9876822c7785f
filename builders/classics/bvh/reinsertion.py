"""Reinsertion (Bittner, Hapala and Havran 2013; Meister and Bittner 2018): moves subtrees to where they cost least.

**Problem.** A top-down build cannot foresee the effect of its first splits on the nodes far below. Neighbours that a plane has
separated stay apart.

**Idea.** To remove a node x, its sibling replaces their parent. To insert it beside a node y, a new parent of both
replaces y. By the surface area heuristic the sum of the areas of all inner nodes then falls by

    gain = A(parent of x) + sum of A(a) - A(a without x)  -  sum of A(b with x) - A(b)  -  A(y with x)

where a and b are the ancestors of the old and the new position, below the lowest common one.

**Steps** of a round (Meister and Bittner 2018):

1. `find_insertion_positions`: every node looks for the position with the greatest gain: it walks up level by level, and at each
   level down into the sibling's subtree, except where even a position whose only cost is A(x) would gain less than the best so
   far.
2. `move_nodes`: nodes move in the order of decreasing gain.

**What we changed.** In the paper, moves that touch the same nodes lock each other out. Here nodes move one after the other,
which takes a small part of the time of the search. Each recomputes its gain in the current tree, and stays if there is no gain
left. So the sum falls with every move, the tree never becomes too deep, and it is the same for any number of threads. Leaves of
the binary tree move as a whole, so they hold at most half a block of triangles; with a whole block almost nothing is gained.
Finer leaves fill fewer blocks, which the heuristic does not see. So the builder's tree, with its original leaves, is kept
unless the tree of wide nodes becomes clearly cheaper (`MAX_RELATIVE_COST`).

**Complexity.** O(N) moves per round. A search visits the whole tree in the worst case and usually a few dozen nodes.

**Limits.** The surface area heuristic gains in scenes with few large triangles across many small ones, not in scanned meshes.
Since the binned build divides by size, rays rarely do (notebooks/records/2026-11-24-large-triangles.md). The build takes
several times as long whether or not moves are kept.

References: bittner-2013; meister-bittner-2018.
"""

from dataclasses import replace

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, half_area
from wrt.builders.bvh.phases.collapse import wide_cost
from wrt.builders.bvh.phases.depth_first import STACK, DepthFirstTree, Links, join_boxes
from wrt.builders.bvh.phases.large_boxes import is_small
from wrt.builders.tree import BuildStats
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.unchecked import load_float, load_int, store_float, store_int
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

SEARCHES = 64
"""Least number of searches in a launch."""

MAX_RELATIVE_COST = 0.95
"""Relative cost up to which the tree with moves and finer leaves replaces the original: a margin for its emptier blocks
(notebooks/records/2026-11-21-bvh-builders.md)."""


@wp.struct
class InsertionPositions:
    """Results of the searches of a round."""

    place: wp.array(dtype=int)
    """(nodes,) the best sibling for each node."""
    gain: wp.array(dtype=float)
    """(nodes,) its gain; 0 if no position gains."""


@native.func_native("reference.h", "return wrt::sides_of_both(a.data + (size_t)i * 8, b.data + (size_t)j * 8).half_area();")
def joined_area(a: wp.array(dtype=float), i: int, b: wp.array(dtype=float), j: int) -> float:
    """Half the surface area of the box around box i of `a` and box j of `b`, both as in `BinaryTree.box`."""


@exact_kernel
def find_insertion_positions(first: int, tree: BinaryTree, links: Links, places: InsertionPositions):
    """Item: a node other than the first, which is the root. The second node is unused."""
    node = first + wp.tid() + 2
    nodes = wp.zeros(shape=(STACK,), dtype=int)
    gains = wp.zeros(shape=(STACK,), dtype=float)
    left_over = wp.zeros(shape=(8,), dtype=float)
    own_area = half_area(tree.box, node)
    best_gain = float(0.0)
    best = int(-1)
    sibling = node ^ 1
    above = load_int(links.parent, node >> 1)
    gain = half_area(tree.box, above)
    join_boxes(left_over, 0, tree.box, sibling, tree.box, sibling)
    while above >= 0:
        store_int(nodes, 0, sibling)
        store_float(gains, 0, gain)
        waiting = int(1)
        while waiting > 0:
            waiting -= 1
            at = load_int(nodes, waiting)
            before = load_float(gains, waiting)
            if before - own_area > best_gain:
                here = before - joined_area(tree.box, at, tree.box, node)
                if here > best_gain and at != (node ^ 1):
                    best_gain = here
                    best = at
                pair = load_int(tree.pair, at)
                if pair != LEAF:
                    below = here + half_area(tree.box, at)
                    for side in range(2):
                        store_int(nodes, waiting + side, 2 * pair + 1 - side)
                        store_float(gains, waiting + side, below)
                    waiting += 2
        if sibling != (node ^ 1):
            join_boxes(left_over, 0, left_over, 0, tree.box, sibling)
            gain += half_area(tree.box, above) - half_area(left_over, 0)
        sibling = above ^ 1
        above = load_int(links.parent, above >> 1)
    places.place[node] = best
    places.gain[node] = best_gain


@wp.func
def gain_of_move(tree: BinaryTree, links: Links, move: int, node: int, place: int, left_over: wp.array(dtype=float)):
    """Gain of moving a node beside another one; 0 if the move is impossible. left_over: (8,) scratch box."""
    at = int(node)
    while at >= 0:
        store_int(links.stamp, at, move)
        at = load_int(links.parent, at >> 1)
    if load_int(links.stamp, place) == move or place == (node ^ 1):
        return 0.0
    # ancestors of the new position, which grow
    gain = -joined_area(tree.box, place, tree.box, node)
    depth = int(0)
    at = load_int(links.parent, place >> 1)
    while load_int(links.stamp, at) != move:
        gain -= joined_area(tree.box, at, tree.box, node) - half_area(tree.box, at)
        at = load_int(links.parent, at >> 1)
        depth += 1
    if at == node:
        return 0.0
    common = int(at)
    while at >= 0:
        depth += 1
        at = load_int(links.parent, at >> 1)
    if depth + 1 + wp.max(load_int(links.height, node), load_int(links.height, place)) > MAX_WIDE_DEPTH:
        return 0.0
    # ancestors of the old position, which shrink
    at = load_int(links.parent, node >> 1)
    gain += half_area(tree.box, at)
    join_boxes(left_over, 0, tree.box, node ^ 1, tree.box, node ^ 1)
    while at != common:
        sibling = at ^ 1
        at = load_int(links.parent, at >> 1)
        if at != common:
            join_boxes(left_over, 0, left_over, 0, tree.box, sibling)
            gain += half_area(tree.box, at) - half_area(left_over, 0)
    return gain


@wp.func
def move_contents(tree: BinaryTree, links: Links, source: int, to: int):
    """Moves a node into the slot of another one and frees its own."""
    pair = load_int(tree.pair, source)
    join_boxes(tree.box, to, tree.box, source, tree.box, source)
    tree.range[to] = tree.range[source]
    store_int(tree.pair, to, pair)
    store_int(links.height, to, load_int(links.height, source))
    if pair != LEAF:
        store_int(links.parent, pair, to)


@wp.func
def refit_upwards(tree: BinaryTree, links: Links, bottom: int):
    """Recomputes boxes and heights of an inner node and of all its ancestors; -1: of none."""
    at = int(bottom)
    while at >= 0:
        pair = load_int(tree.pair, at)
        join_boxes(tree.box, at, tree.box, 2 * pair, tree.box, 2 * pair + 1)
        store_int(links.height, at, 1 + wp.max(load_int(links.height, 2 * pair), load_int(links.height, 2 * pair + 1)))
        at = load_int(links.parent, at >> 1)


@exact_kernel
def move_nodes(
    first: int,
    tree: BinaryTree,
    links: Links,
    places: InsertionPositions,
    order: wp.array(dtype=int),
    moved: wp.array(dtype=int),
):
    """One item. order: the nodes with a gain, in the order of their moves. moved: (1,) number of moves made."""
    left_over = wp.zeros(shape=(8,), dtype=float)
    for i in range(order.shape[0]):
        node = order[i]
        place = places.place[node]
        if gain_of_move(tree, links, i + 1, node, place, left_over) > 0.0:
            pair = node >> 1
            parent = load_int(links.parent, pair)
            move_contents(tree, links, node ^ 1, parent)
            move_contents(tree, links, place, node ^ 1)
            store_int(tree.pair, place, pair)
            store_int(links.parent, pair, place)
            refit_upwards(tree, links, load_int(links.parent, parent >> 1))
            refit_upwards(tree, links, place)
            moved[0] += 1


@exact_kernel
def join_leaves(first: int, rules: BuildRules, tree: BinaryTree, subtrees: wp.array(dtype=wp.vec2i)):
    """Item: a subtree. Turns nodes that are small by these rules into leaves."""
    pairs = subtrees[first + wp.tid()]
    for node in range(2 * pairs[0], 2 * pairs[1]):
        if is_small(rules, tree, node, tree.range[node][1]):
            tree.pair[node] = LEAF


class Reinsertion(DepthFirstTree):
    """A tree whose nodes move."""

    def search(self) -> InsertionPositions:
        """Finds the best position of every node."""
        device, places = self.binary.space.device, InsertionPositions()
        places.place = wp.empty(2 * self.end, dtype=int, device=device)
        places.gain = wp.zeros(2 * self.end, dtype=float, device=device)
        launch(
            find_insertion_positions, 2 * self.end - 2, [self.binary.tree, self.links, places], device=device, chunk=SEARCHES
        )
        return places

    def move(self, places: InsertionPositions) -> int:
        """Moves nodes; returns the number of moves."""
        device, gain = self.binary.space.device, places.gain.numpy()
        order = np.argsort(-gain, kind="stable")[: np.count_nonzero(gain)].astype(np.int32)
        moved = wp.zeros(1, dtype=int, device=device)
        self.links.stamp[: 2 * self.end].zero_()
        inputs = [self.binary.tree, self.links, places, wp.array(order, dtype=int, device=device), moved]
        launch(move_nodes, 1, inputs, device=device)
        return int(moved.numpy()[0])

    def arrays(self, places: InsertionPositions) -> list[wp.array]:
        """The arrays that are held during a round."""
        return [*self.binary.arrays(), self.links.parent, self.links.height, self.links.stamp, places.place, places.gain]


def reinsert(binary: BinaryBuild, triangles: int, config: BvhConfig, stats: BuildStats) -> BinaryBuild:
    """A cheaper tree or, if the gain is too small, the same tree with the leaves of a build without reinsertion.

    Args:
        binary: result of a builder with the surface area heuristic; overwritten.
        triangles: their number.
        config: configuration of the build.
        stats: statistics in which memory is recorded.
    """
    work = Reinsertion.of(binary, triangles)
    if work.end == 1:
        return binary
    for _ in range(config.reinsertion):
        places = work.search()
        stats.reserve(*binary.arrays(), *work.arrays(places))
        if work.move(places) == 0:
            break
    rules, moved = config.struct(), Reinsertion.of(work.binary, triangles).binary
    inputs = [replace(config, reinsertion=0).struct(), binary.tree, binary.subtrees]
    launch(join_leaves, len(binary.subtrees), inputs, device=binary.space.device, chunk=1)
    return moved if wide_cost(moved, rules) < MAX_RELATIVE_COST * wide_cost(binary, rules) else binary
