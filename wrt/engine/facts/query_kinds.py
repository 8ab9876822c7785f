"""Kinds of queries, and the word that leaves a choice to the scene."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from wrt.kernels.answers import all_crossings, any_hit, batch_kinds, closest_hit, crossing_count, exact_hit, winding_number

AUTO: Final = "auto"

CLOSEST, ANY, COUNT, ALL, EXACT, WINDING = (
    file.KIND.name for file in (closest_hit, any_hit, crossing_count, all_crossings, exact_hit, winding_number)
)
"""Keys in `wrt.kernels.answers.ANSWERS`, for code that asks a query of such a kind."""

FEW_RAYS = 1024
"""Most rays that are traced one by one on the CPU, whatever they look like: detecting coherence and setting up packets or
streams would take as long as tracing them (`few_rays`)."""

FEW_RAYS_OF_MANY, MANY_TRIANGLES = 512, 50_000
"""The same in a BVH of many triangles, whose rays take longer, and from how many on
(notebooks/records/2026-11-23-few-rays.md)."""


MANY_THREADS = 8
"""Threads from which that limit is the same for all scenes: single rays begin without waking a thread
(notebooks/records/2026-11-28-auto.md)."""


def few_rays(triangles: int, in_bvh: bool, threads: int) -> int:
    """Number of rays up to which each is traced on its own on the CPU, in a scene of one level.

    Args:
        triangles: how many the scene has.
        in_bvh: whether its tree is a BVH.
        threads: how many trace them.
    """
    return FEW_RAYS_OF_MANY if in_bvh and triangles >= MANY_TRIANGLES and threads < MANY_THREADS else FEW_RAYS


class Query(NamedTuple):
    """The kind of a query and its options, with their defaults; `wrt.Scene.intersect` explains them.

    Attributes:
        kind: key in `wrt.kernels.answers.ANSWERS`: "closest", "any", "count", "all" or "winding".
        traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.results.Plan`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
        cull_backfaces: whether triangles are hit only from their front.
        counters: whether the work for each ray is counted.
        mask: of rays in a scene of instances; None for all bits.
        environment: of rays in a scene of instances; None for those that see all.
        areas: influence areas of the rays in a scene of a `wrt.known_rays.RayAwareBvh`; None to find them.
        skip: the triangle that each ray ignores; None for none.
        precise: whether closest hits are computed in float64.
        max_hits: largest number of hits that are listed for each ray; None for all.
    """

    kind: str
    traversal: Any = AUTO
    triangle_test: str = AUTO
    cull_backfaces: bool = False
    counters: bool = False
    mask: Any = None
    environment: Any = None
    areas: Any = None
    skip: Any = None
    precise: bool = False
    max_hits: int | None = None


QUERIES = {kind.name: Query(kind.name) for kind in batch_kinds()}
"""A query of each kind that a batch of rays can be asked, with default options."""
