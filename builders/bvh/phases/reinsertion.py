"""Reinsertion: subtrees of a finished binary tree are taken out and put back where they cost least.

**Problem.** A build from the root down never sees what its first splits do to the nodes far below; once two neighbours are on
different sides of a plane they stay apart.

**Algorithm.** To take a node x out, its sibling takes the place of their parent; to put it back beside a node y, a new parent
of both takes the place of y. By the surface area heuristic the sum of the areas of all inner nodes falls by

    gain = A(parent of x) + sum of A(a) - A(a without x)  -  sum of A(b with x) - A(b)  -  A(y with x)

where a and b are the nodes above the old and the new place, below the first that is above both. A round (Meister and Bittner
2018) is two steps:

    search   every node looks for the place with the greatest gain: level by level upwards, at each down into the sibling's
             subtree, but not where even a place that grows nothing but by A(x) would gain less than the best one so far
    move     nodes move, those with the greatest gain first

**What we changed.** The paper lets moves that touch the same nodes lock each other out. Here nodes move one after the other,
which takes a small part of the time of the search, and each works out its gain again in the tree as it is by then: what no
longer gains stays where it is. So the sum falls with every move, the tree never becomes too deep, and it is the same for any
number of threads. Leaves of the binary tree move as a whole, so they hold up to half a block of triangles here: with up to a
whole block, next to nothing was gained. Finer leaves fill fewer blocks, which the heuristic does not see; so unless the tree of
wide nodes becomes a good deal cheaper, the builder's tree is kept, with the leaves that it has without reinsertion.

**Complexity.** O(N) moves a round; a search meets the whole tree in the worst case and some dozen nodes as a rule.

**Measured** (one thread of a Zen 5, 16 children a node, three rounds beside none). The atrium, where few large triangles lie
across many small ones, costs 9 % less by the surface area heuristic; shadow rays take 0.88 of the time, near views 0.91, random
and ambient rays 0.94. Scanned meshes have nothing to gain: the cost of bunny and dragon changes by less than 2 %, and rays took
1.02 to 1.16 of the time with finer leaves. Whether moves are kept or not, the build takes three to four times as long.

References:
    J. Bittner, M. Hapala, V. Havran: Fast insertion-based optimization of bounding volume hierarchies.
        Computer Graphics Forum 32(1), 2013.
    D. Meister, J. Bittner: Parallel reinsertion for bounding volume hierarchy optimization.
        Computer Graphics Forum 37(2), 2018.
"""

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules, BvhConfig
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, empty_tree, half_area
from wrt.builders.bvh.phases.collapse import MAX_WIDTH, BinaryBuild, solve_costs
from wrt.builders.tree import BuildStats
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.unchecked import load_float, load_int, store_float, store_int
from wrt.kernels.runtime.launch import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

STACK = MAX_WIDE_DEPTH + 2

SEARCHES = 64
"""Searches that are worth a launch."""

WORTH = 0.95
"""What a tree of finer leaves may cost at most, as a share of the cost of the tree without moves."""


@wp.struct
class Links:
    """What a tree that is changed needs beside its nodes."""

    parent: wp.array(dtype=int)
    """(pairs,) the node whose children a pair is; -1 of pair 0, the root's."""
    height: wp.array(dtype=int)
    """(nodes,) inner nodes on the longest path down from a node, itself included."""
    stamp: wp.array(dtype=int)
    """(nodes,) number of the last move for which a node was found to be above the one that moves."""


@wp.struct
class Places:
    """What the searches of a round find."""

    place: wp.array(dtype=int)
    """(nodes,) the node beside which a node is best put."""
    gain: wp.array(dtype=float)
    """(nodes,) what that gains; 0: nothing does."""


@wp.func_native("""
    const float *p = a.data + (size_t)i * 8, *q = b.data + (size_t)j * 8;
    float size[3];
    for (int k = 0; k < 3; ++k) {
        const float low = p[k] < q[k] ? p[k] : q[k], high = p[4 + k] < q[4 + k] ? p[4 + k] : q[4 + k];
        size[k] = -(low + high);
    }
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0];
""")
def joined_area(a: wp.array(dtype=float), i: int, b: wp.array(dtype=float), j: int) -> float:
    """Half the surface area of the box around box i of `a` and box j of `b`, both as in `BinaryTree.box`."""
    ...


@wp.func_native("""
    float* to = out.data + (size_t)o * 8;
    const float *p = a.data + (size_t)i * 8, *q = b.data + (size_t)j * 8;
    for (int k = 0; k < 8; ++k) to[k] = p[k] < q[k] ? p[k] : q[k];
""")
def join_boxes(out: wp.array(dtype=float), o: int, a: wp.array(dtype=float), i: int, b: wp.array(dtype=float), j: int):
    """Box o of `out` becomes the box around box i of `a` and box j of `b`."""
    ...


