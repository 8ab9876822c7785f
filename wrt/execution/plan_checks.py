"""Checks of plans. A plan that does not fit is refused before any kernel runs, with a message that names what would fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.execution.instance_plan import check_instances
from wrt.execution.query_kinds import ALL, COUNT
from wrt.execution.wide_trees import can_be_wide, wide_width
from wrt.rays.ray_buffers import shares_origin
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.execution.plan import Plan
    from wrt.execution.scene_state import SceneState
    from wrt.kernels.traversal import Traversal
    from wrt.kernels.traversal.packet import Culling
    from wrt.kernels.triangle import TriangleTest
    from wrt.rays.ray_buffers import RayBuffers

MAX_PACKET = 256
"""Largest number of rays of a packet: 16 x 16."""

MAX_CUDA_STREAM = 256
"""Largest number of rays of a stream on CUDA: each thread holds a stream in local memory, which limits how many threads run
at a time.
"""

MAX_STREAM = 4096
"""Largest number of rays of a stream on the CPU: 64 x 64."""

ORDERS = ("none", "cells", "tiles")

TILED = ("packet", "wide_packet")
"""Traversals that can trace the pixels of an image tile by tile."""


def check_plan(plan: Plan, scene: SceneState, rays: RayBuffers, query: str) -> Plan:
    """Returns a plan that fits the scene and the rays.

    Raises:
        ValueError: the plan does not fit; the message names the field.
    """
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.traversal.mailbox import MAILBOXES
    from wrt.kernels.traversal.packet import CULLINGS
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
        check_instances(scene, query, way, test)
    check_spaces(scene, way)
    check_wide(scene, way)
    width = wide_width(scene) if way.wide else scene.width
    if plan.width != width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {width}")
    if plan.shared_origin and (rays.arrays_or_batch.origin_stride != 0 or scene.instances):
        raise ValueError(
            "plan.shared_origin is true, but each ray has its own origin; broadcast one origin, in a scene without instances"
        )
    lookup(MAILBOXES, plan.mailbox, "plan.mailbox")
    if plan.mailbox != "none" and not (way.mailbox and plan.accelerator == "kdtree"):
        able = ", ".join(name for name, entry in TRAVERSALS.items() if entry.mailbox)
        raise ValueError(f"plan.mailbox is {plan.mailbox!r}; mailboxes need a kdtree and one of {able}")
    if plan.mailbox != "none" and query in (COUNT, ALL):
        raise ValueError(
            f"plan.mailbox is {plan.mailbox!r}, but the query {query!r} has to test a triangle in every leaf; use 'none'"
        )
    lookup(dict.fromkeys(ORDERS), plan.reorder, "plan.reorder")
    if plan.reorder == "tiles" and plan.traversal not in TILED:
        raise ValueError(f"plan.reorder is 'tiles', which needs {' or '.join(TILED)}, not {plan.traversal!r}")
    if plan.reorder == "cells" and way.packets:
        raise ValueError("plan.reorder is 'cells', which needs a traversal without packets")
    if plan.reorder == "tiles" and rays.columns == 0:
        raise ValueError(f"plan.reorder is 'tiles', but rays of shape {rays.shape} are not the pixels of an image")
    if plan.one_by_one and plan.traversal != "single":
        raise ValueError(f"plan.one_by_one needs the traversal 'single', not {plan.traversal!r}")
    most = MAX_CUDA_STREAM if scene.device.is_cuda else MAX_STREAM
    if way.streams and not 1 <= plan.stream <= most:
        raise ValueError(f"plan.stream is {plan.stream}; it must be from 1 to {most}")
    if not way.packets:
        return plan
    if plan.packet < plan.width or plan.packet % plan.width or plan.packet > MAX_PACKET:
        raise ValueError(f"plan.packet is {plan.packet}; it must be a multiple of {plan.width}, at most {MAX_PACKET}")
    fitting = {name: c for name, c in CULLINGS.items() if c.holds_for(test) and fits(c, way, plan.accelerator)}
    if lookup(CULLINGS, plan.culling, "plan.culling").name not in fitting:
        able = ", ".join(fitting)
        raise ValueError(
            f"plan.culling {plan.culling!r} does not support {test.name} on a {plan.accelerator}; choose from {able}"
        )
    return plan


def fits(culling: Culling, way: Traversal, tree: str) -> bool:
    """Whether the traversal's kind of tree has the data that a culling needs."""
    return way.wide or tree == "bvh" or not culling.needs_boxes


def check_wide(scene: SceneState, way: Traversal) -> None:
    """Refuses a traversal of wide trees if the scene has none.

    Raises:
        ValueError: the scene's kd-tree is built lazily.
    """
    if way.wide and not can_be_wide(scene):
        raise ValueError(
            f"traversal {way.name!r} walks the wide form of a complete kd-tree, and this one is lazy; "
            "choose from auto, lockstep, packet, or another builder"
        )


def check_spaces(scene: SceneState, way: Traversal) -> None:
    """Refuses a traversal that does not support trees with their own coordinate spaces.

    Raises:
        ValueError: the scene has such trees (`wrt.FuzzyScene`).
    """
    if scene.only_single and way.name not in ("single", "brute"):
        raise ValueError(
            f"traversal {way.name!r} does not support trees with their own spaces; choose from auto, single, brute"
        )


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
            f"triangle_test {test.name!r} may count a crossing at an edge twice or not at all; choose from auto, {able}"
        )


def check_culling(cull_backfaces: bool, way: Traversal, tree: str) -> None:
    """Refuses a traversal that cannot cull back faces.

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
    """Refuses rays that a triangle test does not support.

    Raises:
        ValueError: the test needs a shared origin, and each ray has its own.
    """
    if test.needs_shared_origin and not shares_origin(rays.arrays_or_batch):
        raise ValueError(
            f"triangle_test {test.name!r} needs rays that share their origin; pass a single point as origins, such as "
            "(0, 0, 1) or np.broadcast_to(point, directions.shape), or choose triangle_test='woop'"
        )
