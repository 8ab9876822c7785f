"""Traversals: one file per algorithm, and the table of them.

**Contract.** For a frozen `TraversalConfig`, a traversal makes a kernel with the parameters `(first, tree, triangles, rays,
hits, counters)`: `tree` is the struct of the tree kind, `triangles` are the blocks to which its leaves refer, `rays` and `hits`
are structs of `wrt.kernels.layout.ray_batch`, `counters` is written only if the config enables it. One skeleton serves every
kind of query (`wrt.kernels.answers`) through `wp.static` switches. All traversals find the closest hit and any hit; other kinds
are answered by those that can offer each hit, `each_hit` (`wrt.kernels.traversal.crossings`). Every traversal gives the
same hits to the bit (`wrt.kernels.simd.boxes`, the consistency rule); ties go to the smaller t, then to the smaller primitive
id.

Kernels elsewhere that are built around the walk of one ray (`wrt.kernels.query.device_functions`,
`wrt.kernels.query.exact_closest`) take it from `walk_table`.

Scenes of instances have two-level kernels made of the same parts: `instance_single`, `instance_packets` and
`instance_streams` in `wrt.kernels.traversal.two_level`.

To add a traversal, write its file and add one line to `TRAVERSALS`; tests, command line and benchmarks use the table. The entry
says what the traversal can do, and scores itself for "auto" (`wrt.kernels.traversal.traversal_scores`). No other code asks for
a traversal's name.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import warp as wp

from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout import binary_nodes
from wrt.kernels.on_demand import OnDemand
from wrt.kernels.traversal.brute_force import make_brute_force_kernel
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.interleaved.interleaved_bvh import make_interleaved_bvh_kernel
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.lockstep import lockstep_kernel as lockstep
from wrt.kernels.traversal.packet.core import packet_kernel
from wrt.kernels.traversal.packet.core.packet_bvh import make_packet_bvh_kernel
from wrt.kernels.traversal.packet.core.packet_kdtree import make_packet_kdtree_kernel
from wrt.kernels.traversal.persistent.persistent_bvh import ANSWER_CLASSES, make_persistent_kernel
from wrt.kernels.traversal.queued.queued_bvh import make_queued_bvh_kernel
from wrt.kernels.traversal.single.single_bvh import make_single_bvh_kernel
from wrt.kernels.traversal.single.single_kdtree import make_single_kdtree_kernel
from wrt.kernels.traversal.stream import stream_kernel as stream
from wrt.kernels.traversal.stream.stream_bvh import make_stream_bvh_kernel
from wrt.kernels.traversal.stream.stream_kdtree import make_stream_kdtree_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.traversal_scores import (
    Score,
    score_interleaved,
    score_lockstep,
    score_packet,
    score_persistent,
    score_single,
    score_stream,
    score_wide_packet,
    score_wide_stream,
)

AS_GIVEN, CELLS, TILES = "none", "cells", "tiles"
ORDERS = (AS_GIVEN, CELLS, TILES)
"""Orders in which rays are traced (`wrt.kernels.query.ordering.ray_order`): as they are given; sorted by the cell of the origin
and the octant of the direction; the pixels of an image, tile by tile.
"""


def one_ray(config: TraversalConfig) -> int:
    """Rays per item of a kernel that traces one ray per item."""
    return 1


@dataclass(frozen=True)
class OnTree:
    """What a traversal does on one kind of tree.

    Attributes:
        make_kernel: config -> kernel.
        each_hit: whether it can offer each hit, so that it answers every kind of query; else it answers the `nearest` ones.
        instances: whether it traces rays through instances of geometries with such trees: one by one, for all that it answers
            on them; else for what parts can answer (`merge` of `wrt.kernels.answers`).
        kinds: the only kinds of query that it answers; None for no limit.
    """

    make_kernel: Callable[[TraversalConfig], wp.Kernel]
    each_hit: bool = False
    instances: bool = False
    kinds: frozenset[str] | None = None

    def supports(self, query: str) -> bool:
        """Whether it answers a query."""
        return (self.kinds is None or query in self.kinds) and (self.each_hit or ANSWERS[query].nearest)


@dataclass(frozen=True)
class Traversal:
    """A traversal algorithm.

    Attributes:
        name: key in `TRAVERSALS`.
        paper: authors, title, year.
        on: what it does on each tree kind that it supports: "kdtree", "bvh" or "none" (all triangles).
        rays_per_item: config -> number of consecutive rays that one item of the kernel traces; the last item may have fewer.
        capabilities: what it can do.
        orders: those of `ORDERS` in which it can trace rays.
        triangle_tests: keys in `wrt.kernels.triangle.TRIANGLE_TESTS` of those that it can use; None for all.
        width: children that the nodes of its trees have; None for any number.
        counters: struct of the work counters that its kernels write, at the first ray of an item.
        score: how well it suits a query; None if "auto" never chooses it.
    """

    name: str
    paper: str
    on: Mapping[str, OnTree]
    rays_per_item: Callable[[TraversalConfig], int] = one_ray
    capabilities: Capabilities = Capabilities.NONE
    orders: tuple[str, ...] = (AS_GIVEN, CELLS)
    triangle_tests: tuple[str, ...] | None = None
    width: int | None = None
    counters: type = Counters
    score: Score | None = None

    def supports(self, query: str, tree: str) -> bool:
        """Whether it answers a query on a tree kind."""
        return tree in self.on and self.on[tree].supports(query)

    def takes_test(self, triangle_test: str) -> bool:
        """Whether it can use a triangle test."""
        return self.triangle_tests is None or triangle_test in self.triangle_tests

    def culls_backfaces(self, tree: str) -> bool:
        """Whether it can cull back faces on a tree kind.

        Traversals that answer every query can, because they test hits one by one; so can those that say so (`FRONT_FACES`).
        """
        return tree in self.on and (Capabilities.FRONT_FACES in self.capabilities or self.on[tree].each_hit)

    def supports_through_instances(self, query: str, tree: str, is_cuda: bool) -> bool:
        """Whether it answers a query through instances whose trees are of a kind."""
        merges = self.walks_single_rays or ANSWERS[query].stored.merge is not None
        runs = Capabilities.CUDA_INSTANCES in self.capabilities or not is_cuda
        return self.supports(query, tree) and self.on[tree].instances and merges and runs

    def has_mailbox(self, tree: str) -> bool:
        """Whether it can use a mailbox on a tree kind: only a kd-tree has triangles in several leaves."""
        return Capabilities.MAILBOX in self.capabilities and tree == "kdtree"

    def walks_boxes(self, tree: str) -> bool:
        """Whether the nodes that it walks on a tree kind are boxes: those of a BVH, or of the wide form of a kd-tree."""
        return Capabilities.WIDE_FORM in self.capabilities or tree == "bvh"

    @property
    def needs_shared_origin(self) -> bool:
        """Whether all rays of a batch must start at the same point."""
        return Capabilities.SHARED_ORIGIN in self.capabilities

    @property
    def walks_tree(self) -> bool:
        """Whether it walks a tree, as opposed to testing every triangle."""
        return "none" not in self.on

    @property
    def walks_single_rays(self) -> bool:
        """Whether each ray walks the tree on its own, so that any number of them can be launched."""
        return self.walks_tree and self.rays_per_item is one_ray

    @property
    def trees(self) -> tuple[str, ...]:
        """Tree kinds that it supports."""
        return tuple(self.on)

    @property
    def kernels(self) -> dict[str, Callable[[TraversalConfig], wp.Kernel]]:
        """config -> kernel, for each tree kind."""
        return {tree: on.make_kernel for tree, on in self.on.items()}


TRAVERSALS: dict[str, Traversal] = {
    traversal.name: traversal
    for traversal in (
        Traversal(
            "brute",
            "every ray against every triangle",
            {"none": OnTree(make_brute_force_kernel, each_hit=True)},
            capabilities=Capabilities.OWN_SPACES | Capabilities.SHARED_LEAVES | Capabilities.POINTS,
        ),
        Traversal(
            "single",
            "Havran: Heuristic ray shooting algorithms (2001); Wald, Benthin, Boulos: Getting rid of packets (2008)",
            {
                "kdtree": OnTree(make_single_kdtree_kernel, each_hit=True, instances=True),
                "bvh": OnTree(make_single_bvh_kernel, each_hit=True, instances=True),
            },
            capabilities=(
                Capabilities.MAILBOX
                | Capabilities.NODE_ORDERS
                | Capabilities.OWN_SPACES
                | Capabilities.SHARED_LEAVES
                | Capabilities.ALPHA_MASKS
                | Capabilities.CUDA_INSTANCES
                | Capabilities.POINTS
            ),
            score=score_single,
        ),
        Traversal(
            "persistent",
            "Aila, Laine: Understanding the efficiency of ray traversal on GPUs (2009)",
            {"bvh": OnTree(make_persistent_kernel, each_hit=True, instances=True, kinds=frozenset(ANSWER_CLASSES))},
            capabilities=Capabilities.PERSISTENT | Capabilities.CUDA_INSTANCES,
            orders=(AS_GIVEN,),
            triangle_tests=("woop",),
            width=binary_nodes.WIDTH,
            score=score_persistent,
        ),
        Traversal(
            "lockstep",
            "after Foley, Sugerman: KD-tree acceleration structures for a GPU raytracer (2005), with a stack, on CPU lanes",
            {"kdtree": OnTree(lockstep.make_lockstep_kernel)},
            lockstep.rays_per_item,
            score=score_lockstep,
        ),
        Traversal(
            "packet",
            "Wald et al.: Interactive rendering with coherent ray tracing (2001); "
            "Reshetov, Soupikov, Hurley: Multi-level ray tracing algorithm (2005)",
            {"bvh": OnTree(make_packet_bvh_kernel, instances=True), "kdtree": OnTree(make_packet_kdtree_kernel)},
            packet_kernel.rays_per_item,
            capabilities=Capabilities.PACKETS | Capabilities.NON_TEMPORAL | Capabilities.LONG_ITEMS | Capabilities.MAILBOX,
            orders=(AS_GIVEN, CELLS, TILES),
            score=score_packet,
        ),
        Traversal(
            "repacked_packet",
            "Boulos, Wald, Benthin: Adaptive ray packet reordering (2008)",
            {"bvh": OnTree(OnDemand("traversal.repacked_bvh", "make_repacked_bvh_kernel"))},
            packet_kernel.rays_per_item,
            capabilities=Capabilities.PACKETS | Capabilities.LONG_ITEMS,
            orders=(AS_GIVEN, CELLS, TILES),
        ),
        Traversal(
            "multi_frusta",
            "Benthin, Wald: Efficient ray traced soft shadows using multi-frusta tracing (2009), for rays from one point",
            {"bvh": OnTree(OnDemand("traversal.eye_frusta", "make_eye_frusta_kernel"))},
            OnDemand("traversal.eye_frusta", "rays_per_item"),
            capabilities=Capabilities.PACKETS | Capabilities.ONE_VECTOR | Capabilities.SHARED_ORIGIN | Capabilities.FRONT_FACES,
            orders=(AS_GIVEN, TILES),
        ),
        Traversal(
            "mlrta",
            "Reshetov, Soupikov, Hurley: Multi-level ray tracing algorithm (2005)",
            {"kdtree": OnTree(OnDemand("traversal.entry_point", "make_mlrta"))},
            OnDemand("traversal.entry_point", "rays_per_item"),
            capabilities=Capabilities.PACKETS | Capabilities.MAILBOX,
            orders=(AS_GIVEN,),
        ),
        Traversal(
            "aepsa",
            "Fowler, Collins, Manzke: Accelerated entry point search algorithm for real-time ray-tracing (2009)",
            {"kdtree": OnTree(OnDemand("traversal.entry_point", "make_aepsa"))},
            OnDemand("traversal.entry_point", "rays_per_item"),
            capabilities=Capabilities.PACKETS | Capabilities.MAILBOX,
            orders=(AS_GIVEN,),
        ),
        Traversal(
            "omnidirectional",
            "Reshetov: Omnidirectional ray tracing traversal algorithm for kd-trees (2006)",
            {"kdtree": OnTree(OnDemand("traversal.omnidirectional", "make_omnidirectional_kernel"))},
            OnDemand("traversal.omnidirectional", "rays_per_item"),
            capabilities=Capabilities.PACKETS | Capabilities.MAILBOX,
            orders=(AS_GIVEN,),
        ),
        Traversal(
            "stream",
            "Wald, Gribble, Boulos, Kensler: SIMD ray stream tracing (2007); "
            "Gribble, Ramani: Coherent ray tracing via stream filtering (2008)",
            {"kdtree": OnTree(make_stream_kdtree_kernel), "bvh": OnTree(make_stream_bvh_kernel, each_hit=True, instances=True)},
            stream.rays_per_item,
            capabilities=(Capabilities.STREAMS | Capabilities.LONG_STREAMS | Capabilities.LONG_ITEMS | Capabilities.POINTS),
            counters=stream.StreamCounters,
            score=score_stream,
        ),
        Traversal(
            "interleaved",
            "single rays that take turns, after Barringer, Akenine-Möller: Dynamic ray stream traversal (2014), "
            "and Fuetterling, Lojewski, Pfreundt, Ebert: Accelerated single ray tracing for wide vector units (2017)",
            {"bvh": OnTree(make_interleaved_bvh_kernel, each_hit=True)},
            stream.rays_per_item,
            capabilities=(
                Capabilities.STREAMS
                | Capabilities.LONG_STREAMS
                | Capabilities.LONG_ITEMS
                | Capabilities.SHORT_ITEMS
                | Capabilities.POINTS
            ),
            orders=(AS_GIVEN,),
            counters=stream.StreamCounters,
            score=score_interleaved,
        ),
        Traversal(
            "queued",
            "Pharr, Kolb, Gershbein, Hanrahan: Rendering complex scenes with memory-coherent ray tracing (1997); "
            "Navrátil, Fussell, Lin, Mark: Dynamic ray scheduling to improve ray coherence and bandwidth utilization (2007)",
            {"bvh": OnTree(make_queued_bvh_kernel, each_hit=True)},
            capabilities=Capabilities.QUEUED,
        ),
        Traversal(
            "wide_stream",
            "stream through the cells of a kd-tree in nodes of W, after Popov, Georgiev, Dimov, Slusallek: "
            "Object partitioning considered harmful: space subdivision for BVHs (2009)",
            {"kdtree": OnTree(make_stream_bvh_kernel)},
            stream.rays_per_item,
            capabilities=Capabilities.STREAMS | Capabilities.LONG_STREAMS | Capabilities.LONG_ITEMS | Capabilities.WIDE_FORM,
            counters=stream.StreamCounters,
            score=score_wide_stream,
        ),
        Traversal(
            "wide_packet",
            "packet through the same",
            {"kdtree": OnTree(make_packet_bvh_kernel)},
            packet_kernel.rays_per_item,
            capabilities=Capabilities.PACKETS | Capabilities.NON_TEMPORAL | Capabilities.LONG_ITEMS | Capabilities.WIDE_FORM,
            orders=(AS_GIVEN, TILES),
            score=score_wide_packet,
        ),
    )
}
"""Traversals by name."""
