"""How a query is answered: traversal, triangle test and their options, chosen from the scene, the device and the rays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from wrt.kernels.launch import CUDA_BLOCK, get_num_threads
from wrt.rays import shares_origin
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.kernels.packet import Culling
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.traversal.config import TraversalConfig
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays import RayBuffers
    from wrt.scene import Scene

AUTO = "auto"
CLOSEST, ANY, COUNT, ALL, EXACT = "closest", "any", "count", "all", "exact"

ALIKE, DIFFERENT = "neighbouring rays look alike", "neighbouring rays look different"

DEFAULT_TEST = "woop"
"""The triangle test of "auto". Of all tests that `wrt bench triangle-tests` compares it is the only watertight one. With a tree
it is the fastest for views, and costs 2 to 6 % against Moeller and Trumbore's for single and for random rays; Komatsu's, at
half the operations, is no faster, and its records are made again for each origin."""

LEAST_FOR_PACKETS = 256
"""Rays below which the set-up of packets and streams is not worth compiling another kernel."""

PACKET_VECTORS = 2
"""Rays of a packet, in vectors of the tree's width. Of 1, 2, 4 and 8, measured with 16 lanes, 2 was best or within 5 % of
it for views and shadow rays of the bunny, the dragon (two sizes) and the atrium."""

MAX_PACKET = 256
"""Rays of a packet at most: 16 x 16."""

RAYS_PER_TRIANGLE = 2.0
"""Rays a triangle of the scene from which on coherent rays with origins of their own go in packets: where triangles are as
small as the gaps between rays, streams lose less on rays that part company."""

STREAMS, CUDA_STREAM = (4096, 1024, 256), 64
"""Rays of a stream: the longer, the better its lanes are used, as long as each thread has several. On CUDA, where a stream
is a thread's, they lie in its local memory."""

STREAMS_PER_THREAD = 4

MAX_STREAM = 4096
"""Rays of a stream at most: 64 x 64."""

LEAST_TO_REORDER = 1 << 16
"""Rays from which on sorting them pays."""

ORDERS = ("none", "cells", "tiles")

CACHED_BYTES = 1 << 24
"""Triangle records that are in reach of a core: rays that meet no more of them need no order."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What answers a query. `dataclasses.replace` makes another one of it, which goes where the name of a traversal goes.

    Attributes:
        accelerator: kind of the scene's tree, "bvh" or "kdtree"; "none" where every triangle is tested.
        traversal: key in `wrt.kernels.traversal.TRAVERSALS`.
        triangle_test: key in `wrt.kernels.triangle.TRIANGLE_TESTS`.
        width: triangles tested at once, and children a node.
        coherent: whether neighbouring rays were found to look alike.
        shared_origin: whether all rays start at the same point.
        reason: why the traversal was chosen.
        packet: rays that go together; 1 if every ray goes alone.
        culling: key in `wrt.kernels.packet.CULLINGS`; empty without packets.
        stream: rays of a stream; 1 without streams.
        mailbox: key in `wrt.kernels.mailbox.MAILBOXES`; "none" on trees in which no triangle is in two leaves.
        reorder: order in which rays are traced (`wrt.kernels.reorder`): "none", their own; "cells", by cell of the origin
            and octant of the direction; "tiles", the rows and columns of a picture tile by tile, in packets.
        cull_backfaces: whether triangles are hit only by rays that come from their front.
        one_by_one: whether a single ray meets the triangles of a leaf one after the other, by the triangle test's scalar form,
            in place of a block of them at once: for measurements.
    """

    accelerator: str
    traversal: str
    triangle_test: str
    width: int
    coherent: bool
    shared_origin: bool
    reason: str
    packet: int = 1
    culling: str = ""
    stream: int = 1
    mailbox: str = "none"
    reorder: str = "none"
    cull_backfaces: bool = False
    one_by_one: bool = False

    def __str__(self) -> str:
        parts = [self.accelerator, self.traversal]
        if self.packet > 1:
            parts += [f"packets of {self.packet}", f"{self.culling} culling"]
        if self.stream > 1:
            parts.append(f"streams of {self.stream}")
        if self.mailbox != "none":
            parts.append(f"{self.mailbox} mailbox")
        if self.reorder != "none":
            parts.append(f"in {self.reorder}")
        if self.one_by_one:
            parts.append("triangles one by one")
        if self.cull_backfaces:
            parts.append("front faces only")
        return ", ".join([*parts, self.triangle_test, f"width {self.width}"]) + f": {self.reason}"


