"""Trees over the boxes of instances: one for each environment, and one over all, which share their nodes.

**Problem.** A simulation has thousands of environments, each with a dozen instances, and a ray sees those of its own
environment and those that all environments share. With masks, a ray would meet the boxes of all the others in vain.

**Data.** One array of wide nodes (`wrt.kernels.layout.bvh_nodes`) with many roots. Each environment has a tree of its own
instances, and so have the shared ones. The **root of an environment** is a node with the children of the root of its own tree,
and the shared tree as one child more (or both as its only children, if there is no free lane). The **root of all** stands above
all trees, for rays of no environment. So only one node an environment is stored twice, and traversals only start elsewhere.

**Build.** An environment of up to W instances is one node. Larger ones are sorted along a Morton curve and packed evenly, node
by node and level by level, all of them in the same array operations. Environments of more than `MAX_PACKED` instances, and the
shared instances, get a tree by the surface area heuristic, as good as that of a scene without environments.

**Update.** Nodes are numbered by their height, greatest first. New boxes go into the lanes of the leaves and upwards level by
level (`InstanceForest.bounds`); the nodes stay as they are, until `InstanceForest.cost` says that others would be better.

References: kamel-faloutsos-1993 (sorted along a space-filling curve, packed level by level); morton-1966.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE
from wrt.kernels.layout.instance_maps import LIST_BITS, MAX_LISTED_INSTANCES

EVERY = -1
"""Environment of instances that rays of all environments see, and of rays that see all instances."""

MAX_PACKED = 256
"""Largest number of instances of an environment that are packed along a curve."""

MORTON_CELLS = 1 << 10
"""Cells per axis of the curve."""

MAX_WORD = np.iinfo(np.int32).max

TINY = float(np.finfo(np.float64).tiny)

TreeOfBoxes = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A builder: from (n, 3) lowest and highest corners to (nodes, W) child words, whose leaves have one box each, and the
(blocks,) box of each leaf's block."""


@dataclass(frozen=True)
class InstanceForest:
    """Nodes and roots, without boxes.

    Attributes:
        child: (nodes, W) int32 child words; the block of a leaf is the number of its instance.
        level_first: first node of each level, greatest height first, and the number of nodes.
        root: of all instances.
        shared_root: of the instances of all environments; -1 if there are none.
        environments: (E,) int32, ascending: those with instances of their own.
        roots: (E,) int32, root of each, from which its own and the shared instances are reached.
        lists: (E + 1,) int32 of each environment, and last of the shared instances: the first of the nodes, one after the
            other, that hold its own instances and nothing else, times 2^`LIST_BITS`, and their number; 0 if there are more than
            `MAX_LISTED_INSTANCES` instances, or none. (0,) if too many are shared.
        layered: (N,) bool, the instances in trees of several nodes, whose quality depends on where they are.
        layered_count: their number.
    """

    child: np.ndarray
    level_first: tuple[int, ...]
    root: int
    shared_root: int
    environments: np.ndarray
    roots: np.ndarray
    lists: np.ndarray
    layered: np.ndarray

    def __post_init__(self) -> None:
        leaf = (self.child < 0) & (self.child != int(EMPTY_LANE))
        nodes, lanes = np.nonzero(leaf)
        instances = ~self.child[nodes, lanes] >> 6
        by_instance = np.argsort(instances, kind="stable")
        steps, above = [], np.nonzero(self.child >= 0)
        by_child = np.argsort(self.child[above], kind="stable")
        for first, end in reversed([*zip(self.level_first, self.level_first[1:], strict=False)]):
            level_nodes, level_lanes = np.nonzero(self.child[first:end] >= 0)
            if len(level_nodes):
                level_nodes += first
                steps.append((level_nodes, level_lanes, self.child[level_nodes, level_lanes]))
        known = {
            "_leaves": (nodes[by_instance], lanes[by_instance], instances[by_instance]),
            "_leaf_first": np.searchsorted(instances[by_instance], np.arange(len(self.layered) + 1)),
            "_steps": steps,
            "_above": (above[0][by_child], above[1][by_child]),
            "_above_first": np.searchsorted(self.child[above][by_child], np.arange(len(self.child) + 1)),
            "layered_count": int(np.count_nonzero(self.layered)),
        }
        self.__dict__.update(known)

    @cached_property
    def links(self) -> tuple[np.ndarray, ...]:
        """For code that walks from the leaves up, int32: the first lane of each instance and the lanes in which instances are;
        the first lane of each node and the lanes in which nodes are. A lane is node W + lane.
        """
        width = self.child.shape[1]
        places = (values[0] * width + values[1] for values in (self._leaves, self._above))
        firsts = (self._leaf_first, self._above_first)
        return tuple(values.astype(np.int32) for pair in zip(firsts, places, strict=True) for values in pair)

    @property
    def depth(self) -> int:
        """Largest number of inner nodes on a path."""
        return len(self.level_first) - 1

    def cost(self, bounds: np.ndarray) -> float:
        """The surface of the boxes of all nodes but roots, in relation to that of the boxes of instances.

        Rays visit nodes and instances in this ratio, by the surface area heuristic. 0 if all trees have one node.
        `bounds` are as that method gives them.
        """
        nodes, instances = (surface(bounds[where[0], :, where[1]]) for where in (self._above, self._leaves))
        return cost_of(nodes, instances)

    def bounds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(nodes, 6, W) float32 boxes of all children, of the boxes of instances; low, high: (N, 3) float32."""
        nodes, lanes, instances = self._leaves
        bounds = np.full((len(self.child), 6, self.child.shape[1]), np.inf, dtype=np.float32)
        bounds[:, 3:] = -np.inf
        bounds[nodes, :3, lanes], bounds[nodes, 3:, lanes] = low[instances], high[instances]
        for nodes, lanes, children in self._steps:
            bounds[nodes, :3, lanes], bounds[nodes, 3:, lanes] = around(bounds[children])
        return bounds

    def moved(self, bounds: np.ndarray, low: np.ndarray, high: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """The boxes after a few instances have moved: those above them are computed again.

        Args:
            bounds: the old ones, as in `bounds`.
            low, high: (N, 3) float32, of all instances.
            rows: (M,) instances that have moved.
        """
        bounds = bounds.copy()
        at = entries(self._leaf_first, rows)
        nodes, lanes, instances = (values[at] for values in self._leaves)
        bounds[nodes, :3, lanes], bounds[nodes, 3:, lanes] = low[instances], high[instances]
        while len(at := entries(self._above_first, np.unique(nodes))):
            nodes, lanes = (values[at] for values in self._above)
            children = self.child[nodes, lanes]
            bounds[nodes, :3, lanes], bounds[nodes, 3:, lanes] = around(bounds[children])
        return bounds


def cost_of(nodes: float, instances: float) -> float:
    """`InstanceForest.cost` of the surfaces of the boxes of nodes and of instances."""
    return nodes / max(instances, TINY)


def surface(boxes: np.ndarray) -> float:
    """Half the surface of all boxes together; (n, 6)."""
    x, y, z = (boxes[:, 3:].astype(np.float64) - boxes[:, :3]).T
    return float(x @ y + y @ z + z @ x)


def around(boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) corners of the boxes around those in each of (n, 6, W) nodes."""
    by_lane = np.ascontiguousarray(boxes.reshape(-1, boxes.shape[2]).T)  # rows of all nodes are reduced faster than short ones
    low, high = by_lane.min(axis=0).reshape(-1, 6), by_lane.max(axis=0).reshape(-1, 6)
    return low[:, :3], high[:, 3:]


