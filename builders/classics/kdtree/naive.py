"""Naive build of an SAH kd-tree in O(N^2): every plane against every triangle (Wald and Havran 2006).

**Problem.** The cost has its minimum at an end of some triangle's box, so all these planes must be compared.

**Idea.** Compare each of them with every triangle. Nothing is sorted.

**Steps** of a node (`naive_method`):

1. For each axis and both ends of every triangle's box, all triangles of the node are counted: to the left of the plane (N_L),
   in it (N_P) and to its right (N_R) (`exact_search`). The least cost wins, with planar triangles on the cheaper side.
2. The node becomes a leaf, or one pass over its references classifies and partitions them.

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Complexity.** O(N^2), too slow for more than a few ten thousand triangles. The builder shows the benefit of sorting, and
reproduces the tree of the sorting builders by an independent method.

**What we changed.** A node's triangles are those whose boxes meet it, not those that meet it themselves. 16 are compared at a
time.

References: wald-havran-2006; rahikainen-2013 (algorithm 4.1.2).
"""

from wrt.builders.classics.kdtree.early_cutting import early
from wrt.builders.core.subtrees import Method
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.exact_planes import exact_search, values_for
from wrt.builders.kdtree.scan.scanning import build_scanning, scan_method, uniform_scan
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes


def naive_method(config: KdTreeConfig) -> Method:
    """What is done with a node."""
    return scan_method(config, early(config, exact_search(config.cost.occluder > 0.0)))


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    return build_scanning(triangles, config, uniform_scan(naive_method(config), triangles, config, values_for(triangles.count)))
