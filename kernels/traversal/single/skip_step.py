"""The leaf step of queries in which each ray ignores one triangle: the one on which it starts.

**Problem.** A ray that leaves a surface hits the triangle on which it starts again, at t near 0, in front or behind depending
on rounding. A lower bound for t also loses thin walls and corners; `wrt.kernels.query.spawn` moves the origin by more than the
rounding error. If the triangle is known, it can be excluded by its number: the origin stays unchanged, and no other hit is
lost, however near.

**Idea.** The candidate is dropped after its test and before it is compared with the best hit, so no hit that bounds the search
is on the triangle. Boxes are visited as usual. The result is that of the mesh without the triangle, in a scene with the same
bounding box.

**Limits.** Neighbouring triangles are not ignored. A ray from an edge, or within rounding of it, may hit the triangle on the
other side of the edge at t near 0, and a ray from one of two coincident triangles hits the other.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.leaf import Candidate, improves
from wrt.kernels.traversal.search_results import Skipping

exact_module(__name__)


@wp.func
def record_unskipped(search: wp.ref[Skipping], i: int, best: Candidate, t: float, primitive: int, u: float, v: float):
    """Keeps the closest hit that is not on the ignored triangle."""
    if primitive != search.skipped and improves(t, primitive, search.t_min, best):
        best.t = t
        best.primitive = primitive
        best.u = u
        best.v = v
    return best


@wp.func
def count_unskipped(search: wp.ref[Skipping], i: int, best: Candidate, t: float, primitive: int, u: float, v: float):
    """Counts a crossing that is not on the ignored triangle."""
    best.primitive += wp.where(primitive == search.skipped, 0, 1)
    return best
