"""Checks of plans. A plan that does not fit is refused before any kernel runs, with a message that names what would fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.facts.wide_trees import wide_width
from wrt.engine.plan.answer_checks import check_answer, check_origins
from wrt.kernels.answers import ANSWERS
from wrt.kernels.traversal import ORDERS, TRAVERSALS, Traversal
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, Culling
from wrt.kernels.triangle import TRIANGLE_TESTS, TriangleTest
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.ray_buffers import RayBuffers

MAX_PACKET = 256
"""Largest number of rays of a packet: 16 x 16."""

MAX_CUDA_STREAM = 256
"""Largest number of rays of a stream on CUDA: each thread holds a stream in local memory, which limits how many threads run
at a time.
"""

MAX_STREAM = 1 << 14
"""Largest number of rays of a stream on the CPU. Longer ones do not stay in the near caches
(notebooks/records/2026-11-24-streams.md).
"""

MAX_LOCAL_STREAM = 4096
"""The same where a stream is in a thread's local memory: in the cells of a kd-tree, and through instances."""


def longest_stream(scene: SceneState, traversal: Traversal) -> int:
    """Largest number of rays of a stream."""
    if scene.device.is_cuda:
        return MAX_CUDA_STREAM
    able = Capabilities.LONG_STREAMS in traversal.capabilities
    is_long = able and traversal.walks_boxes(scene.accelerator.kind) and not scene.instances
    return MAX_STREAM if is_long else MAX_LOCAL_STREAM


def check_plan(plan: Plan, scene: SceneState, rays: RayBuffers, query: str) -> Plan:
    """Returns a plan that fits the scene and the rays.

    Raises:
        ValueError: the plan does not fit; the message names the field.
    """
    traversal = lookup(TRAVERSALS, plan.traversal, "plan.traversal")
    test = lookup(TRIANGLE_TESTS, plan.triangle_test, "plan.triangle_test")
    check_origins(test, traversal, rays)
    if plan.accelerator not in traversal.trees:
        raise ValueError(
            f"plan.traversal {traversal.name!r} does not walk a {plan.accelerator}; it walks {', '.join(traversal.trees)}"
        )
    if plan.accelerator not in ("none", scene.accelerator.kind):
        raise ValueError(f"plan.accelerator is {plan.accelerator!r}, but the scene has a {scene.accelerator.kind}")
    check_answer(scene, query, traversal, plan.accelerator, test, plan.cull_backfaces)
    width = wide_width(scene) if Capabilities.WIDE_FORM in traversal.capabilities else scene.width
    if plan.width != width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {width}")
    if plan.shared_origin and (rays.arrays_or_batch.origin_stride != 0 or scene.instances):
        raise ValueError(
            "plan.shared_origin is true, but each ray has its own origin; broadcast one origin, in a scene without instances"
        )
    if traversal.needs_shared_origin and not plan.shared_origin and rays.count > 1:
        raise ValueError(
            f"plan.shared_origin is false, but traversal {traversal.name!r} takes rays from one point; make it true"
        )
    lookup(MAILBOXES, plan.mailbox, "plan.mailbox")
    if plan.mailbox != "none" and not traversal.has_mailbox(plan.accelerator):
        able = ", ".join(name for name, entry in TRAVERSALS.items() if entry.has_mailbox("kdtree"))
        raise ValueError(f"plan.mailbox is {plan.mailbox!r}; mailboxes need a kdtree and one of {able}")
    if plan.mailbox != "none" and not ANSWERS[query].nearest:
        raise ValueError(
            f"plan.mailbox is {plan.mailbox!r}, but the query {query!r} has to test a triangle in every leaf; use 'none'"
        )
    lookup(dict.fromkeys(ORDERS), plan.reorder, "plan.reorder")
    if plan.reorder not in traversal.orders:
        able = " or ".join(name for name, entry in TRAVERSALS.items() if plan.reorder in entry.orders)
        raise ValueError(f"plan.reorder is {plan.reorder!r}, which needs {able}, not {plan.traversal!r}")
    if plan.reorder == "tiles" and rays.columns == 0:
        raise ValueError(f"plan.reorder is 'tiles', but rays of shape {rays.shape} are not the pixels of an image")
    most = longest_stream(scene, traversal)
    if Capabilities.STREAMS in traversal.capabilities and not 1 <= plan.stream <= most:
        raise ValueError(f"plan.stream is {plan.stream}; it must be from 1 to {most}")
    if Capabilities.PACKETS not in traversal.capabilities:
        return plan
    if plan.packet < plan.width or plan.packet % plan.width or plan.packet > MAX_PACKET:
        raise ValueError(f"plan.packet is {plan.packet}; it must be a multiple of {plan.width}, at most {MAX_PACKET}")
    fitting = {name: c for name, c in CULLINGS.items() if fits(c, traversal, plan.accelerator, test)}
    if lookup(CULLINGS, plan.culling, "plan.culling").name not in fitting:
        able = ", ".join(fitting)
        raise ValueError(
            f"plan.culling {plan.culling!r} does not support {test.name} on a {plan.accelerator}; choose from {able}"
        )
    return plan


def fits(culling: Culling, traversal: Traversal, tree: str, test: TriangleTest) -> bool:
    """Whether the traversal's kind of tree has the data that a culling needs, and it keeps every hit of the triangle test."""
    return culling.holds_for(test) and (traversal.walks_boxes(tree) or not culling.needs_boxes)
