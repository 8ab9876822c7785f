"""Naive build of an SAH kd-tree in O(N^2): every plane against every triangle (Wald and Havran 2006).

**Problem.** The cost has its minimum at an end of some triangle's box, so all these planes must be compared.

**Algorithm.** At every node, the planes at both ends of every triangle's box are compared with all triangles of the node
(`exact_planes`). Nothing is sorted.

**Data.** One list of references per node (`wrt.builders.core.reference_lists`).

**Phases** of a node: `naive_method`. Search: `exact_search`. Classify and partition: one pass over the references.

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
