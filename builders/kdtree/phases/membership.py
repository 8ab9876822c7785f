"""Which live nodes triangles lie in, while nothing but that moves: what the in-place build keeps of a level
(`in_place_levels`)."""

import warp as wp

from wrt.kernels.layout.unchecked import load_int


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
