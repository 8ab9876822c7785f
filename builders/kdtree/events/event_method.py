"""What tasks with sorted events do with a node (`wrt.builders.core.subtrees.Method`)."""

import warp as wp

from wrt.builders.core.subtrees import Method, emit_inner
from wrt.builders.kdtree.events.clipped_events import emit_sorted_leaf, partition_clipping
from wrt.builders.kdtree.events.event_lists import EventLists, classify, emit_leaf, partition, search
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.tree import stop


def event_method(config: KdTreeConfig, search: wp.Function = search, by_id: bool = True) -> Method:
    """The phases of a node.

    Args:
        config: whether triangles are clipped.
        search: as in `Method`.
        by_id: whether leaves list clipped triangles by id.
    """
    return Method(
        memory=EventLists,
        search=search,
        stop=stop,
        classify=classify,
        partition=partition_clipping if config.tests_nodes else partition,
        emit_inner=emit_inner,
        emit_leaf=emit_sorted_leaf if config.tests_nodes and by_id else emit_leaf,
    )
