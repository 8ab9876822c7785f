"""Kernels that walk the trees of two bodies; the walk is in kernels/native/pairs.h."""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import MAX_LEAF_TRIANGLES, MAX_WIDE_DEPTH, WideNodes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel


@wp.struct
class Body:
    """A mesh in a scene: its tree, its triangles as they were given, and its map."""

    nodes: WideNodes
    """Boxes are relative to the mesh's centre."""
    primitive: wp.array(dtype=int)
    """(blocks * W,) the triangles in the order of the leaves."""
    vertices: wp.array(dtype=wp.vec3d)
    """(V,) in the mesh's space."""
    faces: wp.array(dtype=wp.vec3i)
    linear: wp.mat33d
    """A point p of the mesh maps to linear p + origin."""
    origin: wp.vec3d
    center: wp.vec3d
    """The mesh's centre in the scene."""


@wp.struct
class PairWork:
    """Pairs of boxes below which to look."""

    boxes: wp.array(dtype=wp.vec2i)
    """(N,) node * W + child of a box of each tree."""
    square: wp.array(dtype=wp.float64)
    """(N,) their squared distances."""
    max_square: wp.array(dtype=wp.float64)
    """(1,) `limit`, which falls to the squared distance of the nearest pair so far."""
    limit: wp.float64
    """Greatest squared distance of a pair that is found."""
    slack: wp.float64
    """By how much distances of boxes may be too large."""
    near_slack: wp.float64
    """By how much distances of triangles may be too small."""


@wp.struct
class NearestPairs:
    """The nearest pair below each of N entries of the work."""

    square: wp.array(dtype=wp.float64)
    """Squared distance; inf if nothing was found."""
    triangles: wp.array(dtype=wp.vec2i)
    """One of each body; -1 if nothing was found."""
    first: wp.array(dtype=wp.vec3d)
    """The point of the first body."""
    second: wp.array(dtype=wp.vec3d)


@wp.struct
class PairLists:
    """The pairs of triangles that meet below each of N entries of the work."""

    count: wp.array(dtype=int)
    begin: wp.array(dtype=wp.int64)
    """(N,) where the pairs of each entry begin; (0,) while they are only counted."""
    pairs: wp.array(dtype=wp.vec2i)


GUARDS = f"""static_assert(wrt::pairs::DEPTH == {MAX_WIDE_DEPTH} && wrt::pairs::LEAF == {MAX_LEAF_TRIANGLES});
"""


@cache
def make_nearest_kernel(width: int) -> wp.Kernel:
    """The kernel that finds nearest pairs, for trees of a width. Item: an entry of the work."""

    @native.func_native("pairs.h", f"{GUARDS}wrt::pairs::nearest_below<{width}>(a, b, work, found, i);")
    def nearest_below(a: Body, b: Body, work: PairWork, found: NearestPairs, i: int): ...

    def nearest_pairs(first: int, a: Body, b: Body, work: PairWork, found: NearestPairs):
        nearest_below(a, b, work, found, first + wp.tid())

    return specialised_kernel(nearest_pairs)


@cache
def make_meeting_kernel(width: int) -> wp.Kernel:
    """The kernel that counts or lists pairs that meet, for trees of a width. Item: an entry of the work."""

    @native.func_native("pairs.h", f"{GUARDS}wrt::pairs::meeting_below<{width}>(a, b, work, lists, i);")
    def meeting_below(a: Body, b: Body, work: PairWork, lists: PairLists, i: int): ...

    def meeting_pairs(first: int, a: Body, b: Body, work: PairWork, lists: PairLists):
        meeting_below(a, b, work, lists, first + wp.tid())

    return specialised_kernel(meeting_pairs)
