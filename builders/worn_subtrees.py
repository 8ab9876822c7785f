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

References:
    X. Yang, D. Xu, L. Zhao: Ray tracing dynamic scenes using fast KD-tree base on multi-core architectures. International
        Conference on Computer Science and Software Engineering 2008 (as the survey tells it).
    C. Lauterbach, S.-E. Yoon, D. Tuft, D. Manocha: RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs.
        IEEE Symposium on Interactive Ray Tracing 2006 (the threshold on a measure of what refitting has cost).
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from collections.abc import Callable

import numpy as np

MOST_SUBTREES = 16
"""Of one node: more are built together, as the whole of the node, because every build has its fixed price."""

Children = Callable[[int], tuple[np.ndarray, np.ndarray]]
"""node -> its inner children (or all of them), and the probabilities that a ray which meets the node meets them."""


LEAST_SHARE = 1.0 / 32.0
"""Of the rays that meet the root: smaller nodes below good ones are left alone."""


def worn_subtrees(
    now: np.ndarray, built: np.ndarray, children: Children, tolerance: float, node: int = 0, share: float = 1.0
) -> list[int]:
    """The nodes to build again, none of them below another; [] if the tree is good, [0] if all of it is worn.

    Args:
        now: (nodes,) cost of each subtree.
        built: (nodes,) the same when it was built.
        children: of a node.
        tolerance: how many times the cost a node may come to.
        node: where to begin.
        share: of the rays that meet the root, those that meet the node.
    """
    below, probability = children(node)
    worn = now[below] > tolerance * built[below]
    if now[node] > tolerance * built[node]:
        mended = now[node] - (probability * (now[below] - built[below]))[worn].sum()
        if mended > tolerance * built[node]:
            return [node]
    shares = share * probability
    chosen = []
    for place in np.flatnonzero(worn | (shares >= LEAST_SHARE)):
        chosen += worn_subtrees(now, built, children, tolerance, int(below[place]), float(shares[place]))
    return chosen if len(chosen) <= MOST_SUBTREES else [node]
