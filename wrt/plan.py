"""How a query is answered: traversal, triangle test and their options, chosen from the scene, the device and the rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from wrt.kernels.launch import get_num_threads
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.traversal.config import TraversalConfig
    from wrt.kernels.triangle.records import Record
    from wrt.rays import RayBuffers
    from wrt.scene import Scene

AUTO = "auto"
CLOSEST, ANY = "closest", "any"

ALIKE, DIFFERENT = "neighbouring rays look alike", "neighbouring rays look different"

LEAST_FOR_PACKETS = 256
"""Rays below which a packet's set-up is not worth compiling another kernel."""

PACKET_VECTORS = 2
"""Rays of a packet, in vectors of the tree's width. Of 1, 2, 4 and 8, measured with 16 lanes, 2 was best or within 5 % of
it for views and shadow rays of the bunny, the dragon (two sizes) and the atrium."""


MAX_PACKET = 256
"""Rays of a packet at most: 16 x 16."""

STREAMS, CUDA_STREAM = (4096, 1024, 256), 64
"""Rays of a stream: the longer, the better its lanes are used, as long as each thread has several. On CUDA, where a stream
is a thread's, they lie in its local memory."""

STREAMS_PER_THREAD = 4

MAX_STREAM = 4096
"""Rays of a stream at most: 64 x 64."""


LEAST_TO_REORDER = 1 << 16
"""Rays from which on sorting them pays."""

CACHED_BYTES = 1 << 24
"""Triangle records that are in reach of a core: rays that meet no more of them need no order."""

RAYS_PER_TRIANGLE = 2.0
"""Rays a triangle of the scene from which on coherent rays with origins of their own go in packets: where triangles are as
small as the gaps between rays, streams lose less on rays that part company."""


@dataclass(frozen=True)
class Plan:
    """What answers a query. `dataclasses.replace` makes another one of it, which goes where the name of a traversal goes.

    Attributes:
        accelerator: kind of the scene's tree, "bvh" or "kdtree"; "none" where every triangle is tested.
        traversal: key in `wrt.kernels.traversal.TRAVERSALS`.
        triangle_test: key in `wrt.kernels.triangle.TRIANGLE_TESTS`.
        width: triangles tested at once, and children a node.
        coherent: whether neighbouring rays were found to look alike.
        shared_origin: whether all rays start at the same point.
        packet: rays that go together; 1 if every ray goes alone.
        culling: key in `wrt.kernels.packet.CULLINGS`; empty without packets.
        reorder: whether rays are traced by cell of the origin and octant of the direction (`wrt.kernels.reorder`).
        reason: why the traversal was chosen.
        stream: rays of a stream; 1 without streams.
    """

    accelerator: str
    traversal: str
    triangle_test: str
    width: int
    coherent: bool
    shared_origin: bool
    packet: int
    culling: str
    reorder: bool
    reason: str
    stream: int = 1

    def __str__(self) -> str:
        together = ""
        if self.packet > 1:
            together = f", packets of {self.packet}, {self.culling} culling"
        elif self.stream > 1:
            together = f", streams of {self.stream}"
        more = f"{together}, reordered" if self.reorder else together
        return f"{self.accelerator}, {self.traversal}{more}, {self.triangle_test}, width {self.width}: {self.reason}"


def make_plan(scene: Scene, rays: RayBuffers, traversal: str | Plan, triangle_test: str) -> Plan:
    """Chooses what the caller left on "auto"; a plan that is given is checked.

    Raises:
        ValueError: an unknown name, a traversal that does not walk the scene's tree, or a plan that does not fit.
    """
    if isinstance(traversal, Plan):
        return check_plan(traversal, scene, rays)
    from wrt.kernels.packet import CULLINGS
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    test = TRIANGLE_TESTS["woop"] if triangle_test == AUTO else lookup(TRIANGLE_TESTS, triangle_test, "triangle_test")
    kind = scene.accelerator.kind
    if traversal == AUTO:
        way, reason = choose_traversal(scene, rays)
    else:
        way, reason = lookup(TRAVERSALS, traversal, "traversal").name, "as asked"
    trees = TRAVERSALS[way].trees
    if trees == ("none",):
        kind = "none"
    elif kind not in trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if kind in entry.trees)
        other = f"build the scene with accelerator={trees[0]!r}"
        raise ValueError(f"traversal {way!r} does not walk a {kind}; {other}, or choose from auto, {able}")
    shared = rays.batch.origin_stride == 0
    packet, culling = 1, ""
    if way == "packet":
        packet = PACKET_VECTORS * scene.tree.width
        culling = "vertex" if CULLINGS["vertex"].holds_for(test) else "interval"
    stream = stream_size(scene, rays) if way == "stream" else 1
    reorder = traversal == AUTO and way != "packet" and rays.scattered and is_large(scene, rays, test.record)
    return Plan(kind, way, test.name, scene.tree.width, rays.coherent, shared, packet, culling, reorder, reason, stream)