def make_plan(
    scene: Scene,
    rays: RayBuffers,
    traversal: str | Plan,
    triangle_test: str,
    query: str = CLOSEST,
    cull_backfaces: bool = False,
) -> Plan:
    """Chooses what the caller left on "auto"; a plan that is given is checked.

    Raises:
        ValueError: an unknown name, a traversal that does not walk the scene's tree or answer the query, or a plan that does
            not fit.
    """
    if isinstance(traversal, Plan):
        culled = cull_backfaces or traversal.cull_backfaces
        return check_plan(replace(traversal, cull_backfaces=culled), scene, rays, query)
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    test = lookup(TRIANGLE_TESTS, default_test(scene, query) if triangle_test == AUTO else triangle_test, "triangle_test")
    check_origins(test, rays)
    name, reason = choose_traversal(scene, rays, query, cull_backfaces) if traversal == AUTO else (traversal, "as asked")
    way = lookup(TRAVERSALS, name, "traversal")
    accelerator = tree_for(way, scene)
    check_query(query, way, accelerator, test)
    check_culling(cull_backfaces, way, accelerator)
    if scene.instances:
        from wrt.instance_plan import check_instances

        check_instances(scene, query, way, test)
    options: dict[str, object] = {}
    if way.packets:
        options["packet"] = PACKET_VECTORS * scene.width
        options["culling"] = choose_culling(scene, rays, test)
    if way.streams:
        options["stream"] = stream_size(scene, rays)
    if traversal == AUTO or way.name == "packet":
        options["reorder"] = choose_order(scene, rays, way, test)
    return Plan(
        accelerator=accelerator,
        traversal=way.name,
        triangle_test=test.name,
        width=scene.width,
        coherent=rays.coherent,
        shared_origin=rays.batch.origin_stride == 0 and not scene.instances,
        reason=reason,
        cull_backfaces=cull_backfaces,
        **options,
    )


