"""Optimal collapse of a binary tree to nodes of W children, in the layout of `wrt.kernels.layout.bvh_nodes`.

**Problem.** The children of a wide node can be any W descendants of a binary node that cover it, and any small subtree can be
one leaf. Opening the largest child repeatedly until there are W leaves many nodes nearly empty.

**Algorithm.** Dynamic programming from the leaves up (Ylitie, Karras and Laine 2017, section 3.1; with blocks instead of
triangles). A binary node n has the weight A(n): its surface area, or another weight by a `Heuristic`. F(n, j) is the least cost
of its triangles if they may take up to j lanes:

    leaf(n) = A(n) C_b blocks(n)                               if n may be a leaf: by its number of triangles, and `large_boxes`
    D(n, j) = min over k of F(left, k) + F(right, j - k)       both children share the lanes
    F(n, 1) = min(leaf(n), A(n) C_t + D(n, W))                 a lane: a leaf, or a wide node
    F(n, j) = min(F(n, 1), D(n, j))

Wide nodes are then made from the root down, level by level, in parallel:

    pick    every node picks its children by following the minima, and counts its inner children and the blocks of its leaves
    scan    a prefix sum of the counts gives each node the start of its children and blocks
    list    the next level's nodes are listed

When all levels are known, one launch writes boxes, child words and leaf blocks.

**Complexity.** O(W^2) per binary node, in W vector steps.

References: wald-2008; ylitie-2017.
"""

from functools import cache

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import MAX_WIDTH, BuildRules, BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import Heuristic
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, half_area_of_both
from wrt.builders.bvh.phases.large_boxes import are_flat, holds_large_part, is_flat, is_large_area
from wrt.builders.core.late_import import classic
from wrt.builders.cost import leaf_cost
from wrt.builders.tree import BuildStats, Bvh, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, check_blocks, leaf_child
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.runtime.workspace import read_ints, write
from wrt.kernels.simd.boxes import INFINITY

NO_NODE = wp.constant(0x7FFFFFFF)
"""Binary node of an unused lane."""


@wp.struct
class WideLevels:
    """The wide nodes found so far, in breadth-first order."""

    source: wp.array(dtype=int)
    """(nodes,) the binary node that each wide node represents."""
    pick: wp.array2d(dtype=int)
    """(nodes, W) the binary nodes of its children; ~node if the child is a leaf; NO_NODE for an unused lane."""
    first: wp.array(dtype=wp.vec2i)
    """(nodes,) its first inner child and its first block; before the scan, the numbers of both."""


@native.func_native(
    "bins.h",
    f"constexpr int W = {MAX_WIDTH};\n"
    "const float *a = pairs[0] ? costs.data + (size_t)pairs[0] * W : nullptr;\n"
    "const float *b = pairs[1] ? costs.data + (size_t)pairs[1] * W : nullptr;\n"
    "wrt::combine<W>(costs.data + (size_t)pair * W, width, a, leaves[0], b, leaves[1], inner, leaf, holds_large);",
)
def combine(
    costs: wp.array(dtype=float),
    pair: int,
    width: int,
    pairs: wp.vec2i,
    leaves: wp.vec2,
    inner: float,
    leaf: float,
    holds_large: bool,
):
    """Computes F(n, 1 .. W - 1) of the parent of a pair from those of the pair's nodes.

    pairs: indices of their costs; LEAF for leaves. leaves: what they cost as leaves. inner: A(n) C_t. holds_large: what
    `holds_large_part` is to say of the parent; it takes the place of F(n, W), which is never needed."""


@cache
def make_costs(heuristic: Heuristic) -> tuple[wp.Function, wp.Function]:
    """Two functions: the cost of a binary node as a leaf, and its least cost in a number of lanes."""
    rays_type, weigh = heuristic.rays, heuristic.weigh

    @wp.func
    def cost_as_leaf(rules: BuildRules, rays: rays_type, tree: BinaryTree, costs: wp.array(dtype=float), node: int):
        """leaf(n); INFINITY if it may not be a leaf."""
        count = tree.range[node][1]
        if count > rules.max_leaf:
            return float(INFINITY)
        if tree.pair[node] != LEAF and holds_large_part(rules, tree, costs, node) and not is_flat(tree.box, node):
            return float(INFINITY)
        return weigh(rays, tree, node) * leaf_cost(rules.cost, count)

    @wp.func
    def min_cost(rules: BuildRules, rays: rays_type, tree: BinaryTree, costs: wp.array(dtype=float), node: int, lanes: int):
        """F(n, lanes)."""
        pair = tree.pair[node]
        if pair == LEAF:
            return cost_as_leaf(rules, rays, tree, costs, node)
        return costs[pair * MAX_WIDTH + lanes - 1]

    return cost_as_leaf, min_cost


