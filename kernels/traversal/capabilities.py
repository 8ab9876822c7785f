"""What a traversal can do: flags of its row in `wrt.kernels.traversal.TRAVERSALS`."""

from enum import Flag, auto


class Capabilities(Flag):
    """What a traversal can do, and how it takes its rays; configs are those of `wrt.kernels.traversal.traversal_config`."""

    NONE = 0
    PACKETS = auto()
    """Rays are traced in packets: `packet` of the config applies."""
    ONE_VECTOR = auto()
    """A packet is one vector of the tree's width; without it, the size depends on the query."""
    NON_TEMPORAL = auto()
    """`packet.non_temporal` of the config applies, in scenes of one level."""
    STREAMS = auto()
    """Rays are traced in streams: `stream` of the config applies."""
    LONG_STREAMS = auto()
    """Streams through the boxes of one level are not in a thread's local memory, so that they may be long."""
    QUEUED = auto()
    """Rays wait at subtrees, and kernels trace them generation by generation (`wrt.engine.launch.queued_tracing`)."""
    LONG_ITEMS = auto()
    """An item may be several times as many rays (`RayBatch.run`)."""
    SHORT_ITEMS = auto()
    """Where there are few items for each thread, items are cut (`wrt.engine.launch.traversal_launch`); without it, that
    costs more than it balances."""
    SHARED_ORIGIN = auto()
    """All rays of a batch must start at the same point."""
    FRONT_FACES = auto()
    """It can cull back faces, though it does not answer every query."""
    MAILBOX = auto()
    """`mailbox` of the config applies, on a kd-tree."""
    WIDE_FORM = auto()
    """It traverses the wide form of a kd-tree, which has the layout of a BVH (`wrt.builders.convert.wide_kdtree`)."""
    NODE_ORDERS = auto()
    """It can walk the nodes of a kd-tree in another order (`wrt.KdTree(layout=...)`)."""
    OWN_SPACES = auto()
    """It supports scenes whose trees have their own coordinate spaces (`wrt.moving.FuzzyScene`)."""
    SHARED_LEAVES = auto()
    """`shared_leaves` of the config applies: it reports crossings once where a triangle is in several leaves of a BVH."""
    PERSISTENT = auto()
    """It walks a BVH of width 2 in the layout `wrt.kernels.layout.binary_nodes`. On CUDA its threads are persistent: a
    launch has as many as the device holds at a time."""
    ALPHA_MASKS = auto()
    """The variant `MASKED` of the config applies."""
    POINTS = auto()
    """It traces rays through point clouds (`wrt.kernels.clouds`)."""
    CUDA_INSTANCES = auto()
    """It traces rays through instances on CUDA too."""
