"""Whether a traversal and a triangle test can answer a query in a scene. What cannot is refused before any kernel runs, with a
message that names what can.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.engine.facts.wide_trees import can_be_wide
from wrt.engine.rays.ray_buffers import shares_origin
from wrt.kernels.answers import ANSWERS
from wrt.kernels.traversal import TRAVERSALS, Traversal
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.triangle import TRIANGLE_TESTS, TriangleTest

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.ray_buffers import RayBuffers


def can_answer(traversal: Traversal, scene: SceneState, query: str, cull_backfaces: bool) -> bool:
    """Whether a traversal can answer a query in a scene: `check_answer` without the triangle test, as a bool."""
    kind = scene.accelerator.kind if traversal.walks_tree else "none"
    return (
        kind in traversal.kernels
        and traversal.supports(query, kind)
        and (not cull_backfaces or traversal.culls_backfaces(kind))
        and (not scene.instances or traversal.supports_through_instances(query, kind, scene.device.is_cuda))
        and (not scene.only_single or Capabilities.OWN_SPACES in traversal.capabilities)
        and (Capabilities.WIDE_FORM not in traversal.capabilities or can_be_wide(scene))
        and (Capabilities.SHARED_LEAVES in traversal.capabilities or not ANSWERS[query].once or not scene.shares_leaves)
    )


def check_answer(
    scene: SceneState, query: str, traversal: Traversal, tree: str, test: TriangleTest, cull_backfaces: bool
) -> None:
    """Refuses a traversal or a triangle test that cannot answer a query in a scene.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    check_query(query, traversal, tree, test)
    check_culling(cull_backfaces, traversal, tree)
    if scene.instances:
        check_instances(scene, query, traversal, test)
    check_spaces(scene, traversal)
    check_wide(scene, traversal)
    check_leaves(scene, query, traversal)


def check_leaves(scene: SceneState, query: str, traversal: Traversal) -> None:
    """Refuses a traversal that would report the crossing of a triangle in several leaves more than once.

    Raises:
        ValueError: the scene's BVH was built with spatial splits.
    """
    if ANSWERS[query].once and scene.shares_leaves and Capabilities.SHARED_LEAVES not in traversal.capabilities:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.SHARED_LEAVES in entry.capabilities)
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on a BVH with spatial splits; "
            f"choose from auto, {able}"
        )


def check_instances(scene: SceneState, query: str, traversal: Traversal, test: TriangleTest) -> None:
    """Refuses what a scene of instances does not support.

    Raises:
        ValueError: the traversal walks only single-level trees, or the test has records for one origin.
    """
    kind, is_cuda = scene.accelerator.kind, scene.device.is_cuda
    if not traversal.supports_through_instances(query, kind, is_cuda):
        able = [name for name, entry in TRAVERSALS.items() if entry.supports_through_instances(query, kind, is_cuda)]
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on two levels of {kind}; "
            f"for this scene of instances, choose from auto, {', '.join(able)}"
        )
    if test.record.per_origin:
        raise ValueError(
            f"triangle_test {test.name!r} needs one origin for all triangles, and each instance has its own coordinates; "
            "choose triangle_test='woop'"
        )


def check_wide(scene: SceneState, traversal: Traversal) -> None:
    """Refuses a traversal of wide trees if the scene has none.

    Raises:
        ValueError: the scene's kd-tree is built lazily.
    """
    if Capabilities.WIDE_FORM in traversal.capabilities and not can_be_wide(scene):
        raise ValueError(
            f"traversal {traversal.name!r} walks the wide form of a complete kd-tree, and this one is lazy; "
            "choose from auto, lockstep, packet, or another builder"
        )


def check_spaces(scene: SceneState, traversal: Traversal) -> None:
    """Refuses a traversal that does not support trees with their own coordinate spaces.

    Raises:
        ValueError: the scene has such trees (`wrt.moving.FuzzyScene`).
    """
    if scene.only_single and Capabilities.OWN_SPACES not in traversal.capabilities:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if Capabilities.OWN_SPACES in entry.capabilities)
        raise ValueError(f"traversal {traversal.name!r} does not support trees with their own spaces; choose from auto, {able}")


def check_query(query: str, traversal: Traversal, tree: str, test: TriangleTest) -> None:
    """Refuses a traversal or a triangle test that cannot answer a query.

    Raises:
        ValueError: it cannot; the message names those that can.
    """
    if not traversal.supports(query, tree):
        able = ", ".join(
            name
            for name, entry in TRAVERSALS.items()
            for kind in (tree, "none")
            if kind in entry.trees and entry.supports(query, kind)
        )
        raise ValueError(
            f"traversal {traversal.name!r} does not answer the query {query!r} on a {tree}; choose from auto, {able}"
        )
    if ANSWERS[query].crossings and test.crossing is None:
        able = ", ".join(name for name, entry in TRIANGLE_TESTS.items() if entry.crossing is not None)
        raise ValueError(
            f"triangle_test {test.name!r} may count a crossing at an edge twice or not at all; choose from auto, {able}"
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


def check_origins(test: TriangleTest, traversal: Traversal, rays: RayBuffers) -> None:
    """Refuses rays that a triangle test or a traversal does not support.

    Raises:
        ValueError: one of them needs a shared origin, and each ray has its own.
    """
    if shares_origin(rays.arrays_or_batch):
        return
    for argument, entry, other in (("triangle_test", test, "woop"), ("traversal", traversal, "auto")):
        if entry.needs_shared_origin:
            raise ValueError(
                f"{argument} {entry.name!r} needs rays that share their origin; pass a single point as origins, such as "
                f"(0, 0, 1) or np.broadcast_to(point, directions.shape), or choose {argument}={other!r}"
            )