def make_solve(heuristic: Heuristic) -> wp.Kernel:
    """The kernel that computes F for subtrees, and then for the pairs above them."""
    rays_type, weigh_parent = heuristic.rays, heuristic.weigh_parent
    cost_as_leaf, _ = make_costs(heuristic)

    @wp.func
    def solve_pair(rules: BuildRules, rays: rays_type, tree: BinaryTree, costs: wp.array(dtype=float), pair: int):
        """Computes F of the node to which a pair belongs."""
        left = 2 * pair
        right = left + 1
        count = tree.range[left][1] + tree.range[right][1]
        area = weigh_parent(rays, tree, pair)
        flat = are_flat(tree.box, pair)
        holds_large = holds_large_part(rules, tree, costs, left) or holds_large_part(rules, tree, costs, right)
        holds_large = holds_large or (flat and is_large_area(rules, tree, half_area_of_both(tree.box, pair)))
        may_be_leaf = count <= rules.max_leaf and (flat or not holds_large)
        leaf = wp.where(may_be_leaf, area * leaf_cost(rules.cost, count), INFINITY)
        combine(
            costs,
            pair,
            1 << rules.cost.width_bits,
            wp.vec2i(tree.pair[left], tree.pair[right]),
            wp.vec2(cost_as_leaf(rules, rays, tree, costs, left), cost_as_leaf(rules, rays, tree, costs, right)),
            area * rules.cost.traversal,
            leaf,
            holds_large,
        )

    def solve(
        first: int,
        rules: BuildRules,
        rays: rays_type,
        tree: BinaryTree,
        ranges: wp.array(dtype=wp.vec2i),
        listed: wp.array(dtype=int),
        costs: wp.array(dtype=float),
    ):
        """Item: a range of pairs, parents before children; indices into the list `listed` if that is not empty."""
        pairs = ranges[first + wp.tid()]
        for i in range(pairs[1] - pairs[0]):
            pair = pairs[1] - 1 - i
            if listed.shape[0] > 0:
                pair = listed[pair]
            solve_pair(rules, rays, tree, costs, pair)

    return specialised_kernel(solve, beside=heuristic.rays.__name__)


def make_pick_children(heuristic: Heuristic) -> wp.Kernel:
    """The kernel that picks the children of the nodes of a level."""
    rays_type = heuristic.rays
    cost_as_leaf, min_cost = make_costs(heuristic)

    @wp.func
    def share_lanes(rules: BuildRules, rays: rays_type, tree: BinaryTree, costs: wp.array(dtype=float), pair: int, lanes: int):
        """Number of lanes of a pair's left node in D(n, lanes)."""
        best = float(INFINITY)
        share = int(1)
        for k in range(1, lanes):
            cost = min_cost(rules, rays, tree, costs, 2 * pair, k) + min_cost(rules, rays, tree, costs, 2 * pair + 1, lanes - k)
            if cost < best:
                best = cost
                share = k
        return share

    def pick_children(
        first: int,
        level_first: int,
        rules: BuildRules,
        rays: rays_type,
        tree: BinaryTree,
        costs: wp.array(dtype=float),
        wide: WideLevels,
    ):
        """Item: a node of the level. Writes its children and their counts."""
        index = level_first + first + wp.tid()
        width = 1 << rules.cost.width_bits
        waiting = wp.zeros(shape=(MAX_WIDTH,), dtype=wp.vec2i)
        node = wide.source[index]
        lanes = int(width)
        depth = int(0)
        held = int(0)
        counts = wp.vec2i(0, 0)
        share = bool(True)  # the root must become a node, even if a leaf or a lane would cost less
        picking = bool(True)
        while picking:
            pair = tree.pair[node]
            if pair != LEAF and not share:
                share = costs[pair * MAX_WIDTH + lanes - 1] < costs[pair * MAX_WIDTH]
            if pair != LEAF and share:
                left = share_lanes(rules, rays, tree, costs, pair, lanes)
                waiting[depth] = wp.vec2i(2 * pair + 1, lanes - left)
                depth += 1
                node = 2 * pair
                lanes = left
            else:
                # costs are no guide if surface areas overflow or are NaN: what has no children is a leaf whatever it costs
                is_leaf = pair == LEAF
                if tree.range[node][1] <= rules.max_leaf and not is_leaf:
                    is_leaf = cost_as_leaf(rules, rays, tree, costs, node) <= min_cost(rules, rays, tree, costs, node, 1)
                if is_leaf:
                    wide.pick[index, held] = ~node
                    counts[1] += (tree.range[node][1] + width - 1) >> rules.cost.width_bits
                else:
                    wide.pick[index, held] = node
                    counts[0] += 1
                held += 1
                depth -= 1
                picking = depth >= 0
                if picking:
                    node = waiting[depth][0]
                    lanes = waiting[depth][1]
            share = False
        for lane in range(held, width):
            wide.pick[index, lane] = NO_NODE
        wide.first[index] = counts

    return specialised_kernel(pick_children, beside=heuristic.rays.__name__)


