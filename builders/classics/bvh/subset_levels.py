"""Upper levels of a bounding volume hierarchy from a random subset of the triangles (Tessari et al. 2023).

**Problem.** Near the root, a top-down build reads all triangles once a level, to find planes that a sample of them would
show as well.

**Idea.** Let a random subset find the upper planes, and all triangles the lower ones. Falcone (2024, section 7.2) suggests this
for the whole scene's tree beside those of influence areas.

**Steps.**

1. `choose` a random subset. The caller builds a tree over it, by the builder's own method.
2. `insert`: by its centroid, every triangle follows the planes between the centroids of the subset down to a leaf, in parallel.
3. A stable sort by leaf (`radix_sort`) moves the references; one pass from the leaves up gives the exact boxes.
4. Each leaf is built on, from the triangles of the subset and the inserted ones that are in it.

**Data.** Those of the binned build. The key of a leaf is its first place in the subset's order. If offset[k] counts the
triangles of the leaves before k, a node with the places [a, b) of the subset gets the places [offset[a], offset[b]) of all
triangles, and the pair of its children is named by the first place of the right one, as those of a sweep are.

**Complexity.** O(depth) for each inserted triangle, in a tree that is smaller than the caches.

**What we changed.** The paper builds on a GPU and clusters the other triangles around the leaves. Here they go where a build
over all triangles with these planes would put them, so neither order nor threads show; going by the growth of boxes took longer
and gave no better trees (notebooks/records/2026-11-23-subsets-and-area-kdtrees.md). One triangle is drawn from each run of
equal length, which is uniform and follows the order of the mesh.

**Limits.** The descent ends early where the subtrees might become too deep. The draw has a fixed seed: a tree can be built
again. Meshes of fewer than 2 * MIN_SUBSET triangles are built whole.

References: tessari-2023.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, Frame
from wrt.builders.bvh.phases.bvh_bins import range_box
from wrt.builders.radix_sort import sort_rows
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.builders.triangle_references import copy_references
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

MIN_SUBSET = 1024
"""Least number of triangles of a subset; a mesh that has fewer than twice as many is built whole."""

SEED = 2023

LANES = wp.constant(16)
"""Triangles that are inserted at once."""

CHUNK = 1024


def choose(count: int, share: float) -> np.ndarray:
    """Ids, ascending int32, of a random share of `count` triangles; none of a small mesh, and none for a share of 1."""
    if share == 1.0 or count < 2 * MIN_SUBSET:
        return np.empty(0, dtype=np.int32)
    size = max(MIN_SUBSET, round(count * share))
    begin = np.arange(size + 1, dtype=np.int64) * count // size
    return (begin[:-1] + np.floor(np.random.default_rng(SEED).random(size) * np.diff(begin)).astype(np.int64)).astype(np.int32)


def boxes_at(triangles: TriangleBoxes, ids: np.ndarray) -> TriangleBoxes:
    """The boxes of the triangles `ids`, within the box around all triangles, so that weights are relative to that."""
    boxes, device = Boxes(), triangles.boxes.low.device
    boxes.low, boxes.high = (
        wp.array(np.ascontiguousarray(a.numpy()[:, ids]), dtype=float, device=device)
        for a in (triangles.boxes.low, triangles.boxes.high)
    )
    return TriangleBoxes(boxes, len(ids), triangles.low, triangles.high, triangles.center)


@native.func_native(
    "bins.h",
    "const float *from = references.data, *plane = planes.data;\n"
    f"wrt::find_block<{LANES}>(from, begin, end, plane, tree.pair.data, tree.range.data, limit, keys.data, values.data);",
)
def find_block(
    references: wp.array(dtype=float),
    begin: int,
    end: int,
    tree: BinaryTree,
    planes: wp.array(dtype=float),
    limit: int,
    keys: wp.array2d(dtype=float),
    values: wp.array2d(dtype=int),
):
    """Inserts up to LANES triangles: each goes down to a leaf of the subset's tree, or to a node at the depth `limit`.

    planes: 4 floats a pair, the axis as a unit vector and the doubled coordinate; those of pair 0 are not used. A step waits
    for the one before, so one triangle at a time would take several times as long."""


@wp.func_native("const int key = value; memcpy(keys.data + i, &key, 4);")
def store_key(keys: wp.array2d(dtype=float), i: int, value: int):
    """Writes a key, not negative, as the bits of a float: `radix_sort` orders bits."""


@exact_kernel
def find_leaves(
    first: int,
    references: wp.array(dtype=float),
    count: int,
    tree: BinaryTree,
    planes: wp.array(dtype=float),
    limit: int,
    keys: wp.array2d(dtype=float),
    values: wp.array2d(dtype=int),
):
    """Item: a block of LANES triangles. Writes the keys of their leaves, and their ids."""
    begin = (first + wp.tid()) * LANES
    end = wp.min(begin + LANES, count)
    find_block(references, begin, end, tree, planes, limit, keys, values)


@exact_kernel
def keep_leaves(first: int, ids: wp.array(dtype=int), leaves: wp.array(dtype=int), keys: wp.array2d(dtype=float)):
    """Item: a triangle of the subset. It stays in its leaf, so that no leaf is empty."""
    i = first + wp.tid()
    store_key(keys, ids[i], leaves[i])


@exact_kernel
def move_references(first: int, values: wp.array2d(dtype=int), count: int, references: wp.array(dtype=float)):
    """Item: a place. Copies the reference of its triangle to the second buffer."""
    i = first + wp.tid()
    copy_references(references, values[0, i], 1, references, count + i)


@exact_kernel
def bound_tasks(first: int, tasks: wp.array(dtype=Frame), references: wp.array(dtype=float), tree: BinaryTree):
    """Item: a task. Writes its box."""
    task = tasks[first + wp.tid()]
    range_box(references, task.buffer + task.first, task.count, tree.box, task.node)


@exact_kernel
def link_pairs(first: int, nodes: wp.array(dtype=wp.vec4i), tree: BinaryTree):
    """One item. Writes the inner nodes, given as (node, pair, first, count), from the last to the first: parents come first."""
    for at in range(nodes.shape[0]):
        entry = nodes[nodes.shape[0] - 1 - at]
        node = entry[0]
        tree.pair[node] = entry[1]
        tree.range[node] = wp.vec2i(entry[2], entry[3])
        for i in range(8):
            tree.box[node * 8 + i] = wp.min(tree.box[entry[1] * 16 + i], tree.box[entry[1] * 16 + 8 + i])


KERNELS = (find_leaves,)
"""One kernel of each module."""


@dataclass(frozen=True)
class UpperLevels:
    """The upper levels of a tree.

    Attributes:
        tasks: (tasks,) `Frame`s of the nodes to be built on, by their first triangle; their references are in the second
            buffer.
        top: the pairs above them, parents before children.
    """

    tasks: wp.array
    top: wp.array


def insert(
    references: wp.array, count: int, ids: np.ndarray, centers: np.ndarray, part: BinaryTree, tree: BinaryTree
) -> UpperLevels:
    """Inserts all triangles into the tree of a subset, and writes its nodes to the tree of all.

    Args:
        references: of all triangles, in the first buffer, by id.
        count: number of triangles.
        ids: (subset,) the triangles of the subset.
        centers: (3, subset) float32, the doubled centroids of their boxes.
        part: their tree.
        tree: empty but for the root's box.
    """
    device = references.device
    limit = MAX_WIDE_DEPTH - int(count - 1).bit_length()
    keys = wp.empty((3, 2 * count), dtype=float, device=device)
    values = wp.empty((3, 2 * count), dtype=int, device=device)
    levels, ranges, pair = levels_of(part, limit), part.range.numpy(), part.pair.numpy()
    planes = wp.array(planes_of(part, levels, centers), dtype=float, device=device)
    blocks = -(-count // LANES)
    launch(find_leaves, blocks, [references, count, part, planes, limit, keys, values], device=device, chunk=CHUNK // LANES)
    ends = [is_end(pair, level, depth, limit) for depth, level in enumerate(levels)]
    leaves = np.concatenate([level[end] for level, end in zip(levels, ends, strict=True)])
    leaves = leaves[np.argsort(ranges[leaves, 0])]
    own = np.repeat(ranges[leaves, 0], ranges[leaves, 1])
    kept = [wp.array(a.astype(np.int32), dtype=int, device=device) for a in (ids[part.order.numpy()[: len(ids)]], own)]
    launch(keep_leaves, len(ids), [*kept, keys], device=device, chunk=CHUNK)
    sizes = np.bincount(keys[0].numpy().view(np.int32)[:count], minlength=len(ids))
    sort_rows(keys, values, wp.vec3i(count, 0, 0))
    launch(move_references, count, [values, count, references], device=device, chunk=CHUNK)
    offset = np.append(0, np.cumsum(sizes))

    def new(node: np.ndarray) -> np.ndarray:
        """The nodes in the tree of all triangles."""
        return np.where(node == 0, 0, 2 * offset[ranges[np.where(node == 0, 0, node | 1), 0]] + (node & 1))

    tasks, inner = [], []
    for depth, (level, end) in enumerate(zip(levels, ends, strict=True)):
        frames = np.zeros(end.sum(), dtype=Frame.numpy_dtype())
        begin = ranges[level[end]]
        frames["node"], frames["first"], frames["buffer"], frames["depth"] = new(level[end]), offset[begin[:, 0]], count, depth
        frames["count"] = offset[begin.sum(axis=1)] - frames["first"]
        tasks.append(frames)
        node = level[~end]
        begin, right = ranges[node], 2 * pair[node] + 1
        places = offset[begin[:, 0]]
        inner.append(np.stack([new(node), offset[ranges[right, 0]], places, offset[begin.sum(axis=1)] - places], axis=1))
    frames = np.concatenate(tasks)
    frames = wp.array(frames[np.argsort(frames["first"])], dtype=Frame, device=device)
    linked = np.concatenate(inner).astype(np.int32)
    launch(bound_tasks, len(frames), [frames, references, tree], device=device, chunk=16)
    launch(link_pairs, 1, [wp.array(linked, dtype=wp.vec4i, device=device), tree], device=device, chunk=1)
    return UpperLevels(frames, wp.array(np.ascontiguousarray(linked[:, 1]), dtype=int, device=device))


def is_end(pair: np.ndarray, level: np.ndarray, depth: int, limit: int) -> np.ndarray:
    """Which nodes of a level triangles are inserted into."""
    return (pair[level] == LEAF) | (depth == limit)


def levels_of(tree: BinaryTree, limit: int) -> list[np.ndarray]:
    """The nodes of each level of a binary tree, down to the depth `limit`."""
    pair, levels = tree.pair.numpy(), [np.zeros(1, dtype=np.int64)]
    while True:
        level = levels[-1]
        inner = level[~is_end(pair, level, len(levels) - 1, limit)]
        if not len(inner):
            return levels
        levels.append((2 * pair[inner].astype(np.int64)[:, None] + [0, 1]).ravel())


def planes_of(tree: BinaryTree, levels: list[np.ndarray], centers: np.ndarray) -> np.ndarray:
    """(4 * triangles,) float32: for each pair the plane between the centroids of its children, on the axis of the widest gap.

    Args:
        tree: the tree of the subset.
        levels: its nodes.
        centers: (3, triangles) doubled centroids.
    """
    ranges = tree.range.numpy()
    planes = np.zeros((centers.shape[1], 4), dtype=np.float32)
    ordered = centers[:, tree.order.numpy()]
    ordered = np.concatenate([ordered, ordered[:, -1:]], axis=1)  # an end may be the number of triangles
    for children in levels[1:]:
        pairs = children[::2] >> 1
        begin, middle = ranges[children[::2], 0], ranges[children[1::2], 0]
        end = begin + ranges[children[::2], 1] + ranges[children[1::2], 1]
        cuts = np.stack([begin, middle, end], axis=1)
        max_left = np.maximum.reduceat(ordered, cuts.ravel(), axis=1).reshape(3, -1, 3)[:, :, 0]
        min_right = np.minimum.reduceat(ordered, cuts.ravel(), axis=1).reshape(3, -1, 3)[:, :, 1]
        axis, row = np.argmax(min_right - max_left, axis=0), np.arange(len(pairs))
        planes[pairs, axis] = 1.0
        planes[pairs, 3] = 0.5 * max_left[axis, row] + 0.5 * min_right[axis, row]
    return planes.ravel()
