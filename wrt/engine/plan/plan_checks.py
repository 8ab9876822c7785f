"""Whether a traversal, a triangle test and their options can answer a query in a scene. What cannot is refused before any
kernel runs, with a message that names what can.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.facts.wide_trees import wide_width
from wrt.kernels.answers import ANSWERS
from wrt.kernels.traversal import ORDERS, TRAVERSALS, Traversal
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS, Culling
from wrt.kernels.triangle import TRIANGLE_TESTS, TriangleTest
from wrt.tables import lookup, one_of

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts, SceneFacts
    from wrt.engine.plan.plan import Plan

MAX_PACKET = 256
"""Largest number of rays of a packet: 16 x 16."""

MAX_CUDA_STREAM = 64
"""Largest number of rays of a stream on CUDA. Each thread holds a stream in local memory, which a driver takes for all threads
that a device runs at a time, and keeps: on an H200 9 GB for streams of 64 rays, 29 GB for 256
(notebooks/records/2026-11-27-gpu-queries.md).
"""

MAX_STREAM = 1 << 14
"""Largest number of rays of a stream on the CPU. Longer ones do not stay in the near caches
(notebooks/records/2026-11-24-streams.md).
"""

MAX_LOCAL_STREAM = 4096
"""The same where a stream is in a thread's local memory: in the cells of a kd-tree, and through instances."""


def can_answer(
    traversal: Traversal, scene: SceneFacts, query: str, cull_backfaces: bool, triangle_test: str | None = None
) -> bool:
    """Whether a traversal can answer a query in a scene, by a triangle test that can, or None for any: `check_answer` as a
    bool."""
    kind = scene.tree if traversal.walks_tree else "none"
    return (
        traversal.supports(query, kind)
        and (triangle_test is None or traversal.takes_test(triangle_test))
        and (not cull_backfaces or traversal.culls_backfaces(kind))
        and (not scene.instances or traversal.supports_through_instances(query, kind, scene.is_cuda))
        and (not scene.own_spaces or Capabilities.OWN_SPACES in traversal.capabilities)
        and (not scene.points or Capabilities.POINTS in traversal.capabilities)
        and (Capabilities.WIDE_FORM not in traversal.capabilities or scene.can_be_wide)
        and has_width(scene, traversal)
        and sees_masks(scene, traversal, query)
        and (Capabilities.SHARED_LEAVES in traversal.capabilities or not ANSWERS[query].rules.once or not scene.shares_leaves)
    )


