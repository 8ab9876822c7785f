"""Closest hits, occlusion and counts: how each query is answered, by its options."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from wrt.engine.executor import answer
from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.kernels.answers import ANSWERS
from wrt.query import pickled_hits  # noqa: F401, says how hits are pickled
from wrt.query.exact_hits import find_precisely
from wrt.query.hits import Hits
from wrt.query.skip import answer_skipping

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.rays import GivenRays


def closest_hits(scene: SceneState, rays: GivenRays, query: Query) -> Hits:
    """Closest hits; options and errors as in `wrt.Scene.intersect`."""
    if query.skip is not None:
        found = answer_skipping(scene, rays, query)
    elif query.precise:
        return find_precisely(scene, rays, query)
    else:
        if query.counters and scene.instances and query.traversal == AUTO:
            query = query._replace(traversal="single")  # what is counted there
        found = answer(scene, rays, query)
    return Hits(found.hits, found.form, scene, found.plan, found.work)


def ray_values(scene: SceneState, rays: GivenRays, query: Query) -> Any:
    """The value of each ray in the rays' leading shape.

    Args:
        scene: what the rays meet.
        rays: the rays.
        query: of a kind whose answers are one array, such as "any" or "count".
    """
    if ANSWERS[query.kind].rules.once:
        scene.require("count")
    found = answer(scene, rays, query) if query.skip is None else answer_skipping(scene, rays, query)
    return found.hits.values(query.kind, found.form)
