"""A variant of other kinds, in which rays pass through the holes of alpha masks.

**Problem.** A leaf is often two triangles with an image of a leaf; where its alpha is low, nothing is there. A ray that starts
again behind such a hit loses what is nearer than its new start, or finds the same hit twice.

**Idea.** The candidate is dropped after its test and before it bounds the search, as in `skipped_triangle`: the answer is that
of brute force over the points that are there.

**Data.** The alpha of a material's image, 8 bits, interpolated bilinearly as colours are, at the texture coordinates of a hit.
It is there if alpha is at least the cutoff, as in glTF's mode MASK.
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Search, improves
from wrt.kernels.images.image_footprint import footprint
from wrt.kernels.layout.ray_batch import HitBatch


@wp.struct
class AlphaMasks:
    """M images, and the triangles that have them. Geometry shared by instances counts once in F."""

    of_face: wp.array(dtype=int)
    """(F,) the image of each triangle; -1 for a triangle without holes."""
    corner_uv: wp.array(dtype=wp.vec2)
    """(3 F,) texture coordinates of the corners."""
    first_triangle: wp.array(dtype=int)
    """(N + 1,) number of the first triangle of each instance."""
    first_face: wp.array(dtype=int)
    """(N,) the first triangle of each instance's mesh among the F; (0,) in scenes of one level."""
    first_texel: wp.array(dtype=wp.int64)
    """(M,) where each image begins in `texels`."""
    size: wp.array(dtype=wp.vec2i)
    """(M,) width and height."""
    wrap: wp.array(dtype=wp.vec2i)
    """(M,) as in `wrt.kernels.images.image_footprint`."""
    cutoff: wp.array(dtype=float)
    """(M,) least alpha that is there, of 255."""
    texels: wp.array(dtype=wp.uint8)
    """Alpha, row by row; row 0 is at the top, v = 1."""


@wp.struct
class MaskedSearch:
    """What a ray meets, and where its hits are stored."""

    t_min: float
    first_face: int
    """The first triangle of the instance that the ray is in, of `AlphaMasks.of_face`; 0 in scenes of one level."""
    masks: AlphaMasks
    hits: HitBatch


@wp.func
def begin_masked(masks: AlphaMasks, hits: HitBatch, i: int, t_min: float):
    """The search of a ray."""
    search = MaskedSearch()
    search.t_min = t_min
    search.masks = masks
    search.hits = hits
    return search


@wp.func
def within_masked(first: int, search: MaskedSearch):
    """The search in an instance, whose triangles are numbered from `first` on."""
    low = int(0)
    count = search.masks.first_face.shape[0]
    while count > 1:
        half = count / 2
        low = wp.where(search.masks.first_triangle[low + half] <= first, low + half, low)
        count = count - half
    own = search  # a copy
    own.first_face = search.masks.first_face[low]
    return own


@wp.func
def alpha_at(masks: AlphaMasks, image: int, place: wp.int64):
    """A texel."""
    return float(masks.texels[masks.first_texel[image] + place])


@wp.func
def is_there(masks: AlphaMasks, face: int, u: float, v: float):
    """Whether a point of a triangle is no hole."""
    image = masks.of_face[face]
    there = bool(True)
    if image >= 0:
        weight = 1.0 - u - v
        uv = weight * masks.corner_uv[3 * face] + u * masks.corner_uv[3 * face + 1] + v * masks.corner_uv[3 * face + 2]
        size = masks.size[image]
        at = footprint(size, masks.wrap[image], uv)
        upper = wp.int64(at.top) * wp.int64(size[0])
        lower = wp.int64(at.bottom) * wp.int64(size[0])
        upper_left = alpha_at(masks, image, upper + wp.int64(at.left))
        lower_left = alpha_at(masks, image, lower + wp.int64(at.left))
        above = upper_left + at.across * (alpha_at(masks, image, upper + wp.int64(at.right)) - upper_left)
        below = lower_left + at.across * (alpha_at(masks, image, lower + wp.int64(at.right)) - lower_left)
        there = above + at.down * (below - above) >= masks.cutoff[image]
    return there


@wp.func
def accept_nearest(search: wp.ref[MaskedSearch], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Keeps the closest hit that is there."""
    if improves(t, primitive, search.t_min, best):  # noqa: SIM102  (Warp evaluates both operands of `and`)
        if is_there(search.masks, search.first_face + primitive, u, v):
            best.t = t
            best.primitive = primitive
            best.u = u
            best.v = v
    return best


@cache
def masking(kind: AnswerKind) -> AnswerKind:
    """The variant of a kind of query, which must not be `oriented`: u would be no weight."""
    accept, renumber = kind.search.accept, kind.instances.renumber

    @wp.func
    def accept_there(search: wp.ref[MaskedSearch], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
        if is_there(search.masks, search.first_face + primitive, u, v):
            best = accept(search.hits, i, best, t, primitive, u, v)
        return best

    @wp.func
    def renumber_there(search: wp.ref[MaskedSearch], i: int, count: int, first: int):
        renumber(search.hits, i, count, first)

    return replace(
        kind,
        search=Search(MaskedSearch, accept_nearest if kind.nearest else accept_there, Given=AlphaMasks, begin=begin_masked),
        instances=replace(kind.instances, renumber=None if renumber is None else renumber_there, within=within_masked),
    )
