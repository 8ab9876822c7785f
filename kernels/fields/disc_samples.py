"""A round of choosing points that are apart from each other: see `wrt.analysis.surface_samples`."""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

OPEN, KEPT, LEFT_OUT = wp.constant(0), wp.constant(1), wp.constant(2)
"""What is known of a point."""


@exact_kernel
def settle(
    first: int,
    grid: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    radius: float,
    before: wp.array(dtype=int),
    after: wp.array(dtype=int),
):
    """Writes what is known of a point after the round before. Item: a point."""
    i = first + wp.tid()
    known = before[i]
    if known == OPEN:
        known = KEPT
        query = wp.hash_grid_query(grid, points[i], radius)
        j = int(0)
        while wp.hash_grid_query_next(query, j):
            if j < i and wp.length_sq(points[j] - points[i]) < radius * radius:
                if before[j] == KEPT:
                    known = LEFT_OUT
                    break
                elif before[j] == OPEN and known == KEPT:
                    known = OPEN
    after[i] = known
