"""The specialisation key of a traversal kernel."""

from dataclasses import dataclass

from wrt.kernels.answers import ANSWERS, PLAIN, VARIANTS, closest_hit
from wrt.kernels.answers.answer_kind import AnswerKind
from wrt.kernels.traversal.mailbox import NONE


@dataclass(frozen=True)
class StackConfig:
    """The stack of a walk through a wide tree.

    Attributes:
        levels: greatest number of inner nodes on a path, the size of the stack; at least the depth of the tree.
        block: on CUDA, threads per block if stacks may be in shared memory; else 0.
    """

    levels: int = 16
    block: int = 0


@dataclass(frozen=True)
class SingleConfig:
    """Options of the walk of a single ray. The last two are for measurements.

    Attributes:
        pair_words: whether the nodes of a kd-tree are in pairs (`wrt.kernels.layout.kdtree_nodes`), for `nearest` kinds of
            answers: the words of 8 bytes that a node then takes, 1 but for measurements; 0 for the builders' order.
        scalar_test: whether the ray is tested against the triangles of a leaf one by one, by the scalar test.
        compact: levels of the compact subtrees that the nodes of a kd-tree are in (`wrt.kernels.layout.compact_nodes`), for
            `nearest` kinds of answers; 0 for none.
    """

    pair_words: int = 0
    scalar_test: bool = False
    compact: int = 0


@dataclass(frozen=True)
class PacketConfig:
    """Options of the traversals whose rays are in packets.

    Attributes:
        rays: rays per packet, a multiple of the width.
        shared_origin: whether all rays of the batch start at the same point.
        culling: key in `wrt.kernels.traversal.packet.CULLINGS`.
        non_temporal: whether closest hits are written by non-temporal stores (`Capabilities.NON_TEMPORAL`).
    """

    rays: int = 64
    shared_origin: bool = False
    culling: str = "interval"
    non_temporal: bool = False


@dataclass(frozen=True)
class TileConfig:
    """Tiles of rays that search for an entry point (`wrt.kernels.classics.traversal.entry_point`). For measurements.

    Attributes:
        packets: packets in the smallest tile.
        split: number of parts of a larger tile, 16 as recommended by Reshetov et al. (2005).
        levels: sizes of tiles that search, at least 1: `packets` packets, `split` times as many, and so on.
    """

    packets: int = 4
    split: int = 16
    levels: int = 2


@dataclass(frozen=True)
class StreamConfig:
    """Options of the traversals whose rays are in streams.

    Attributes:
        rays: rays per stream, 1 to 16384.
    """

    rays: int = 1024


@dataclass(frozen=True)
class PersistentConfig:
    """Options of persistent threads (`wrt.kernels.traversal.persistent`).

    Attributes:
        from_zero: whether t_min is 0 for all rays.
    """

    from_zero: bool = False


@dataclass(frozen=True)
class TraversalConfig:
    """The key of one specialisation: a kernel is made and compiled once for each distinct value.

    The options of one family of traversals are in a config of their own. Families that a traversal does not read keep their
    defaults; other values would only compile the same code again.

    Attributes:
        triangle_test: key in `TRIANGLE_TESTS`.
        width: triangles per block and children per wide node, 1 to 16.
        query: key in `wrt.kernels.answers.ANSWERS`.
        coherent: whether neighbouring rays are expected to take similar paths through the tree; affects only speed.
        counters: whether work is counted per ray (`wrt.kernels.traversal.leaf.Counters`).
        mailbox: key in `wrt.kernels.traversal.mailbox.MAILBOXES`.
        cull_backfaces: whether triangles are hit only from their front (`wrt.kernels.traversal.leaf.comes_from_front`).
        variant: key in `wrt.kernels.answers.VARIANTS`: whether each ray ignores one triangle, in walks that are asked for the
            nearest hit or for a count, or passes through the holes of alpha masks.
        shared_leaves: whether a triangle may be in several leaves of a BVH, so that only one of them may report a crossing
            (`wrt.kernels.traversal.crossings`).
        stack: for wide trees.
        single: for single rays.
        packet: for packets.
        stream: for streams.
        tiles: for entry points.
        persistent: for persistent threads.
    """

    triangle_test: str
    width: int
    query: str = closest_hit.KIND.name
    coherent: bool = True
    counters: bool = False
    mailbox: str = NONE
    cull_backfaces: bool = False
    variant: str = PLAIN
    shared_leaves: bool = False
    stack: StackConfig = StackConfig()
    single: SingleConfig = SingleConfig()
    packet: PacketConfig = PacketConfig()
    stream: StreamConfig = StreamConfig()
    tiles: TileConfig = TileConfig()
    persistent: PersistentConfig = PersistentConfig()

    @property
    def answer(self) -> AnswerKind:
        """What is asked of each ray."""
        return VARIANTS[self.variant](ANSWERS[self.query])
