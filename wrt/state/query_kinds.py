"""Kinds of queries, and the word that leaves a choice to the scene."""

from __future__ import annotations

from typing import Any, NamedTuple

AUTO = "auto"

CLOSEST, ANY, COUNT, ALL, EXACT = "closest", "any", "count", "all", "exact"

FEW_RAYS = 1024
"""Rays up to which each goes alone on the CPU: to detect coherence and to set up packets or streams would take as long as to
trace them."""


class Query(NamedTuple):
    """What is asked about rays, and what the caller chose.

    Attributes:
        kind: "closest", "any", "count" or "all".
        traversal: "auto", a key of `wrt.kernels.traversal.TRAVERSALS`, or a `wrt.Plan`.
        triangle_test: "auto" or a key of `wrt.kernels.triangle.TRIANGLE_TESTS`.
        cull_backfaces: whether triangles are hit only from their front.
        counters: whether the work for each ray is counted.
    """

    kind: str
    traversal: Any = AUTO
    triangle_test: str = AUTO
    cull_backfaces: bool = False
    counters: bool = False
