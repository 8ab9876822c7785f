"""How a query is answered: traversal, triangle test and their options, chosen from the scene, the device and the rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from wrt.execution.plan_checks import (
    ALL,
    COUNT,
    TILED,
    check_culling,
    check_origins,
    check_plan,
    check_query,
    check_spaces,
    check_wide,
)
from wrt.execution.wide_trees import can_be_wide, pays, walked_tree, wide_width
from wrt.kernels.runtime.launch import CUDA_BLOCK, get_num_threads
from wrt.tables import lookup

if TYPE_CHECKING:
    import warp as wp

    from wrt.kernels.traversal import Traversal
    from wrt.kernels.traversal.traversal_config import TraversalConfig
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays.rays import RayBuffers
    from wrt.scene.scene import Scene

AUTO = "auto"
CLOSEST, ANY, EXACT = "closest", "any", "exact"

ALIKE, DIFFERENT = "neighbouring rays look alike", "neighbouring rays look different"

DEFAULT_TEST = "woop"
"""The triangle test of "auto". Of all tests that `wrt bench triangle-tests` compares it is the only watertight one. With a tree
it is the fastest for views, and costs 2 to 6 % against Moeller and Trumbore's for single and for random rays; Komatsu's, at
half the operations, is no faster, and its records are made again for each origin."""

FEW_RAYS = 1024
"""Rays up to which each goes alone: what that takes is kept ready (`wrt.execution.few_rays`), and to look whether rays are
alike and to set up packets or streams would take as long as to trace them."""

PACKET_VECTORS = 2
"""Rays of a packet, in vectors of the tree's width. Of 1, 2, 4 and 8, measured with 16 lanes, 2 was best or within 5 % of
it for views and shadow rays of the bunny, the dragon (two sizes) and the atrium."""

RAYS_PER_TRIANGLE = 0.125
"""Rays a triangle of the scene from which on coherent rays go in packets: where triangles are smaller than the gaps between
rays, streams lose less on rays that part company. (Time of packets against streams, shadow rays: 0.6 at 3 rays a triangle, 0.8
at 0.25, 1.3 at 0.06; views: 0.6 at 1.3, 0.9 at 0.24, 1.3 at 0.08.)"""

ROUGH_RAYS_PER_TRIANGLE = 2.0
"""Rays a triangle of the scene up to which views, too, are culled anew at each leaf, which a packet then meets with few of its
rays. (Views of four scenes from afar and from near by, 128 x 128 to 1024 x 1024 pixels, time against vertex culling: 0.5 to 0.8
at a quarter of a ray a triangle, 0.85 to 1.05 at 1.3, 0.7 to 1.1 at 3, 0.9 to 1.13 from 5 on.)"""

STREAMS, CUDA_STREAM = (4096, 1024, 256), 64
"""Rays of a stream: the longer, the better its lanes are used, as long as each thread has several. On CUDA, where a stream
is a thread's, they lie in its local memory."""

STREAMS_PER_THREAD = 4

LEAST_TO_REORDER = 1 << 16
"""Rays from which on sorting them pays."""

MOST_PLANS = 64
"""Plans that a scene keeps."""

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
        culling: key in `wrt.kernels.traversal.packet.CULLINGS`; empty without packets.
        stream: rays of a stream; 1 without streams.
        mailbox: key in `wrt.kernels.traversal.mailbox.MAILBOXES`; "none" on trees in which no triangle is in two leaves.
        reorder: order in which rays are traced (`wrt.kernels.query.ray_order`): "none", their own; "cells", by cell of the
            origin and octant of the direction; "tiles", the rows and columns of a picture tile by tile, in packets.
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

    @property
    def is_wide(self) -> bool:
        """Whether the scene's kd-tree is walked in its wide form."""
        return way_of(self).wide

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
    named = isinstance(traversal, str) and isinstance(triangle_test, str)
    changing = not scene.device.is_cuda and (scene.instances or scene.growing is not None or can_be_wide(scene))
    if changing or not named:  # it depends on what came before, or it is refused
        return choose_plan(scene, rays, traversal, triangle_test, query, cull_backfaces)
    # The longer Python takes for a plan, the longer a GPU waits for its kernel, and cores for theirs.
    found = rays.coherent, rays.scattered, rays.columns > 0, get_num_threads()
    key = traversal, triangle_test, query, cull_backfaces, rays.shape, rays.laid_out.origin_stride, found
    plan = scene.plans.get(key)  # another thread may clear them at any time
    if plan is None:
        plan = choose_plan(scene, rays, traversal, triangle_test, query, cull_backfaces)
        if len(scene.plans) >= MOST_PLANS:
            scene.plans.clear()
        scene.plans[key] = plan
    return plan