def entries(first: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Places of the entries of some rows, one row after the other; first: place of each row's first entry, and the end."""
    begins = first[rows]
    counts = first[rows + 1] - begins
    if len(rows) == 1:
        return np.arange(begins[0], begins[0] + counts[0])
    return np.repeat(begins - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())


def build_forest(low: np.ndarray, high: np.ndarray, environment: np.ndarray, width: int, build: TreeOfBoxes) -> InstanceForest:
    """The trees of N instances.

    Args:
        low, high: (N, 3) corners of their boxes.
        environment: (N,) int32, `EVERY` or at least 0.
        width: children of a node, at least 2.
        build: makes the trees of many instances.
    """
    numbers, group, counts = np.unique(environment, return_inverse=True, return_counts=True)
    leaf = (~(np.arange(len(low)) << 6 | 1)).astype(np.int32)
    most_shared = max(width, MAX_LISTED_INSTANCES) if len(numbers) > 1 else width
    alone = counts > np.where(numbers == EVERY, most_shared, MAX_PACKED)
    roots, layered = np.full(len(numbers), -1), counts[group] > width
    nodes = np.where(alone, 0, -(-counts // width))  # of leaves, group by group
    lists = np.cumsum(nodes) - nodes, np.where(counts <= MAX_LISTED_INSTANCES, nodes, 0)
    packed = np.flatnonzero(~alone[group])
    parts, filled = [], 0
    if len(packed):
        parts, found = pack(group[packed], low[packed], high[packed], leaf[packed], width)
        filled = sum(map(len, parts))
        whole = np.flatnonzero(~alone)
        roots[whole] = found[whole]
    for number in np.flatnonzero(alone):
        own = np.flatnonzero(group == number)
        words, box = build(low[own], high[own])
        is_leaf = (words < 0) & (words != int(EMPTY_LANE))
        parts.append(np.where(words >= 0, words + filled, EMPTY_LANE).astype(np.int32))
        parts[-1][is_leaf] = leaf[own[box[~words[is_leaf] >> 6]]]
        roots[number], filled = filled, filled + len(words)
    root = roots[0]
    if len(numbers) > 1:
        order = np.argsort(group, kind="stable")
        begins = np.cumsum(counts) - counts
        corners = np.minimum.reduceat(low[order], begins), np.maximum.reduceat(high[order], begins)
        above, found = pack(np.zeros(len(numbers), dtype=int), *corners, roots.astype(np.int32), width, filled)
        parts += above
        filled, root = filled + sum(map(len, above)), found[0]
    child, is_shared = np.concatenate(parts), len(numbers) > 0 and numbers[0] == EVERY
    own, shared = (roots[1:], int(roots[0])) if is_shared else (roots, -1)
    if is_shared and not lists[1][0]:
        lists = lists[0][:0], lists[1][:0]
    else:
        lists = tuple(np.append(values[int(is_shared) :], values[0] if is_shared else 0) for values in lists)
    if is_shared and len(own):
        child, own = np.concatenate([child, with_shared(child, own, shared)]), filled + np.arange(len(own))
    return by_height(child, int(root), shared, numbers[numbers != EVERY], own, lists, layered)


def pack(
    group: np.ndarray, low: np.ndarray, high: np.ndarray, words: np.ndarray, width: int, first: int = 0
) -> tuple[list[np.ndarray], np.ndarray]:
    """Trees of several groups of boxes at once, each box with its child word.

    Args:
        group: (n,) number of each box's group.
        low, high: (n, 3).
        words: (n,) int32.
        width: children of a node.
        first: number of the first node that is made.

    Returns:
        (k, W) child words of each level's nodes, and the root of each group (-1 for groups without boxes).
    """
    order = np.lexsort((morton_code(group, low, high), group))
    group, words = group[order], words[order]
    roots, levels = np.full(int(group.max()) + 1, -1), []
    while len(group):
        counts = np.bincount(group, minlength=len(roots))
        made = -(-counts // width)
        rank = np.arange(len(group)) - (np.cumsum(counts) - counts)[group]
        place = rank * made[group] // counts[group]
        lane = rank + (-place * counts[group] // made[group])
        node = (np.cumsum(made) - made)[group] + place
        level = np.full((int(made.sum()), width), EMPTY_LANE, dtype=np.int32)
        level[node, lane] = words
        levels.append(level)
        owner, number = np.repeat(np.arange(len(roots)), made), (first + np.arange(len(level))).astype(np.int32)
        first += len(level)
        done = made[owner] == 1
        roots[owner[done]] = number[done]
        group, words = owner[~done], number[~done]
    return levels, roots


def morton_code(group: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n,) place of each box's centre on a Morton curve through the box of its group's centres."""
    centre = low.astype(np.float64) + high
    low, high = (np.full((int(group.max()) + 1, 3), value) for value in (np.inf, -np.inf))
    np.minimum.at(low, group, centre)
    np.maximum.at(high, group, centre)
    size = np.maximum(high - low, np.finfo(np.float64).tiny)[group]
    cell = np.minimum((centre - low[group]) / size * MORTON_CELLS, MORTON_CELLS - 1).astype(np.int64)
    code = np.zeros(len(group), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return code


def with_shared(child: np.ndarray, roots: np.ndarray, shared: int) -> np.ndarray:
    """(E, W) child words of environments' roots: those of their own trees' roots and the shared tree."""
    words = child[roots]
    used, lanes = (words != int(EMPTY_LANE)).sum(axis=1), (child[shared] != int(EMPTY_LANE)).sum()
    width, rows = words.shape[1], np.arange(len(roots))
    free = width - used
    spread = np.flatnonzero(free >= lanes)  # the children of a small shared root fit in
    words[spread[:, None], used[spread, None] + np.arange(lanes)] = child[shared, :lanes]
    one = rows[(free >= 1) & (free < lanes)]
    words[one, used[one]] = shared
    full = rows[free == 0]
    words[full] = EMPTY_LANE
    words[full, 0], words[full, 1] = roots[full], shared
    return words


def by_height(
    child: np.ndarray,
    root: int,
    shared: int,
    environments: np.ndarray,
    roots: np.ndarray,
    lists: tuple[np.ndarray, np.ndarray],
    layered: np.ndarray,
) -> InstanceForest:
    """The forest with its nodes in the order of their heights; lists: first nodes, and numbers of nodes."""
    nodes, lanes = np.nonzero(child >= 0)
    below, height = child[nodes, lanes], np.zeros(len(child), dtype=np.int64)
    while len(nodes):
        higher = np.zeros_like(height)
        np.maximum.at(higher, nodes, height[below] + 1)
        if (higher == height).all():
            break
        height = higher
    order = np.argsort(-height, kind="stable")
    place = np.empty(len(order), dtype=np.int32)
    place[order] = np.arange(len(order))
    child = child[order]
    inner = child >= 0
    child[inner] = place[child[inner]]
    sizes = np.bincount(height)[::-1]
    level_first = (0, *np.cumsum(sizes).tolist())
    shared = int(place[shared]) if shared >= 0 else -1
    firsts, sizes = lists
    firsts = place[firsts].astype(np.int64) << LIST_BITS
    words = np.where((sizes > 0) & (firsts <= MAX_WORD), firsts | sizes, 0).astype(np.int32)
    return InstanceForest(
        child,
        level_first,
        int(place[root]),
        shared,
        environments.astype(np.int32),
        place[roots].astype(np.int32),
        words,
        layered,
    )
