"""What a search carries along besides its ray: where its hits go, or what it has to know to find them."""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.traversal.traversal_config import EXACT, NEXT, TraversalConfig

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class Passed:
    """For the query `NEXT`: only crossings that come after this one count, by t, then by triangle."""

    t: float
    primitive: int
    """-1 if there is none."""


@wp.struct
class ExactSearch:
    """For the query `EXACT`: the ray and the triangles as they were given, and the nearest hit so far."""

    origin: wp.vec3d
    direction: wp.vec3d
    t_min: wp.float64
    vertices: wp.array(dtype=wp.vec3d)
    faces: wp.array(dtype=wp.vec3i)
    t: wp.float64
    """Before the first hit, the ray's t_max."""
    primitive: int
    """-1 before the first hit."""
    u: wp.float64
    v: wp.float64


@wp.struct
class Skipping:
    """For configs that are `skipping`: what the ray passes through."""

    t_min: float
    """The ray's."""
    skipped: int
    """The triangle; -1 if there is none."""


def results_of(config: TraversalConfig) -> type:
    """The struct that a specialisation's walk takes as `hits`; queries of whole batches store their hits there."""
    if config.skipping:
        return Skipping
    return {NEXT: Passed, EXACT: ExactSearch}.get(config.query, HitBatch)