@wp.kernel
def find_places(first: int, tree: BinaryTree, links: Links, places: Places):
    """Item: a node but the first, which is the root; the second is nobody's."""
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
    """What it gains to put a node beside another one; 0 if that cannot be. left_over: (8,) a box to work with."""
    at = int(node)
    while at >= 0:
        store_int(links.stamp, at, move)
        at = load_int(links.parent, at >> 1)
    if load_int(links.stamp, place) == move or place == (node ^ 1):
        return 0.0
    # what grows on the way up from the new place
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
    # what shrinks on the way up from the old one
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
    """A node takes the place of another one; its own is free."""
    pair = load_int(tree.pair, source)
    join_boxes(tree.box, to, tree.box, source, tree.box, source)
    tree.range[to] = tree.range[source]
    store_int(tree.pair, to, pair)
    store_int(links.height, to, load_int(links.height, source))
    if pair != LEAF:
        store_int(links.parent, pair, to)


@wp.func
def refit_upwards(tree: BinaryTree, links: Links, bottom: int):
    """Boxes and heights of a node, which is no leaf, and of all above it; -1: of none."""
    at = int(bottom)
    while at >= 0:
        pair = load_int(tree.pair, at)
        join_boxes(tree.box, at, tree.box, 2 * pair, tree.box, 2 * pair + 1)
        store_int(links.height, at, 1 + wp.max(load_int(links.height, 2 * pair), load_int(links.height, 2 * pair + 1)))
        at = load_int(links.parent, at >> 1)


@wp.kernel
def move_nodes(
    first: int, tree: BinaryTree, links: Links, places: Places, order: wp.array(dtype=int), moved: wp.array(dtype=int)
):
    """One item. order: the nodes that gain by a move, in the order in which they try. moved: (1,) how many did."""
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


@wp.kernel
def lay_out(first: int, tree: BinaryTree, result: BinaryTree, links: Links, pairs: wp.array(dtype=int)):
    """One item. The same tree, depth first: pairs without gaps, parents before children, and triangles in the leaves' order.

    pairs: (1,) one more than there are.
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


@wp.kernel
def join_leaves(first: int, tree: BinaryTree, subtrees: wp.array(dtype=wp.vec2i), most: int):
    """Item: a subtree. Its nodes of at most so many triangles become leaves."""
    pairs = subtrees[first + wp.tid()]
    for node in range(2 * pairs[0], 2 * pairs[1]):
        if tree.range[node][1] <= most:
            tree.pair[node] = LEAF


@dataclass
class Reinsertion:
    """A tree whose nodes move.

    Attributes:
        binary: the tree, in memory of its own.
        links: what goes with it.
        end: one more than the number of its pairs.
    """

    binary: BinaryBuild
    links: Links
    end: int

    @classmethod
    def of(cls, binary: BinaryBuild, triangles: int) -> "Reinsertion":
        """The same tree, depth first."""
        device = binary.space.device
        links, tree, pairs = Links(), empty_tree(triangles, device), wp.empty(1, dtype=int, device=device)
        links.parent = wp.empty(triangles, dtype=int, device=device)
        links.height = wp.empty(2 * triangles, dtype=int, device=device)
        links.stamp = wp.empty(2 * triangles, dtype=int, device=device)
        launch(lay_out, 1, [binary.tree, tree, links, pairs], device=device)
        end = int(pairs.numpy()[0])
        subtrees = wp.array([(1, end)], dtype=wp.vec2i, device=device)
        return cls(replace(binary, tree=tree, subtrees=subtrees, top=None), links, end)

    def search(self) -> Places:
        """The best place of every node."""
        device, places = self.binary.space.device, Places()
        places.place = wp.empty(2 * self.end, dtype=int, device=device)
        places.gain = wp.zeros(2 * self.end, dtype=float, device=device)
        launch(find_places, 2 * self.end - 2, [self.binary.tree, self.links, places], device=device, chunk=SEARCHES)
        return places

    def move(self, places: Places) -> int:
        """Moves nodes; how many."""
        device, gain = self.binary.space.device, places.gain.numpy()
        order = np.argsort(-gain, kind="stable")[: np.count_nonzero(gain)].astype(np.int32)
        moved = wp.zeros(1, dtype=int, device=device)
        self.links.stamp[: 2 * self.end].zero_()
        inputs = [self.binary.tree, self.links, places, wp.array(order, dtype=int, device=device), moved]
        launch(move_nodes, 1, inputs, device=device)
        return int(moved.numpy()[0])

    def arrays(self, places: Places) -> list[wp.array]:
        """The memory that is held during a round."""
        return [*self.binary.arrays(), self.links.parent, self.links.height, self.links.stamp, places.place, places.gain]


def wide_cost(binary: BinaryBuild, rules: BuildRules) -> float:
    """The least cost of a tree of wide nodes, times the root's area."""
    solve_costs(binary, rules)
    pair = int(binary.tree.pair[:1].numpy()[0])
    return float(binary.space[pair * MAX_WIDTH : pair * MAX_WIDTH + 1].numpy()[0])


def reinsert(binary: BinaryBuild, triangles: int, config: BvhConfig, stats: BuildStats) -> BinaryBuild:
    """A cheaper tree, or if it is not worth it, the same with the leaves of a build without reinsertion.

    Args:
        binary: of a builder whose heuristic is the surface area; to be overwritten.
        triangles: their number.
        config: how it was built.
        stats: where memory is noted.
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
    inputs = [binary.tree, binary.subtrees, replace(config, reinsertion=0).struct().grain]
    launch(join_leaves, len(binary.subtrees), inputs, device=binary.space.device, chunk=1)
    return moved if wide_cost(moved, rules) < WORTH * wide_cost(binary, rules) else binary
