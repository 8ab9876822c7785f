"""Passes over a finished kd-tree: what a build may leave to the end.

**Post-processing.** A build by boxes lists a triangle in every leaf that its box meets. Afterwards each leaf's triangles are
clipped to its cell, and those without a part there are removed. An inner node above two empty leaves becomes an empty leaf. The
planes stay: they were chosen by counts that included the removed triangles, so clipping during the
build is the better way (Havran and Bittner 2002; Rahikainen 2013, section 4.1).

**Late cutting.** A node may have become a leaf although empty space is left in it: at the greatest depth, at the least number
of triangles, or because bad splits were used up. As long as that lowers the leaf's cost, the slab whose cut costs least is cut
off: at most six cuts, one per face of the box of the leaf's triangles.

**What lies in a cell** (`leaf_contents`): the clip is that of `core.clip`, with cells enlarged by the same pad, so a triangle
that is removed is as far from the cell as there, and no hit is lost.

**Complexity.** O(references).

References: havran-2001; havran-bittner-2002; rahikainen-2013 (section 4.1).
"""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.core.clip import ClippedMesh, clipped_mesh
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, half_area, unpack
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

MAX_CUTS = 6
"""Most slabs that are cut off a leaf: one per face."""

EMPTY = (0, LEAF)
"""An empty leaf."""


