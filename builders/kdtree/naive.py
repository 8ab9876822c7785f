"""Naive build of an SAH kd-tree in O(N^2): every plane against every triangle (Wald and Havran 2006).

**Problem.** The cost has its minimum at an end of some triangle's box, so all these planes must be compared.

**Algorithm.** At every node, the planes at both ends of every triangle's box are compared with all triangles of the node
(`exact_planes`). Nothing is sorted.

**Data.** One list of references per node (`reference_lists`).

**Phases** of a node: `method`. Search: `exact_search`. Classify and partition: one pass over the references.

**Complexity.** O(N^2), too slow for more than a few ten thousand triangles. The builder shows the benefit of sorting, and
reproduces the tree of the sorting builders by an independent method.

**What we changed.** A node's triangles are those whose boxes meet it, not those that meet it themselves. 16 are compared at a
time.

References:
    I. Wald, V. Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N).
        IEEE Symposium on Interactive Ray Tracing 2006.
    V. Rahikainen: On real-time ray tracing. M.Sc. thesis, University of Tampere, 2013 (algorithm 4.1.2).
"""

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.phases.early_cutting import cutting_early
from wrt.builders.kdtree.phases.kdtree_subtrees import Method, emit_inner, in_partition
from wrt.builders.kdtree.scan.exact_planes import exact_search, values_for
from wrt.builders.kdtree.scan.reference_lists import ReferenceLists, emit_leaf, partition
from wrt.builders.kdtree.scan.scanning import build_scanning, uniform_scan
from wrt.builders.kdtree.scan.split_clipping import partition_clipping
from wrt.builders.tree import KdTree, stop
from wrt.builders.triangle_boxes import TriangleBoxes


def method(config: KdTreeConfig) -> Method:
    """What is done with a node. `kdtree_subtrees` calls these phases."""
    search = exact_search(config.cost.occluder > 0.0)
    return Method(
        memory=ReferenceLists,
        search=cutting_early(search, ReferenceLists) if config.cuts_early else search,
        stop=stop,
        classify=in_partition,
        partition=partition_clipping if config.tests_nodes else partition,
        emit_inner=emit_inner,
        emit_leaf=emit_leaf,
    )


def build(triangles: TriangleBoxes, config: KdTreeConfig) -> KdTree:
    """Builds the tree on the device that holds the boxes."""
    return build_scanning(triangles, config, uniform_scan(method(config), triangles, config, values_for(triangles.count)))