def default_test(scene: Scene, query: str) -> str:
    """Name of the triangle test of a query that asks for none: the scene's; counts are left to one that can count."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    if scene.triangle_test == AUTO or (query in (COUNT, ALL) and TRIANGLE_TESTS[scene.triangle_test].crossing is None):
        return DEFAULT_TEST
    return scene.triangle_test


def choose_traversal(scene: Scene, rays: RayBuffers, query: str, cull_backfaces: bool = False) -> tuple[str, str]:
    """Name of the traversal, and the reason."""
    if scene.device.is_cuda:
        return "single", "a CUDA thread is a ray"
    if rays.count < LEAST_FOR_PACKETS:
        return "single", "few rays"
    if scene.instances:
        from wrt.instance_plan import choose_for_instances

        return choose_for_instances(scene, rays, query, cull_backfaces)
    if query in (COUNT, ALL) or cull_backfaces:
        what = "all hits" if query in (COUNT, ALL) else "front faces"
        is_bvh = scene.accelerator.kind == "bvh"
        return ("stream", f"{what} of many rays") if is_bvh else ("single", f"what finds {what} on a kd-tree")
    if scene.accelerator.kind == "kdtree":
        return ("packet", ALIKE) if rays.coherent else ("lockstep", DIFFERENT)
    if not rays.coherent:
        return "stream", DIFFERENT
    if rays.batch.origin_stride != 0 and rays.count < RAYS_PER_TRIANGLE * scene.triangle_count:
        return "stream", f"{ALIKE}, but each has its own origin and triangles are small"
    return "packet", ALIKE


def tree_for(way: Traversal, scene: Scene) -> str:
    """Kind of tree that a traversal walks in a scene.

    Raises:
        ValueError: none that the scene has.
    """
    from wrt.kernels.traversal import TRAVERSALS

    kind = scene.accelerator.kind
    if way.trees == ("none",):
        return "none"
    if kind not in way.trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if kind in entry.trees)
        other = f"build the scene with accelerator={way.trees[0]!r}"
        raise ValueError(f"traversal {way.name!r} does not walk a {kind}; {other}, or choose from auto, {able}")
    return kind


def stream_size(scene: Scene, rays: RayBuffers) -> int:
    """Rays of a stream: fewer where a batch would not give each thread several streams."""
    if scene.device.is_cuda:
        return CUDA_STREAM
    share = rays.count / max(STREAMS_PER_THREAD * get_num_threads(), len(scene.instances))
    return next((size for size in STREAMS if size <= share), STREAMS[-1])


def choose_culling(scene: Scene, rays: RayBuffers, test: TriangleTest) -> str:
    """Name of the culling: the rays that meet a leaf are worth a look of their own where packets are wide."""
    if not test.accurate:
        return "interval"
    shared = rays.batch.origin_stride == 0 and not scene.instances
    return "vertex" if shared or scene.accelerator.kind != "bvh" else "transient_frustum"


def choose_order(scene: Scene, rays: RayBuffers, way: Traversal, test: TriangleTest) -> str:
    """Order of tracing."""
    if way.name == "packet":
        return "tiles" if rays.columns > 0 else "none"
    return "cells" if rays.scattered and is_large(scene, rays, test) else "none"


def is_large(scene: Scene, rays: RayBuffers, test: TriangleTest) -> bool:
    """Whether so many rays meet so many triangles that it pays to sort the rays first."""
    return rays.count >= LEAST_TO_REORDER and len(scene.tree.primitive) * 4 * test.record.components >= CACHED_BYTES


def check_plan(plan: Plan, scene: Scene, rays: RayBuffers, query: str) -> Plan:
    """Returns a plan that suits the scene and the rays.

    Raises:
        ValueError: it does not; the message names the field.
    """
    from wrt.kernels.mailbox import MAILBOXES
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
    check_query(query, way, plan.accelerator, test)
    check_culling(plan.cull_backfaces, way, plan.accelerator)
    if scene.instances:
        from wrt.instance_plan import check_instances

        check_instances(scene, query, way, test)
    if plan.width != scene.width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {scene.width}")
    if plan.shared_origin and (rays.batch.origin_stride != 0 or scene.instances):
        raise ValueError(
            "plan.shared_origin is true, but rays have origins of their own; broadcast a single one, without instances"
        )
    lookup(MAILBOXES, plan.mailbox, "plan.mailbox")
    if plan.mailbox != "none" and not (way.mailbox and plan.accelerator == "kdtree"):
        able = ", ".join(name for name, entry in TRAVERSALS.items() if entry.mailbox)
        raise ValueError(f"plan.mailbox is {plan.mailbox!r}; mailboxes go with a kdtree and one of {able}")
    if plan.mailbox != "none" and query in (COUNT, ALL):
        raise ValueError(
            f"plan.mailbox is {plan.mailbox!r}, but the query {query!r} has to meet a triangle in every leaf; use 'none'"
        )
    lookup(dict.fromkeys(ORDERS), plan.reorder, "plan.reorder")
    if plan.reorder == "tiles" and plan.traversal != "packet":
        raise ValueError(f"plan.reorder is 'tiles', which goes with the traversal 'packet', not {plan.traversal!r}")
    if plan.reorder == "cells" and way.packets:
        raise ValueError("plan.reorder is 'cells', which goes with rays that do not go in packets")
    if plan.reorder == "tiles" and rays.columns == 0:
        raise ValueError(f"plan.reorder is 'tiles', but the rays' shape {rays.shape} has no rows and columns to speak of")
    if plan.one_by_one and plan.traversal != "single":
        raise ValueError(f"plan.one_by_one goes with the traversal 'single', not {plan.traversal!r}")
    if way.streams and not 1 <= plan.stream <= MAX_STREAM:
        raise ValueError(f"plan.stream is {plan.stream}; it must be from 1 to {MAX_STREAM}")
    if not way.packets:
        return plan
    if plan.packet < plan.width or plan.packet % plan.width or plan.packet > MAX_PACKET:
        raise ValueError(f"plan.packet is {plan.packet}; it must be a multiple of {plan.width}, at most {MAX_PACKET}")
    fitting = {name: c for name, c in CULLINGS.items() if c.holds_for(test) and fits(c, plan.accelerator)}
    if lookup(CULLINGS, plan.culling, "plan.culling").name not in fitting:
        able = ", ".join(fitting)
        raise ValueError(
            f"plan.culling {plan.culling!r} does not hold for {test.name} on a {plan.accelerator}; choose from {able}"
        )
    return plan


def fits(culling: Culling, tree: str) -> bool:
    """Whether a culling has what it needs in a kind of tree."""
    return tree == "bvh" or not culling.needs_boxes


def check_query(query: str, way: Traversal, tree: str, test: TriangleTest) -> None:
    """Refuses a traversal or a triangle test that cannot answer a query.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    if not way.answers(query, tree):
        able = ", ".join(
            name
            for name, entry in TRAVERSALS.items()
            for kind in (tree, "none")
            if kind in entry.trees and entry.answers(query, kind)
        )
        raise ValueError(f"traversal {way.name!r} does not answer the query {query!r} on a {tree}; choose from auto, {able}")
    if query in (COUNT, ALL) and test.crossing is None:
        able = ", ".join(name for name, entry in TRIANGLE_TESTS.items() if entry.crossing is not None)
        raise ValueError(
            f"triangle_test {test.name!r} may count a crossing at an edge twice or never; choose from auto, {able}"
        )


