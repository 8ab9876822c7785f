"""The rebuild heuristic: which parts of a tree whose triangles have moved are worth building again.

**Problem.** A tree keeps its nodes while the triangles move, and stays correct; but rays take ever more steps. To build it anew
every frame costs more than it saves while the motion is small, or is confined to a corner.

**Idea (Yang et al. 2008).** Each node keeps its cost by the surface area heuristic from when it was built, as what it would get
from a build now, and is compared with its cost of now. Nodes above a threshold are built again, the whole tree or a subtree.

**Which node.** The cost of a node is the expected cost of a ray that meets its box, so it does not change if the node is moved,
turned over or scaled. A node is worn if its cost has grown by more than the tolerance. If it would be fine again with its worn
children as they were built, the fault is theirs, and each is looked at in turn; else it is the node's own. A good node may have
worn ones below it, which matter to rays that are shot at them: they are sought in what one ray in 32 meets, as long as the
rays are like those of the surface area heuristic. Subtrees that turn out no better than before leave their parent worn, which
is then chosen the next time.

**Siblings.** What has moved need not be a subtree: in a wide BVH it may be some children of a node. (A ball among three fills
three lanes of eight. In disorder, each of the three has the box of the whole ball, and none gets a better one by itself.) So
children that are worn, and would not do one by one, are built together, as one subtree in one lane of their node, if that
would do.

**Shared triangles.** Neighbouring cells of a kd-tree list the same triangles where these are long: the parts of a node can list
more between them than the whole of it. (The same ball, in a kd-tree: eight cells with 6,790 triangles, of which 1,280 are
different.) Then the node is built, which is less work and gives a better tree.

References:
    X. Yang, D. Xu, L. Zhao: Ray tracing dynamic scenes using fast KD-tree base on multi-core architectures. International
        Conference on Computer Science and Software Engineering 2008 (as the survey tells it).
    C. Lauterbach, S.-E. Yoon, D. Tuft, D. Manocha: RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs.
        IEEE Symposium on Interactive Ray Tracing 2006 (the threshold on a measure of what refitting has cost).
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from collections.abc import Callable
from math import inf

import numpy as np

MOST_SUBTREES = 16
"""Of one node: more are built together, as the whole of the node, because every build has its fixed price."""

Part = tuple[int, ...]
"""What is built as one: a node, or some children of a node."""

Children = Callable[[int], tuple[np.ndarray, np.ndarray]]
"""node -> its inner children (or all of them), and the probabilities that a ray which meets the node meets them."""

Together = Callable[[int, np.ndarray, np.ndarray], float]
"""(node, some of its children, what each cost when it was built) -> what they would add to the node's cost, built as one."""

Triangles = Callable[[int], np.ndarray]
"""node -> ids of the triangles below it, each once."""

LEAST_SHARE = 1.0 / 32.0
"""Of the rays that meet the root: smaller nodes below good ones are left alone."""


def worn_subtrees(
    now: np.ndarray,
    built: np.ndarray,
    children: Children,
    tolerance: float,
    *,
    together: Together = lambda node, siblings, costs: inf,
    triangles: Triangles | None = None,
) -> list[Part]:
    """What to build again, no part of it below another; [] if the tree is good, [(0,)] if all of it is worn.

    Args:
        now: (nodes,) cost of each subtree.
        built: (nodes,) the same when it was built.
        children: of a node.
        tolerance: how many times the cost a node may come to.
        together: for trees in which several children of a node can be built as one.
        triangles: for trees in which a triangle can be below several nodes, none of which is below another.
    """

    def search(node: int, share: float) -> list[Part]:
        below, probability = children(node)
        worn, limit, parts = now[below] > tolerance * built[below], tolerance * built[node], []
        sought = worn | (share * probability >= LEAST_SHARE)
        if now[node] > limit:
            others = now[node] - (probability * now[below])[worn].sum()
            if others + (probability * built[below])[worn].sum() > limit:
                siblings = below[worn]
                if len(siblings) < 2 or others + together(node, siblings, built[siblings]) > limit:
                    return [(node,)]
                parts.append(tuple(siblings.tolist()))
                sought &= ~worn
        found = [search(int(below[place]), share * float(probability[place])) for place in np.flatnonzero(sought)]
        parts += [part for below_child in found for part in below_child]
        several = sum(map(bool, found)) > 1
        if len(parts) > MOST_SUBTREES or (several and triangles is not None and more_work(parts, node, triangles)):
            return [(node,)]
        return parts

    return search(0, 1.0)


def more_work(parts: list[Part], node: int, triangles: Triangles) -> bool:
    """Whether parts of a node list more triangles, one by one, than all of it."""
    return sum(len(triangles(child)) for part in parts for child in part) > len(triangles(node))
