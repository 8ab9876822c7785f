"""What a traversal kernel is specialised for, and what its caller may ask of it."""

from dataclasses import dataclass

from wrt.kernels.mailbox import NONE

CLOSEST = "closest"
ANY = "any"
QUERIES = (CLOSEST, ANY)
"""Closest hit (t, primitive, uv), or only whether there is any hit."""


@dataclass(frozen=True)
class TraversalConfig:
    """The key of one specialisation: a kernel is made and compiled once for each distinct value.

    Attributes:
        triangle_test: key in `TRIANGLE_TESTS`.
        width: triangles a block, and children of a wide node, 1 to 16.
        query: "closest" or "any".
        coherent: whether neighbouring rays are expected to take the same way through the tree; only speed depends on it.
        counters: whether work per ray is counted (`wrt.kernels.traversal.leaf.Counters`).
        levels: inner nodes on a path that the stack has room for; at least the depth of a wide tree.
        packet: rays of a packet, a multiple of the width.
        shared_origin: whether all rays of the batch start at the same point.
        culling: key in `wrt.kernels.packet.CULLINGS`.
        stream: rays of a stream, 1 to 4096.
        mailbox: key in `wrt.kernels.mailbox.MAILBOXES`.
        one_by_one: whether a ray that goes alone meets the triangles of a leaf one after the other, by the test's scalar form.
    """

    triangle_test: str
    width: int
    query: str = CLOSEST
    coherent: bool = True
    counters: bool = False
    levels: int = 16
    packet: int = 64
    shared_origin: bool = False
    culling: str = "interval"
    stream: int = 1024
    mailbox: str = NONE
    one_by_one: bool = False
