"""What the leaves do with a hit where one triangle is left out: the one that the ray starts on.

**Problem.** A ray that leaves a surface meets the triangle that it starts on again, at a t of about 0, in front or behind as
rounding has it. A lower bound for t loses thin walls and corners along with it; `wrt.kernels.query.spawn` moves the origin by
what rounding can do. Where the triangle is known it can be told by its number instead: the origin stays where it is, and
nothing else is lost, however near.

**Idea.** The candidate is dropped after its test and before it is compared with the best hit: whatever bounds a search, its
hits do not come from the triangle. Boxes are visited as before. So the answer is that of the mesh without the triangle, in a
scene of the same box.

**Limits.** Neighbours stay: a ray from an edge, or from beside it within rounding, may meet the triangle on the other side of
the edge at a t of about 0, and a ray from one of two coincident triangles meets the other.
"""

import warp as wp

from wrt.kernels.traversal.leaf import Candidate, improves
from wrt.kernels.traversal.search_results import Skipping

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def take_unskipped(search: wp.ref[Skipping], i: int, best: Candidate, t: float, primitive: int, u: float, v: float):
    """Keeps the nearest hit that is not with the triangle that the ray passes through."""
    if primitive != search.skipped and improves(t, primitive, search.t_min, best):
        best.t = t
        best.primitive = primitive
        best.u = u
        best.v = v
    return best


@wp.func
def count_unskipped(search: wp.ref[Skipping], i: int, best: Candidate, t: float, primitive: int, u: float, v: float):
    """Counts a crossing, if it is not with the triangle that the ray passes through."""
    best.primitive += wp.where(primitive == search.skipped, 0, 1)
    return best
