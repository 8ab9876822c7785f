"""The bounds, and the loop that looks for counterexamples to them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from . import box_bounds, triangle_bounds
from .inputs import SCALES


@dataclass(frozen=True)
class Bound:
    """A bound.

    Attributes:
        proof: file, from the root of the repository, whose docstring or heading proves it.
        search: (rng, cases, scales) -> (N,) ratios of what was found to what is allowed. scales: sizes are 2^-scales to
            2^scales, or a smaller range where the bound holds in that only.
    """

    proof: str
    search: Callable[[np.random.Generator, int, int], np.ndarray]


BOUNDS = {
    "slab": Bound("kernels/simd/boxes.py", box_bounds.search_slab),
    "exact": Bound("kernels/answers/exact_hit.py", box_bounds.search_exact),
    "fused": Bound("kernels/native/interleaved.h", box_bounds.search_fused),
    "sheared": Bound("kernels/triangle/watertight/woop_areas.py", triangle_bounds.search_sheared),
    "hits": Bound("kernels/triangle/watertight/woop_areas.py", triangle_bounds.search_hits),
    "spawn": Bound("kernels/query/spawn.py", triangle_bounds.search_spawned),
    "edges": Bound("kernels/traversal/packet/leaves/edge_functions.py", triangle_bounds.search_edges),
    "vertices": Bound("kernels/traversal/packet/culling/vertex_culling.py", triangle_bounds.search_vertices),
    "planes": Bound("kernels/query/open_segments.py", triangle_bounds.search_planes),
    "ends": Bound("kernels/traversal/packet/rays/reversed_bounds.py", triangle_bounds.search_ends),
    "clip": Bound("builders/core/clip.py", triangle_bounds.search_clip),
}
"""By name. docs/internals/bounds.md has a row for each."""

BATCH = 1 << 17
"""Cases at a time: their arrays stay in the outer caches."""


def batches(name: str, count: int, seed: int, most: int = SCALES) -> Iterator[tuple[int, np.ndarray]]:
    """(seed, ratios) of each batch, until `count` cases have been searched."""
    for number in range(-(-count // BATCH)):
        size = min(BATCH, count - number * BATCH)
        yield number, BOUNDS[name].search(np.random.default_rng([seed, number]), size, most)
