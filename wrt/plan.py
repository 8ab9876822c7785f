"""How a query is answered: traversal, triangle test and their options, chosen from the scene, the device and the rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from wrt.rays import shares_origin
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.traversal.config import TraversalConfig
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays import RayBuffers
    from wrt.scene import Scene

AUTO = "auto"

LEAST_FOR_PACKETS = 256
"""Rays below which a packet's set-up is not worth compiling another kernel."""

RAYS_PER_TRIANGLE = 2.0
"""Rays a triangle of the scene from which on large packets pay: smaller triangles lie between the rays of a packet."""

LARGE_PACKET, SMALL_PACKET = 4, 2
"""Rays of a packet, in vectors of the tree's width."""


MAX_PACKET = 256
"""Rays of a packet at most: 16 x 16."""


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
        reason: why the traversal was chosen.
    """

    accelerator: str
    traversal: str
    triangle_test: str
    width: int
    coherent: bool
    shared_origin: bool
    packet: int
    culling: str
    reason: str

    def __str__(self) -> str:
        with_packets = f", packets of {self.packet}, {self.culling} culling" if self.packet > 1 else ""
        lanes = f"width {self.width}"
        return f"{self.accelerator}, {self.traversal}{with_packets}, {self.triangle_test}, {lanes}: {self.reason}"


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
    check_origins(test, rays)
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
        packet = packet_size(scene, rays)
        culling = "vertex" if CULLINGS["vertex"].holds_for(test) else "interval"
    return Plan(kind, way, test.name, scene.tree.width, rays.coherent, shared, packet, culling, reason)


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
    check_origins(test, rays)
    if plan.accelerator not in way.trees:
        raise ValueError(f"plan.traversal {way.name!r} does not walk a {plan.accelerator}; it walks {', '.join(way.trees)}")
    if plan.accelerator not in ("none", scene.accelerator.kind):
        raise ValueError(f"plan.accelerator is {plan.accelerator!r}, but the scene has a {scene.accelerator.kind}")
    if plan.width != scene.tree.width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {scene.tree.width}")
    if plan.shared_origin and rays.batch.origin_stride != 0:
        raise ValueError("plan.shared_origin is true, but each ray has an origin of its own; broadcast a single one")
    if plan.traversal != "packet":
        return plan
    if plan.packet < plan.width or plan.packet % plan.width or plan.packet > MAX_PACKET:
        raise ValueError(f"plan.packet is {plan.packet}; it must be a multiple of {plan.width}, at most {MAX_PACKET}")
    if not lookup(CULLINGS, plan.culling, "plan.culling").holds_for(test):
        able = ", ".join(name for name, culling in CULLINGS.items() if culling.holds_for(test))
        raise ValueError(f"plan.culling {plan.culling!r} does not hold for {test.name}; choose from {able}")
    return plan


def check_origins(test: TriangleTest, rays: RayBuffers) -> None:
    """Refuses rays that a test does not take.

    Raises:
        ValueError: the test needs a shared origin, and each ray has its own.
    """
    if test.needs_shared_origin and not shares_origin(rays):
        raise ValueError(
            f"triangle_test {test.name!r} needs rays that share their origin; pass a single point as origins, such as "
            "(0, 0, 1) or np.broadcast_to(point, directions.shape), or choose triangle_test='woop'"
        )


def choose_traversal(scene: Scene, rays: RayBuffers) -> tuple[str, str]:
    """Name of the traversal, and the reason."""
    kind = scene.accelerator.kind
    if scene.device.is_cuda:
        return "single", "a CUDA thread is a ray"
    if not rays.coherent:
        if kind == "kdtree" and rays.count >= LEAST_FOR_PACKETS:
            return "lockstep", "neighbouring rays look different"
        return "single", "neighbouring rays look different"
    if kind == "bvh" and rays.count >= LEAST_FOR_PACKETS:
        return "packet", "neighbouring rays look alike"
    return "single", "neighbouring rays look alike" if rays.count >= LEAST_FOR_PACKETS else "few rays"


def packet_size(scene: Scene, rays: RayBuffers) -> int:
    """Rays of a packet: fewer where triangles are as small as the gaps between rays, or origins differ."""
    large = rays.batch.origin_stride == 0 and rays.count >= RAYS_PER_TRIANGLE * scene.triangle_count
    return scene.tree.width * (LARGE_PACKET if large else SMALL_PACKET)


def traversal_config(plan: Plan, scene: Scene, query: str, counters: bool) -> TraversalConfig:
    """The specialisation that carries out a plan."""
    from wrt.kernels.traversal.config import TraversalConfig

    packets = {}
    if plan.packet > 1:
        packets = {"packet": plan.packet, "shared_origin": plan.shared_origin, "culling": plan.culling}
    levels = {}
    if plan.accelerator == "bvh":
        levels = {"levels": stack_levels(scene.tree.depth)}
    return TraversalConfig(plan.triangle_test, plan.width, query, plan.coherent, counters, **levels, **packets)


def stack_levels(depth: int) -> int:
    """Room for the tree's depth in steps of 8 levels, so that few specialisations serve all trees."""
    return -(-depth // 8) * 8


def way_of(plan: Plan) -> Traversal:
    """The plan's entry in the table of traversals."""
    from wrt.kernels.traversal import TRAVERSALS

    return TRAVERSALS[plan.traversal]
