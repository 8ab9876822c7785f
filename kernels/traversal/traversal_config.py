"""What a traversal kernel is specialised for, and what its caller may ask of it."""

from dataclasses import dataclass

from wrt.kernels.traversal.mailbox import NONE

CLOSEST = "closest"
ANY = "any"
COUNT = "count"
ALL = "all"
QUERIES = (CLOSEST, ANY, COUNT, ALL)
"""Closest hit (t, primitive, uv), only whether there is any hit, the number of crossings, or all of them."""

NEXT, EXACT = "next", "exact"
"""Queries of the single-ray walks alone: the crossing that follows a given one (`wrt.kernels.query.device_functions`), and the
closest hit in float64 (`wrt.kernels.query.exact_closest`)."""

NEAREST_QUERIES = (CLOSEST, ANY)
"""Those that need one hit: a triangle test's inclusive forms answer them."""


@dataclass(frozen=True)
class TraversalConfig:
    """The key of one specialisation: a kernel is made and compiled once for each distinct value.

    Attributes:
        triangle_test: key in `TRIANGLE_TESTS`.
        width: triangles a block, and children of a wide node, 1 to 16.
        query: one of `QUERIES`, or `NEXT` or `EXACT`.
        coherent: whether neighbouring rays are expected to take the same way through the tree; only speed depends on it.
        counters: whether work per ray is counted (`wrt.kernels.traversal.leaf.Counters`).
        levels: inner nodes on a path that the stack has room for; at least the depth of a wide tree.
        packet: rays of a packet, a multiple of the width.
        shared_origin: whether all rays of the batch start at the same point.
        culling: key in `wrt.kernels.traversal.packet.CULLINGS`.
        stream: rays of a stream, 1 to 4096.
        mailbox: key in `wrt.kernels.traversal.mailbox.MAILBOXES`.
        block: on CUDA, threads of a block, if stacks may lie in its shared memory; else 0.
        pairs: whether the nodes of a kd-tree are in pairs (`wrt.kernels.layout.kdtree_nodes`); the traversal "single" can take
            them for the nearest queries.
        cull_backfaces: whether triangles are hit only from their front (`wrt.kernels.traversal.leaf.comes_from_front`).
        skipping: whether each ray passes through one triangle (`wrt.kernels.query.skip_triangle`); walks of "closest", "any"
            and "count".
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
    block: int = 0
    pairs: bool = False
    cull_backfaces: bool = False
    skipping: bool = False
    one_by_one: bool = False

    @property
    def crossing(self) -> bool:
        """Whether each crossing of a surface is wanted exactly once."""
        return self.query in (COUNT, ALL, NEXT)

    @property
    def own_step(self) -> bool:
        """Whether leaves are tested by a step that takes more, or other, than the closest of its triangles."""
        return self.crossing or self.query == EXACT or self.skipping
