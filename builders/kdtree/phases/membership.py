"""Which live nodes triangles lie in, while nothing but that moves: what the in-place build keeps of a level
(`in_place_levels`), and how a level ends: every triangle replaces its nodes by their children.

ClassifyTriangles of Choi et al. 2010, by count, scan and fill: `count_shared`, a sum over the chunks on the host, and
`refine_members`.

References: choi-2010.
"""

import warp as wp

from wrt.builders.core.levels import LiveNode, side_of
from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class Membership:
    """Which live nodes each triangle lies in: mostly one, so that an event finds its node with one access to memory."""

    node: wp.array(dtype=int)
    """(triangles,) the live node of a triangle that lies in one; ~place in `shared` of one that lies in several."""
    shared: wp.array(dtype=int)
    """At each such place: how many nodes, then their indices, ascending."""


@wp.func
def member_count(membership: Membership, own: int):
    """Number of nodes of a triangle; own: its `Membership.node`."""
    if own >= 0:
        return 1
    return load_int(membership.shared, ~own)


@wp.func
def member(membership: Membership, own: int, number: int):
    """A node of a triangle, of those that `member_count` counts; own: its `Membership.node`."""
    if own >= 0:
        return own
    return load_int(membership.shared, ~own + 1 + number)


@wp.func
def count_children(boxes: Boxes, nodes: wp.array(dtype=LiveNode), membership: Membership, triangle: int):
    """Number of nodes that a triangle lies in on the next level."""
    own = load_int(membership.node, triangle)
    members = member_count(membership, own)
    count = int(members)
    for m in range(members):
        node = nodes[member(membership, own, m)]
        if not node.finished:
            axis = node.split.axis
            if side_of(node.split, boxes.low[axis, triangle], boxes.high[axis, triangle]) == 3:
                count += 1
    return count


@exact_kernel
def count_shared(
    first: int,
    size: int,
    triangles: int,
    boxes: Boxes,
    nodes: wp.array(dtype=LiveNode),
    membership: Membership,
    refined: Membership,
    counts: wp.array(dtype=int),
):
    """Item: a chunk of triangles. Notes in `refined.node` how many nodes each lies in on the next level.

    counts: (chunks,) the room that the chunk needs in `refined.shared`."""
    chunk = first + wp.tid()
    room = int(0)
    for triangle in range(chunk * size, wp.min(triangles, (chunk + 1) * size)):
        count = count_children(boxes, nodes, membership, triangle)
        store_int(refined.node, triangle, count)
        room += wp.where(count > 1, count + 1, 0)
    counts[chunk] = room


@exact_kernel
def refine_members(
    first: int,
    size: int,
    triangles: int,
    boxes: Boxes,
    nodes: wp.array(dtype=LiveNode),
    membership: Membership,
    refined: Membership,
    places: wp.array(dtype=int),
):
    """Item: a chunk of triangles. Writes their nodes on the next level; places: where the chunk begins in `refined.shared`."""
    chunk = first + wp.tid()
    to = places[chunk]
    for triangle in range(chunk * size, wp.min(triangles, (chunk + 1) * size)):
        count = load_int(refined.node, triangle)
        if count > 1:
            store_int(refined.node, triangle, ~to)
            store_int(refined.shared, to, count)
            to += 1
        own = load_int(membership.node, triangle)
        for m in range(member_count(membership, own)):
            node = nodes[member(membership, own, m)]
            side = int(1)
            if not node.finished:
                axis = node.split.axis
                side = side_of(node.split, boxes.low[axis, triangle], boxes.high[axis, triangle])
            for child in range(2):
                if (side & (1 << child)) != 0:
                    if count > 1:
                        store_int(refined.shared, to, node.left + child)
                        to += 1
                    else:
                        store_int(refined.node, triangle, node.left + child)