@cache
def search_kernels(heuristic: Heuristic) -> list[wp.Kernel]:
    """The two kernels that search for the cheapest wide tree: those of `make_solve` and `make_pick_children`."""
    return [make_solve(heuristic), make_pick_children(heuristic)]


@exact_kernel
def scan_level(first: int, level_first: int, level_end: int, wide: WideLevels, totals: wp.array(dtype=int)):
    """One item: the prefix sum over a level. totals: (2,) wide nodes and blocks so far."""
    nodes = totals[0]
    blocks = totals[1]
    for index in range(level_first, level_end):
        counts = wide.first[index]
        wide.first[index] = wp.vec2i(nodes, blocks)
        nodes += counts[0]
        blocks += counts[1]
    totals[0] = nodes
    totals[1] = blocks


@exact_kernel
def list_children(first: int, level_first: int, width: int, wide: WideLevels):
    """Item: a node of the level. Lists its inner children."""
    index = level_first + first + wp.tid()
    to = wide.first[index][0]
    for lane in range(width):
        node = wide.pick[index, lane]
        if node >= 0 and node != NO_NODE:
            wide.source[to] = node
            to += 1


@exact_kernel
def write_nodes(
    first: int,
    tree: BinaryTree,
    width_bits: int,
    wide: WideLevels,
    bounds: wp.array(dtype=float),
    child: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
):
    """Item: a wide node. Writes its boxes, child words and leaf blocks."""
    index = first + wp.tid()
    width = 1 << width_bits
    next_child = wide.first[index][0]
    next_block = wide.first[index][1]
    for lane in range(width):
        node = wide.pick[index, lane]
        word = int(EMPTY_LANE)
        if node == NO_NODE:
            for component in range(6):
                bounds[(index * 6 + component) * width + lane] = wp.where(component < 3, INFINITY, -INFINITY)
        else:
            leaf = node < 0
            node = wp.where(leaf, ~node, node)
            for axis in range(3):
                bounds[(index * 6 + axis) * width + lane] = tree.box[node * 8 + axis]
                bounds[(index * 6 + 3 + axis) * width + lane] = -tree.box[node * 8 + 4 + axis]
            if leaf:
                order = tree.range[node]
                word = leaf_child(next_block, order[1])
                blocks = (order[1] + width - 1) >> width_bits
                for i in range(blocks << width_bits):
                    triangle = int(-1)
                    if i < order[1]:
                        triangle = tree.order[order[0] + i]
                    primitive[(next_block << width_bits) + i] = triangle
                next_block += blocks
            else:
                word = next_child
                next_child += 1
        child[index * width + lane] = word


def collapse_kernels(heuristic: Heuristic) -> list[wp.Kernel]:
    """The kernels of a collapse, one per module, for loading them ahead of the build."""
    return [search_kernels(heuristic)[0], scan_level]