def check_culling(cull_backfaces: bool, way: Traversal, tree: str) -> None:
    """Refuses a traversal that cannot tell the sides of triangles.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    from wrt.kernels.traversal import TRAVERSALS

    if cull_backfaces and not way.culls_backfaces(tree):
        able = ", ".join(
            name for name, entry in TRAVERSALS.items() if entry.culls_backfaces(tree) or entry.culls_backfaces("none")
        )
        raise ValueError(f"traversal {way.name!r} does not cull back faces on a {tree}; choose from auto, {able}")


def check_origins(test: TriangleTest, rays: RayBuffers) -> None:
    """Refuses rays that a test does not take.

    Raises:
        ValueError: the test needs a shared origin, and each ray has its own.
    """
    if test.needs_shared_origin and not shares_origin(rays.batch):
        raise ValueError(
            f"triangle_test {test.name!r} needs rays that share their origin; pass a single point as origins, such as "
            "(0, 0, 1) or np.broadcast_to(point, directions.shape), or choose triangle_test='woop'"
        )


def traversal_config(plan: Plan, scene: Scene, query: str, counters: bool) -> TraversalConfig:
    """The specialisation that carries out a plan."""
    from wrt.kernels.traversal.config import TraversalConfig

    way, options = way_of(plan), {}
    if way.packets:
        options = {"packet": plan.packet, "shared_origin": plan.shared_origin, "culling": plan.culling}
    if way.streams:
        options["stream"] = plan.stream
    if plan.accelerator == "bvh":
        options["levels"] = stack_levels(scene.depth)
        options["block"] = CUDA_BLOCK if scene.device.is_cuda else 0
    test, mailbox = plan.triangle_test, plan.mailbox
    alone = plan.one_by_one
    options |= {"mailbox": mailbox, "one_by_one": alone, "cull_backfaces": plan.cull_backfaces}
    return TraversalConfig(test, plan.width, query, plan.coherent, counters, **options)


def stack_levels(depth: int) -> int:
    """Room for the tree's depth in steps of 8 levels, so that few specialisations serve all trees."""
    return -(-depth // 8) * 8


def way_of(plan: Plan) -> Traversal:
    """The plan's entry in the table of traversals."""
    from wrt.kernels.traversal import TRAVERSALS

    return TRAVERSALS[plan.traversal]


def plan_for(plan: Plan, query: str) -> Plan:
    """The plan as a query carries it out: a triangle test may leave the search for any hit to another one."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    other = TRIANGLE_TESTS[plan.triangle_test].any_hit
    return replace(plan, triangle_test=other) if query == ANY and other else plan
