"""State of a search besides its ray: the destination of its hits, or the data that it needs to find them."""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.traversal_config import EXACT, NEXT, TraversalConfig

exact_module(__name__)


@wp.struct
class PreviousCrossing:
    """For the query `NEXT`: only crossings after this one count, ordered by t, then by triangle."""

    t: float
    primitive: int
    """-1 if there is none."""


@wp.struct
class ExactSearch:
    """For the query `EXACT`: ray and triangles in float64, as the caller gave them, and the closest hit so far."""

    origin: wp.vec3d
    direction: wp.vec3d
    t_min: wp.float64
    vertices: wp.array(dtype=wp.vec3d)
    faces: wp.array(dtype=wp.vec3i)
    t: wp.float64
    """t of the closest hit; before the first hit, the ray's t_max."""
    primitive: int
    """-1 before the first hit."""
    u: wp.float64
    v: wp.float64


@wp.struct
class Skipping:
    """For configs with `skipping`: the triangle that the ray ignores."""

    t_min: float
    """t_min of the ray."""
    skipped: int
    """The ignored triangle; -1 if there is none."""


def results_of(config: TraversalConfig) -> type:
    """The struct that the walk of a specialisation takes as `hits`; batch queries store their hits there."""
    if config.skipping:
        return Skipping
    return {NEXT: PreviousCrossing, EXACT: ExactSearch}.get(config.query, HitBatch)