def choose_plan(scene: Scene, rays: RayBuffers, traversal: str, triangle_test: str, query: str, cull_backfaces: bool) -> Plan:
    """A plan for these rays; arguments and errors as of `make_plan`."""
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
        from wrt.execution.instance_plan import check_instances

        check_instances(scene, query, way, test)
    check_spaces(scene, way)
    check_wide(scene, way)
    width = wide_width(scene) if way.wide else scene.width
    options: dict[str, object] = {}
    if way.packets:
        options["packet"] = PACKET_VECTORS * width
        options["culling"] = choose_culling(scene, rays, way, test)
    if way.streams:
        options["stream"] = stream_size(scene, rays)
    if traversal == AUTO or way.name in TILED:
        options["reorder"] = choose_order(scene, rays, way, test)
    return Plan(
        accelerator=accelerator,
        traversal=way.name,
        triangle_test=test.name,
        width=width,
        coherent=rays.coherent,
        shared_origin=rays.laid_out.origin_stride == 0 and not scene.instances,
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
    if scene.only_single:
        return "single", "trees in spaces of their own"
    if rays.count <= FEW_RAYS:
        return "single", "few rays"
    if scene.instances:
        from wrt.execution.instance_plan import choose_for_instances

        return choose_for_instances(scene, rays, query, cull_backfaces)
    if query in (COUNT, ALL) or cull_backfaces:
        what = "all hits" if query in (COUNT, ALL) else "front faces"
        is_bvh = scene.accelerator.kind == "bvh"
        return ("stream", f"{what} of many rays") if is_bvh else ("single", f"what finds {what} on a kd-tree")
    is_bvh, is_wide = scene.accelerator.kind == "bvh", pays(scene, rays)
    if not (is_bvh or is_wide):
        return ("packet", ALIKE) if rays.coherent else ("lockstep", DIFFERENT)
    stream, packet = ("wide_stream", "wide_packet") if is_wide else ("stream", "packet")
    if not rays.coherent:
        return stream, DIFFERENT
    if rays.count < RAYS_PER_TRIANGLE * scene.triangle_count:
        return stream, f"{ALIKE}, but triangles are small"
    return packet, ALIKE


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


def choose_culling(scene: Scene, rays: RayBuffers, way: Traversal, test: TriangleTest) -> str:
    """Name of the culling: the rays that meet a leaf are worth a look of their own where packets are wide, or leaves small."""
    if not test.accurate:
        return "interval"
    if not (way.wide or scene.accelerator.kind == "bvh"):
        return "vertex"
    narrow = rays.laid_out.origin_stride == 0 and not scene.instances
    fine = rays.count >= ROUGH_RAYS_PER_TRIANGLE * scene.triangle_count
    return "vertex" if narrow and fine else "transient_frustum"


def choose_order(scene: Scene, rays: RayBuffers, way: Traversal, test: TriangleTest) -> str:
    """Order of tracing."""
    if way.name in TILED:
        return "tiles" if rays.columns > 0 else "none"
    return "cells" if rays.scattered and is_large(scene, rays, test) else "none"


def is_large(scene: Scene, rays: RayBuffers, test: TriangleTest) -> bool:
    """Whether so many rays meet so many triangles that it pays to sort the rays first."""
    return rays.count >= LEAST_TO_REORDER and len(scene.tree.primitive) * 4 * test.record.components >= CACHED_BYTES


def traversal_config(plan: Plan, scene: Scene, query: str, counters: bool) -> TraversalConfig:
    """The specialisation that carries out a plan."""
    from wrt.kernels.traversal.traversal_config import TraversalConfig

    way, options = way_of(plan), {}
    if way.packets:
        options = {"packet": plan.packet, "shared_origin": plan.shared_origin, "culling": plan.culling}
    if way.streams:
        options["stream"] = plan.stream
    if way.wide or plan.accelerator == "bvh":
        options["levels"] = stack_levels(walked_tree(plan, scene).depth)
        options["block"] = CUDA_BLOCK if scene.device.is_cuda else 0
    test, mailbox = plan.triangle_test, plan.mailbox
    alone = plan.one_by_one
    options |= {"mailbox": mailbox, "one_by_one": alone, "cull_backfaces": plan.cull_backfaces}
    return TraversalConfig(test, plan.width, query, plan.coherent, counters, **options)


def stack_levels(depth: int) -> int:
    """Room for the tree's depth in steps of 8 levels, so that few specialisations serve all trees."""
    return -(-depth // 8) * 8


def kernel_factory(plan: Plan, scene: Scene) -> Callable[[TraversalConfig], wp.Kernel]:
    """What makes the kernel that carries out a plan on the scene's tree."""
    if scene.only_single and plan.accelerator != "none":
        from wrt.kernels.traversal.two_level.fuzzy_boxes import make_kernel

        return make_kernel
    return way_of(plan).kernels[plan.accelerator]


def way_of(plan: Plan) -> Traversal:
    """The plan's entry in the table of traversals."""
    from wrt.kernels.traversal import TRAVERSALS

    return TRAVERSALS[plan.traversal]


def plan_for(plan: Plan, query: str) -> Plan:
    """The plan as a query carries it out: a triangle test may leave the search for any hit to another one."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    other = TRIANGLE_TESTS[plan.triangle_test].any_hit
    return replace(plan, triangle_test=other) if query == ANY and other else plan
