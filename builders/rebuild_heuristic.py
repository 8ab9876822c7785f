"""The rebuild heuristic: which parts of a tree to rebuild after its triangles have moved.

**Problem.** A refitted tree keeps its nodes while the triangles move, and stays correct, but rays take more and more steps. A
full build in every frame costs more than it saves while the motion is small or local.

**Idea (Yang, Xu and Zhao 2008).** Each node stores its cost by the surface area heuristic from when it was built, as an
estimate of its cost after a rebuild. The heuristic compares this with the node's current cost. Nodes above a threshold are
rebuilt: the whole tree or a subtree.

**Selection.** The cost of a node is the expected cost of a ray that meets its box, so it does not change if the node is moved,
rotated or scaled. A node is degraded if its cost has increased by more than the tolerance. If it would be within the tolerance
with its degraded children at their cost when built, the children are responsible, and each is examined in turn. Otherwise the
node itself is rebuilt. A good node may have degraded descendants, which matter to rays aimed at them. The search descends into
nodes that at least one ray in 32 meets, under the assumptions of the surface area heuristic. If rebuilt subtrees turn out no
better than before, their parent remains degraded and is selected the next time.

**Siblings.** The triangles that have moved may be spread over some children of a node of a wide BVH. (The three children of a
shuffled ball all have the box of the whole ball, and none gets a smaller box if it is rebuilt by itself.) Degraded children
that a separate rebuild cannot repair are therefore rebuilt together, as one subtree in one lane of their node, if that
suffices.

**Shared triangles.** Neighbouring cells of a kd-tree list the same triangles if these are long, so the parts of a node can list
more triangles in total than the whole node (notebooks/records/2026-11-22-partial-rebuilds.md has an example). Then the whole
node is rebuilt, which is less work and gives a better tree.

References: yang-2008 (as described by rahikainen-2013); lauterbach-2006 (a threshold on the degradation by refitting);
    rahikainen-2013.
"""

from collections.abc import Callable
from math import inf

import numpy as np

MAX_SUBTREES = 16
"""Most parts of one node that are rebuilt separately; for more, the whole node is rebuilt, as every build has a fixed cost."""

Part = tuple[int, ...]
"""A unit of rebuilding: a node, or some children of a node."""

Children = Callable[[int], tuple[np.ndarray, np.ndarray]]
"""node -> its inner children (or all of them), and the probabilities that a ray that meets the node meets them."""

JoinedCost = Callable[[int, np.ndarray, np.ndarray], float]
"""(node, some of its children, the cost of each when built) -> estimate of their share of the node's cost, rebuilt as one."""

Triangles = Callable[[int], np.ndarray]
"""node -> ids of the triangles below it, each once."""

MIN_HIT_PROBABILITY = 1.0 / 32.0
"""Share of the rays that meet the root; good nodes that fewer rays meet are not searched."""


def degraded_subtrees(
    now: np.ndarray,
    built: np.ndarray,
    children: Children,
    tolerance: float,
    *,
    joined_cost: JoinedCost = lambda node, siblings, costs: inf,
    triangles: Triangles | None = None,
) -> list[Part]:
    """The parts to rebuild, none below another; [] if the tree is good, [(0,)] to rebuild the whole tree.

    Args:
        now: (nodes,) current cost of each subtree.
        built: (nodes,) its cost when it was built.
        children: children of a node.
        tolerance: ratio of current cost to built cost above which a node is degraded.
        joined_cost: for trees in which several children of a node can be rebuilt as one.
        triangles: for trees in which a triangle can be below several nodes, none of which is below another.
    """

    def search(node: int, share: float) -> list[Part]:
        below, probability = children(node)
        degraded, limit, parts = now[below] > tolerance * built[below], tolerance * built[node], []
        visited = degraded | (share * probability >= MIN_HIT_PROBABILITY)
        if now[node] > limit:
            others = now[node] - (probability * now[below])[degraded].sum()
            if others + (probability * built[below])[degraded].sum() > limit:
                siblings = below[degraded]
                if len(siblings) < 2 or others + joined_cost(node, siblings, built[siblings]) > limit:
                    return [(node,)]
                parts.append(tuple(siblings.tolist()))
                visited &= ~degraded
        found = [search(int(below[i]), share * float(probability[i])) for i in np.flatnonzero(visited)]
        parts += [part for below_child in found for part in below_child]
        is_multiple = sum(map(bool, found)) > 1
        if len(parts) > MAX_SUBTREES or (is_multiple and triangles is not None and costs_more(parts, node, triangles)):
            return [(node,)]
        return parts

    return search(0, 1.0)


def costs_more(parts: list[Part], node: int, triangles: Triangles) -> bool:
    """Whether the parts of a node list more triangles in total than the whole node."""
    return sum(len(triangles(child)) for part in parts for child in part) > len(triangles(node))