def check_answer(
    scene: SceneFacts, query: str, traversal: Traversal, tree: str, test: TriangleTest, cull_backfaces: bool
) -> None:
    """Refuses a traversal or a triangle test that cannot answer a query in a scene.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    check_points(scene, traversal)
    check_query(query, traversal, tree, test, scene)
    check_test(traversal, test)
    check_culling(cull_backfaces, traversal, tree)
    if scene.instances:
        check_instances(scene, query, traversal, test)
    check_spaces(scene, traversal)
    check_wide(scene, traversal)
    check_width(scene, traversal)
    check_leaves(scene, query, traversal)
    check_masks(scene, query, traversal)


def sees_masks(scene: SceneFacts, traversal: Traversal, query: str) -> bool:
    """Whether a traversal decides hits of a query by the alpha masks of a scene, if it has any."""
    able = Capabilities.ALPHA_MASKS in traversal.capabilities and not ANSWERS[query].rules.oriented
    return able or not scene.has_masks


def check_masks(scene: SceneFacts, query: str, traversal: Traversal) -> None:
    """Refuses a traversal that does not look at alpha masks.

    Raises:
        ValueError: they count in the scene.
    """
    if not sees_masks(scene, traversal, query):
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.ALPHA_MASKS in entry.capabilities)
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} by alpha masks; choose from auto, {able}, or "
            "leave out alpha=True"
        )


def check_leaves(scene: SceneFacts, query: str, traversal: Traversal) -> None:
    """Refuses a traversal that would report the crossing of a triangle in several leaves more than once.

    Raises:
        ValueError: the scene's BVH was built with spatial splits.
    """
    if ANSWERS[query].rules.once and scene.shares_leaves and Capabilities.SHARED_LEAVES not in traversal.capabilities:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.SHARED_LEAVES in entry.capabilities)
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on a BVH with spatial splits; "
            f"choose from auto, {able}"
        )


def check_instances(scene: SceneFacts, query: str, traversal: Traversal, test: TriangleTest) -> None:
    """Refuses what a scene of instances does not support.

    Raises:
        ValueError: the traversal walks only single-level trees, or the test has records for one origin.
    """
    kind, is_cuda = scene.tree, scene.is_cuda
    if not traversal.supports_through_instances(query, kind, is_cuda):
        able = [
            name
            for name, entry in TRAVERSALS.items()
            if entry.supports_through_instances(query, kind, is_cuda) and has_width(scene, entry)
        ]
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on two levels of {kind}; "
            f"for this scene of instances, choose from auto, {', '.join(able)}"
        )
    if test.record.per_origin:
        raise ValueError(
            f"triangle_test {test.name!r} needs one origin for all triangles, and each instance has its own coordinates; "
            "choose triangle_test='woop'"
        )


def check_wide(scene: SceneFacts, traversal: Traversal) -> None:
    """Refuses a traversal of wide trees if the scene has none.

    Raises:
        ValueError: the scene's kd-tree is built lazily.
    """
    if Capabilities.WIDE_FORM in traversal.capabilities and not scene.can_be_wide:
        raise ValueError(
            f"traversal {traversal.name!r} walks the wide form of a complete kd-tree, and this one is lazy; "
            "choose from auto, lockstep, packet, or another builder"
        )


def has_width(scene: SceneFacts, traversal: Traversal) -> bool:
    """Whether a scene has one tree, whose nodes have as many children as a traversal walks."""
    return traversal.width is None or (traversal.width == scene.width and not scene.by_area)


def check_width(scene: SceneFacts, traversal: Traversal) -> None:
    """Refuses a traversal of nodes of another width than the scene's.

    Raises:
        ValueError: the scene's nodes have another number of children, or its trees are those of influence areas.
    """
    if not has_width(scene, traversal):
        raise ValueError(
            f"traversal {traversal.name!r} walks one BVH of width {traversal.width}, the width on CUDA, and this scene has "
            f"width {scene.width}; choose from auto, single, or make the scene with wrt.Bvh(width={traversal.width})"
        )


def check_spaces(scene: SceneFacts, traversal: Traversal) -> None:
    """Refuses a traversal that does not support trees with their own coordinate spaces.

    Raises:
        ValueError: the scene has such trees (`wrt.moving.FuzzyScene`).
    """
    if scene.own_spaces and Capabilities.OWN_SPACES not in traversal.capabilities:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.OWN_SPACES in entry.capabilities)
        raise ValueError(f"traversal {traversal.name!r} does not support trees with their own spaces; choose from auto, {able}")


def check_points(scene: SceneFacts, traversal: Traversal) -> None:
    """Refuses a traversal that does not trace rays through points.

    Raises:
        ValueError: the scene is a point cloud.
    """
    if scene.points and Capabilities.POINTS not in traversal.capabilities:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.POINTS in entry.capabilities)
        raise ValueError(
            f"traversal {traversal.name!r} traces rays through triangles, and a point cloud has none; choose from auto, {able}"
        )


def check_query(query: str, traversal: Traversal, tree: str, test: TriangleTest, scene: SceneFacts | None = None) -> None:
    """Refuses a traversal or a triangle test that cannot answer a query, in a scene of which more may be known.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    if not traversal.supports(query, tree):
        able = ", ".join(
            name
            for name, entry in TRAVERSALS.items()
            for kind in (tree, "none")
            if entry.supports(query, kind) and (has_width(scene, entry) if scene else entry.width is None)
        )
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on a {tree}; choose from auto, {able}"
        )
    if ANSWERS[query].rules.crossings and test.crossing is None:
        able = ", ".join(name for name, entry in TRIANGLE_TESTS.items() if entry.crossing is not None)
        raise ValueError(
            f"triangle_test {test.name!r} may count a crossing at an edge twice or not at all; choose from auto, {able}"
        )


