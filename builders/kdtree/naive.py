"""Naive build of an SAH kd-tree in O(N^2): every plane against every triangle (survey, Algorithm 4.1.2).

**Algorithm.** At every node, the planes at both ends of every triangle's box are each compared with all triangles of the node
(`exact_planes`). Nothing is sorted.

**Complexity.** O(N^2), too slow for more than some ten thousand triangles; it shows what sorting is good for, and makes the
sorting builders' tree by another way.

**What we changed.** Triangles are those whose boxes meet the node's, not those that themselves do; 16 are compared at a time.

References:
    I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N).
        IEEE Symposium on Interactive Ray Tracing 2006.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.scan.exact_planes import search_exactly, values_for
from wrt.builders.kdtree.scan.scanning import build_scanning, uniform_scan
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    return build_scanning(triangles, config, uniform_scan(search_exactly, triangles, config, values_for(triangles.count)))
