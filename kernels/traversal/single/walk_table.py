"""The table of single-ray walks, for kernels that are built around one."""

from collections.abc import Callable

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.kdtree_nodes import KdNodes
from wrt.kernels.traversal.single import single_bvh
from wrt.kernels.traversal.single import single_kdtree as single
from wrt.kernels.traversal.traversal_config import TraversalConfig

WALKS: dict[str, tuple[type, Callable[[TraversalConfig], wp.Function]]] = {
    "bvh": (WideNodes, single_bvh.make_walk),
    "kdtree": (KdNodes, single.make_walk),
}
"""For each kind of tree its struct and the factory of its walk."""