def solve_costs(binary: BinaryBuild, rules: BuildRules) -> None:
    """Writes F of all inner nodes to `binary.space`."""
    solve, tree, rays, work = search_kernels(binary.heuristic)[0], binary.tree, binary.rays, binary.work
    in_order = work.empty("in order", 0, int)
    work.launch(solve, len(binary.subtrees), [rules, rays, tree, binary.subtrees, in_order, binary.space], chunk=1)
    if binary.top is not None:
        whole = work.empty("whole", 1, wp.vec2i)
        write(whole, np.array([0, len(binary.top)], dtype=np.int32))
        work.launch(solve, 1, [rules, rays, tree, whole, binary.top, binary.space], name="top")


def wide_cost(binary: BinaryBuild, rules: BuildRules) -> float:
    """The least cost of a tree of wide nodes, times the root's area."""
    solve_costs(binary, rules)
    pair = int(binary.tree.pair[:1].numpy()[0])
    return float(binary.space[pair * MAX_WIDTH : pair * MAX_WIDTH + 1].numpy()[0])


def max_nodes(binary: BinaryBuild) -> int:
    """A bound on the number of wide nodes: that of pairs, and the root."""
    pairs = binary.subtrees.numpy()
    return 1 + int((pairs[:, 1] - pairs[:, 0]).sum()) + (0 if binary.top is None else len(binary.top))


def empty_levels(nodes: int, width: int, device: wp.Device) -> WideLevels:
    """Allocates the levels of up to the given number of wide nodes."""
    wide = WideLevels()
    wide.source = wp.empty(nodes, dtype=int, device=device)
    wide.pick = wp.empty((nodes, width), dtype=int, device=device)
    wide.first = wp.empty(nodes, dtype=wp.vec2i, device=device)
    return wide


def collapse(binary: BinaryBuild, triangles: TriangleBoxes, config: BvhConfig, stats: BuildStats) -> Bvh:
    """Collapses a binary tree to the wide tree.

    Raises:
        ValueError: the tree would have more than MAX_BLOCKS blocks.
    """
    tree, costs, rays, work = binary.tree, binary.space, binary.rays, binary.work
    _, pick_children = search_kernels(binary.heuristic)
    device, width = costs.device, config.cost.width
    rules = work.make("rules", 1, lambda _: config.struct())
    solve_costs(binary, rules)
    wide = work.make("wide", max_nodes(binary), lambda size: empty_levels(size, width, device))
    write(wide.source, np.zeros(1, dtype=np.int32))
    totals = work.empty("totals of levels", 2, int)
    write(totals, np.array([1, 0], dtype=np.int32))
    level_first = [0]
    nodes, blocks = 1, 0
    while level_first[-1] < nodes:
        first, count = level_first[-1], nodes - level_first[-1]
        work.launch(pick_children, count, [first, rules, rays, tree, costs, wide], chunk=16)
        work.launch(scan_level, 1, [first, nodes, wide, totals])
        work.launch(list_children, count, [first, width, wide], chunk=128)
        level_first.append(nodes)
        nodes, blocks = read_ints(totals, 2)  # the only host round trip of a level
    check_blocks(blocks, width)
    bounds = wp.empty(nodes * 6 * width, dtype=float, device=device)
    child = wp.empty(nodes * width, dtype=int, device=device)
    primitive = wp.empty(blocks * width, dtype=int, device=device)
    inputs = [tree, rules.cost.width_bits, wide, bounds, child, primitive]
    work.launch(write_nodes, nodes, inputs, chunk=16)
    used = [*binary.arrays(), wide.source, wide.pick, wide.first]
    stats.reserve(triangles.boxes.low, triangles.boxes.high, *used, bounds, child, primitive)
    low, high = wp.vec3(*map(float, triangles.low)), wp.vec3(*map(float, triangles.high))
    return Bvh(bounds, child, primitive, low, high, width, tuple(level_first), stats)


def improved(binary: BinaryBuild, triangles: TriangleBoxes, config: BvhConfig, phase: Phases) -> Bvh:
    """The wide tree of a binary tree, after reinsertion if the configuration asks for it, as the last phases of a build."""
    if config.reinsertion:
        with phase("reinsertion"):
            binary = classic("bvh.reinsertion", "reinsert")(binary, triangles.count, config, phase.stats)
    with phase("collapse"):
        return collapse(binary, triangles, config, phase.stats)