def check_test(traversal: Traversal, test: TriangleTest) -> None:
    """Refuses a triangle test that a traversal does not use.

    Raises:
        ValueError: it does not.
    """
    if not traversal.takes_test(test.name):
        able = ", ".join(traversal.triangle_tests or ())
        raise ValueError(
            f"traversal {traversal.name!r} does not use triangle_test {test.name!r}, only {able}; choose traversal='auto'"
        )


def check_culling(cull_backfaces: bool, traversal: Traversal, tree: str) -> None:
    """Refuses a traversal that cannot cull back faces.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    if cull_backfaces and not traversal.culls_backfaces(tree):
        able = ", ".join(
            name for name, entry in TRAVERSALS.items() if entry.culls_backfaces(tree) or entry.culls_backfaces("none")
        )
        raise ValueError(f"traversal {traversal.name!r} does not cull back faces on a {tree}; choose from auto, {able}")


def check_origins(test: TriangleTest, traversal: Traversal, rays: RayFacts) -> None:
    """Refuses rays that a triangle test or a traversal does not support.

    Raises:
        ValueError: one of them needs a shared origin, and each ray has its own.
    """
    if rays.shared_origin or rays.count <= 1:
        return
    for argument, entry, other in (("triangle_test", test, "woop"), ("traversal", traversal, "auto")):
        if entry.needs_shared_origin:
            raise ValueError(
                f"{argument} {entry.name!r} needs rays that share their origin; pass a single point as origins, such as "
                f"(0, 0, 1) or np.broadcast_to(point, directions.shape), or choose {argument}={other!r}"
            )


def longest_stream(scene: SceneFacts, traversal: Traversal) -> int:
    """Largest number of rays of a stream."""
    if scene.is_cuda:
        return MAX_CUDA_STREAM
    able = Capabilities.LONG_STREAMS in traversal.capabilities
    is_long = able and traversal.walks_boxes(scene.tree) and not scene.instances
    return MAX_STREAM if is_long else MAX_LOCAL_STREAM


def check_plan(plan: Plan, scene: SceneFacts, rays: RayFacts, query: str) -> Plan:
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
    if plan.accelerator not in ("none", scene.tree):
        raise ValueError(f"plan.accelerator is {plan.accelerator!r}, but the scene has a {scene.tree}")
    check_answer(scene, query, traversal, plan.accelerator, test, plan.cull_backfaces)
    width = wide_width(scene.width) if Capabilities.WIDE_FORM in traversal.capabilities else scene.width
    if plan.width != width:
        raise ValueError(f"plan.width is {plan.width}, but the scene's tree has width {width}")
    if plan.shared_origin and (not rays.shared_origin or scene.instances):
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
    one_of(ORDERS, plan.reorder, "plan.reorder")
    if plan.reorder not in traversal.orders:
        able = " or ".join(name for name, entry in TRAVERSALS.items() if plan.reorder in entry.orders)
        raise ValueError(f"plan.reorder is {plan.reorder!r}, which needs {able}, not {plan.traversal!r}")
    if plan.reorder == "tiles" and rays.columns == 0:
        raise ValueError(f"plan.reorder is 'tiles', but rays of shape {rays.shape} are not the pixels of an image")
    longest = longest_stream(scene, traversal)
    if Capabilities.STREAMS in traversal.capabilities and not 1 <= plan.stream <= longest:
        why = ", as streams on CUDA take local memory for all threads of the device" if scene.is_cuda else ""
        raise ValueError(f"plan.stream is {plan.stream}; it must be from 1 to {longest}{why}")
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