def postprocess(tree: KdTree, triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Carries out what the configuration leaves to the end of a build: the tree itself if that is nothing."""
    removing, cutting = config.cell_tests == "leaves", config.cuts_late
    if not (removing or cutting):
        return tree
    start = perf_counter()
    tested = removing or config.tests_nodes
    flat = unpack(tree)
    keeps, kept, low, high = leaf_contents(tree, flat, triangles, tested, shrinks=tested)
    if removing:
        tree = with_lists(tree, flat, keeps, kept)
    if cutting:
        leaves = np.flatnonzero(flat.is_leaf)
        sizes = kept if removing else flat.triangles[leaves]
        room = MAX_TREE_DEPTH - flat.depth[leaves]
        cells = flat.low[leaves], flat.high[leaves]
        cuts = find_cuts(*cells, low.astype(np.float64), high.astype(np.float64), sizes, room, config.cost)
        tree = with_cuts(tree, leaves, cuts)
    if removing:
        tree = without_empty_nodes(tree)
    seconds = tree.stats.seconds | {"finish": perf_counter() - start}
    return replace(tree, stats=replace(tree.stats, seconds=seconds))


@wp.struct
class Leaves:
    """The leaves of a tree, and what is found about them; `leaf_contents` explains the last four arrays."""

    primitive: wp.array(dtype=int)
    """Lists of all leaves."""
    begin: wp.array(dtype=int)
    """First lane of a leaf's list."""
    count: wp.array(dtype=int)
    low: wp.array(dtype=wp.vec3)
    high: wp.array(dtype=wp.vec3)
    keeps: wp.array(dtype=wp.uint8)
    kept: wp.array(dtype=int)
    inner_low: wp.array(dtype=wp.vec3)
    inner_high: wp.array(dtype=wp.vec3)


@native.func_native("clip.h", "wrt::measure_leaf(mesh, boxes, leaves, leaf, tested);")
def measure_leaf(mesh: ClippedMesh, boxes: Boxes, leaves: Leaves, leaf: int, tested: bool):
    """Finds which triangles of a leaf meet its cell, all of them if they are not `tested`, and the box of these triangles, or
    of their parts, within the cell."""


@exact_kernel
def measure_leaves(first: int, mesh: ClippedMesh, boxes: Boxes, leaves: Leaves, tested: bool):
    """Item: a leaf."""
    measure_leaf(mesh, boxes, leaves, first + wp.tid(), tested)


def leaf_contents(
    tree: KdTree, flat: UnpackedKdTree, triangles: TriangleBoxes, tested: bool, shrinks: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the leaves of a tree contain.

    Args:
        tree: the tree, on the device of the boxes.
        flat: its nodes.
        triangles: its triangles.
        tested: whether triangles are tested against the cells.
        shrinks: whether boxes are those of the triangles' parts in the cells; needs `tested`.

    Returns:
        keeps: (lanes,) bool, whether a lane of `primitive` holds a triangle that meets its leaf's cell.
        kept: (leaves,) number of these, leaf by leaf in the order of the nodes.
        low, high: (leaves, 3) float32, the box of what a leaf keeps within its cell; empty if it keeps nothing.
    """
    device, leaves = tree.nodes.device, np.flatnonzero(flat.is_leaf)
    mesh = clipped_mesh(triangles, triangles.size, shrinks) if tested else ClippedMesh()
    found = Leaves()
    found.primitive = tree.primitive
    found.begin, found.count = (
        wp.array(a[leaves].astype(np.int32), device=device) for a in (flat.first_block * tree.width, flat.triangles)
    )
    found.low, found.high = (
        wp.array(a[leaves].astype(np.float32), dtype=wp.vec3, device=device) for a in (flat.low, flat.high)
    )
    found.keeps = wp.zeros(len(tree.primitive), dtype=wp.uint8, device=device)
    found.kept = wp.empty(len(leaves), dtype=int, device=device)
    found.inner_low, found.inner_high = (wp.empty(len(leaves), dtype=wp.vec3, device=device) for _ in range(2))
    launch(measure_leaves, len(leaves), [mesh, triangles.boxes, found, tested], device=device, chunk=256)
    return found.keeps.numpy() != 0, found.kept.numpy(), found.inner_low.numpy(), found.inner_high.numpy()


def with_lists(tree: KdTree, flat: UnpackedKdTree, keeps: np.ndarray, kept: np.ndarray) -> KdTree:
    """The tree with the lanes that its leaves keep; arguments as returned by `leaf_contents`."""
    leaves, width, device = np.flatnonzero(flat.is_leaf), tree.width, tree.nodes.device
    blocks = -(-kept // width)
    first = np.cumsum(blocks) - blocks
    order = np.argsort(flat.first_block[leaves], kind="stable")  # lists in the order of their lanes
    order = order[kept[order] > 0]
    behind = np.arange(kept[order].sum()) - np.repeat(np.cumsum(kept[order]) - kept[order], kept[order])
    primitive = np.full(int(blocks.sum()) * width, -1, dtype=np.int32)
    primitive[np.repeat(first[order] * width, kept[order]) + behind] = tree.primitive.numpy()[keeps]
    words = tree.nodes.numpy().copy()
    words[leaves, 0], words[leaves, 1] = first, kept << 2 | LEAF
    nodes = wp.array(words, dtype=wp.vec2i, device=device)
    return replace(tree, nodes=nodes, primitive=wp.array(primitive, dtype=int, device=device))


def without_empty_nodes(tree: KdTree) -> KdTree:
    """The tree with an empty leaf in place of every inner node that has only empty leaves below it."""
    flat, words = unpack(tree), tree.nodes.numpy()
    empty = flat.is_leaf & (flat.triangles == 0)
    keeps = np.ones(len(words), dtype=bool)
    for depth in range(int(flat.depth.max()), -1, -1):
        level = np.flatnonzero((flat.depth == depth) & ~flat.is_leaf)
        level = level[empty[flat.left[level]] & empty[flat.right[level]]]
        empty[level] = True
        keeps[flat.left[level]] = keeps[flat.right[level]] = False
    index = np.cumsum(keeps) - 1
    moved = words.copy()
    moved[empty] = EMPTY
    inner = np.flatnonzero(~flat.is_leaf & ~empty)
    moved[inner, 1] = index[flat.right[inner]] << 2 | flat.axis[inner]
    return replace(tree, nodes=wp.array(moved[keeps], dtype=wp.vec2i, device=tree.nodes.device))


@dataclass(frozen=True)
class Cuts:
    """Empty slabs to cut off leaves, in the order of the cuts.

    Attributes:
        count: (leaves,) number of cuts of each leaf.
        axis, position: (leaves, MAX_CUTS) the planes.
        from_low: (leaves, MAX_CUTS) whether the slab is at the lower end of the cell.
    """

    count: np.ndarray
    axis: np.ndarray
    position: np.ndarray
    from_low: np.ndarray


def find_cuts(
    cell_low: np.ndarray,
    cell_high: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    sizes: np.ndarray,
    room: np.ndarray,
    cost: SurfaceAreaCost,
) -> Cuts:
    """The cuts that lower the cost of leaves.

    Args:
        cell_low, cell_high: (leaves, 3) float64 the cells.
        low, high: (leaves, 3) float64 the boxes of what they contain.
        sizes: (leaves,) number of triangles.
        room: (leaves,) levels below each leaf that the tree may have.
        cost: the cost model. Its factor for empty sides is not used: it would pay for cuts that save nothing.
    """
    leaves = len(sizes)
    cell_low, cell_high = cell_low.copy(), cell_high.copy()
    of_leaf = cost.of_leaf(sizes)
    cuts = Cuts(
        np.zeros(leaves, dtype=np.int64),
        np.zeros((leaves, MAX_CUTS), dtype=np.int64),
        np.zeros((leaves, MAX_CUTS)),
        np.zeros((leaves, MAX_CUTS), dtype=bool),
    )
    active = np.flatnonzero((sizes > 0) & (room > 0))
    while len(active):
        area = half_area(cell_low[active], cell_high[active])
        best, plane = of_leaf[active].astype(np.float64), np.full(len(active), -1)
        for number in range(2 * 3):
            axis, from_low = number // 2, number % 2 == 0
            rest_low, rest_high = cell_low[active], cell_high[active]
            position = (low if from_low else high)[active, axis]
            inside = (position > rest_low[:, axis]) & (position < rest_high[:, axis])
            (rest_low if from_low else rest_high)[:, axis] = position
            with np.errstate(divide="ignore", invalid="ignore"):
                share = half_area(rest_low, rest_high) / area
                expected = cost.traversal + share * of_leaf[active]
                better = inside & (expected < best)
            best, plane = np.where(better, expected, best), np.where(better, number, plane)
        cut = plane >= 0
        active, plane = active[cut], plane[cut]
        axis, from_low, number = plane // 2, plane % 2 == 0, cuts.count[active]
        position = np.where(from_low, low[active, axis], high[active, axis])
        cuts.axis[active, number], cuts.position[active, number], cuts.from_low[active, number] = axis, position, from_low
        cell_low[active[from_low], axis[from_low]] = position[from_low]
        cell_high[active[~from_low], axis[~from_low]] = position[~from_low]
        cuts.count[active] += 1
        active = active[(cuts.count[active] < MAX_CUTS) & (cuts.count[active] < room[active])]
    return cuts


def with_cuts(tree: KdTree, leaves: np.ndarray, cuts: Cuts) -> KdTree:
    """The tree with a chain of cuts in place of each leaf, in depth-first order. leaves: (leaves,) their nodes."""
    words = tree.nodes.numpy()
    sizes = np.ones(len(words), dtype=np.int64)
    sizes[leaves] += 2 * cuts.count
    first = np.cumsum(sizes) - sizes
    moved = np.empty((int(sizes.sum()), 2), dtype=np.int32)
    moved[first] = words
    inner = np.flatnonzero(words[:, 1] & 3 != LEAF)
    moved[first[inner], 1] = first[words[inner, 1] >> 2] << 2 | words[inner, 1] & 3
    at = first[leaves]  # where the rest of a leaf is
    for number in range(MAX_CUTS):
        own = np.flatnonzero(cuts.count > number)
        from_low, here = cuts.from_low[own, number], at[own]
        rest = 1 + 2 * (cuts.count[own] - number - 1)  # nodes of the rest
        right = np.where(from_low, here + 2, here + 1 + rest)
        moved[here, 0] = cuts.position[own, number].astype(np.float32).view(np.int32)
        moved[here, 1] = right << 2 | cuts.axis[own, number]
        moved[np.where(from_low, here + 1, right)] = EMPTY
        at[own] = np.where(from_low, here + 2, here + 1)
    moved[at] = words[leaves]
    return replace(tree, nodes=wp.array(moved, dtype=wp.vec2i, device=tree.nodes.device))