def stream_size(scene: Scene, rays: RayBuffers) -> int:
    """Rays of a stream: fewer where a batch would not give each thread several streams."""
    if scene.device.is_cuda:
        return CUDA_STREAM
    share = rays.count / (STREAMS_PER_THREAD * get_num_threads())
    return next((size for size in STREAMS if size <= share), STREAMS[-1])


def is_large(scene: Scene, rays: RayBuffers, record: Record) -> bool:
    """Whether so many rays meet so many triangles that it pays to sort the rays first."""
    return rays.count >= LEAST_TO_REORDER and len(scene.tree.primitive) * 4 * record.components >= CACHED_BYTES


def check_plan(plan: Plan, scene: Scene, rays: RayBuffers) -> Plan:
    """Returns a plan that suits the scene and the rays.

    Raises:
        ValueError: it does not; the message names the field.
    """
    from wrt.kernels.packet import CULLINGS
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    way = lookup(TRAVERSALS, plan.traversal, "plan.traversal")
    test = lookup(TRIANGLE_TESTS, plan.triangle_test, "plan.triangle_test")
    if plan.accelerator not in way.trees:
        raise ValueError(f"plan.traversal {way.name!r} does not walk a {plan.accelerator}; it walks {', '.join(way.trees)}")
    if plan.accelerator not in ("none", scene.accelerator.kind):
        raise ValueError(f"plan.accelerator is {plan.accelerator!r}, but the scene has a {scene.accelerator.kind}")
    if plan.width != scene.tree.width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {scene.tree.width}")
    if plan.shared_origin and rays.batch.origin_stride != 0:
        raise ValueError("plan.shared_origin is true, but each ray has an origin of its own; broadcast a single one")
    if plan.traversal == "stream" and not 1 <= plan.stream <= MAX_STREAM:
        raise ValueError(f"plan.stream is {plan.stream}; it must be from 1 to {MAX_STREAM}")
    if plan.traversal != "packet":
        return plan
    if plan.packet < plan.width or plan.packet % plan.width or plan.packet > MAX_PACKET:
        raise ValueError(f"plan.packet is {plan.packet}; it must be a multiple of {plan.width}, at most {MAX_PACKET}")
    if not lookup(CULLINGS, plan.culling, "plan.culling").holds_for(test):
        able = ", ".join(name for name, culling in CULLINGS.items() if culling.holds_for(test))
        raise ValueError(f"plan.culling {plan.culling!r} does not hold for {test.name}; choose from {able}")
    return plan


def choose_traversal(scene: Scene, rays: RayBuffers) -> tuple[str, str]:
    """Name of the traversal, and the reason."""
    kind = scene.accelerator.kind
    if scene.device.is_cuda:
        return "single", "a CUDA thread is a ray"
    if rays.count < LEAST_FOR_PACKETS:
        return "single", "few rays"
    if kind == "kdtree":
        return ("single", ALIKE) if rays.coherent else ("lockstep", DIFFERENT)
    if not rays.coherent:
        return "stream", DIFFERENT
    if rays.batch.origin_stride != 0 and rays.count < RAYS_PER_TRIANGLE * scene.triangle_count:
        return "stream", f"{ALIKE}, but each has its own origin and triangles are small"
    return "packet", ALIKE


def traversal_config(plan: Plan, scene: Scene, query: str, counters: bool) -> TraversalConfig:
    """The specialisation that carries out a plan."""
    from wrt.kernels.traversal.config import TraversalConfig

    group = {}
    if plan.packet > 1:
        group = {"packet": plan.packet, "shared_origin": plan.shared_origin, "culling": plan.culling}
    if plan.traversal == "stream":
        group = {"stream": plan.stream}
    levels = {}
    if plan.accelerator == "bvh":
        levels = {"levels": stack_levels(scene.tree.depth)}
    return TraversalConfig(plan.triangle_test, plan.width, query, plan.coherent, counters, **levels, **group)


def stack_levels(depth: int) -> int:
    """Room for the tree's depth in steps of 8 levels, so that few specialisations serve all trees."""
    return -(-depth // 8) * 8


def way_of(plan: Plan) -> Traversal:
    """The plan's entry in the table of traversals."""
    from wrt.kernels.traversal import TRAVERSALS

    return TRAVERSALS[plan.traversal]
