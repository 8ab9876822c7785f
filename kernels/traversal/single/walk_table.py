"""The table of single-ray walks, for kernels that are built around one."""

from collections.abc import Callable

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import KdNodes
from wrt.kernels.traversal.single.single_bvh import make_bvh_walk
from wrt.kernels.traversal.single.single_kdtree import make_kdtree_walk
from wrt.kernels.traversal.traversal_config import TraversalConfig

WALKS: dict[str, tuple[type, Callable[[TraversalConfig], wp.Function]]] = {
    "bvh": (WideNodes, make_bvh_walk),
    "kdtree": (KdNodes, make_kdtree_walk),
}
"""For each kind of tree its struct and the factory of its walk."""
