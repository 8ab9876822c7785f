"""Streams that shade: rays are filtered by what they hit, and each filtered stream is shaded by its own code.

Gribble and Ramani (2008) see shading as tracing: a stream of hits passes a stack of filters. A filter takes the rays that meet
its condition out of the stream, in order, and hands the others to the next one. Here the conditions are: no hit, then a kind of
material each. What the filters leave is a list of ray numbers for each condition; rays do not move. The code for a list is
`follow_path` with the condition as a constant, so that the compiler drops everything else.

A generation is cut into streams of one length (theirs: 4096 rays), one an item. The lists of a stream follow one another in
`Streams.order`, so the order is also that of a sort by kind within the stream.

The answers are those of `path_step`, bit for bit: a ray's step depends on the ray alone. wrt's pictures are not made in this
way, which the study `studies.light.shading_streams_comparison` measures.

References: gribble-ramani-2008; ramani-2009.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, DIFFUSE, GLOSSY, MIRROR, Materials
from wrt.kernels.shading.wavefront.path_step import MISSED, PathStep, follow_path
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_at_hit import step_arrays
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave, move_ray
from wrt.kernels.shading.wavefront.scene_light import LitScene

FILTERS = (MISSED, DIFFUSE, MIRROR, DIELECTRIC, GLOSSY)
"""The conditions, in the order of the stack."""


@wp.struct
class Streams:
    """Lists of ray numbers: those of one stream after another, within a stream by filter."""

    order: wp.array(dtype=int)
    """(N,) ray numbers."""
    ends: wp.array2d(dtype=int)
    """(streams, filters + 1): list k of a stream is order[ends[s, k]] to order[ends[s, k + 1] - 1]."""


@exact_kernel
def find_kinds(first: int, materials: Materials, hits: HitBatch, kinds: wp.array(dtype=int)):
    """Writes the kind of material that a ray hit, or `MISSED`. Item: a ray. In scenes without instances."""
    i = first + wp.tid()
    kind = int(MISSED)
    if hits.primitive[i] >= 0:
        kind = materials.kind[materials.of_face[hits.primitive[i] * materials.of_face_stride]]
    kinds[i] = kind


@exact_kernel
def find_materials(first: int, materials: Materials, hits: HitBatch, numbers: wp.array(dtype=wp.uint16)):
    """Writes the number of the material that a ray hit plus 1, or 0. Item: a ray. In scenes without instances."""
    i = first + wp.tid()
    number = int(0)
    if hits.primitive[i] >= 0:
        number = materials.of_face[hits.primitive[i] * materials.of_face_stride] + 1
    numbers[i] = wp.uint16(number)


@exact_kernel
def filter_streams(
    first: int,
    length: int,
    kinds: wp.array(dtype=int),
    stack: wp.array(dtype=int),
    rest: wp.array(dtype=int),
    streams: Streams,
):
    """Passes a stream of `length` rays through the stack of filters. Item: a stream. rest: (N,) working memory."""
    item = first + wp.tid()
    begin = item * length
    left = wp.min(length, kinds.shape[0] - begin)
    for i in range(begin, begin + left):
        rest[i] = i
    filled = int(begin)
    streams.ends[item, 0] = begin
    for k in range(stack.shape[0]):
        kept = int(begin)
        for place in range(begin, begin + left):
            i = rest[place]
            # both lists are written, and one of them advances: rays of mixed kinds would mislead a branch. The first has room
            # for this ray, since at least this one has not passed yet.
            passes = int(kinds[i] == stack[k])
            rest[kept] = i
            streams.order[filled] = i
            filled += passes
            kept += 1 - passes
        left = kept - begin
        streams.ends[item, k + 1] = filled


@cache
def make_stream_step(known: int) -> wp.Kernel:
    """The code for the rays of one list of each stream.

    Args:
        known: one of `FILTERS`, or `UNKNOWN` for rays of all kinds.
    """

    @specialised_kernel
    def stream_step(
        first: int,
        number: int,
        streams: Streams,
        step: PathStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        following: RayQueue,
        is_alive: wp.array(dtype=int),
    ):
        """Does the step of path tracing for list `number` of a stream. Item: a stream."""
        item = first + wp.tid()
        arrays = step_arrays(0, source, wave, queue, hits, rays)
        for place in range(streams.ends[item, number], streams.ends[item, number + 1]):
            i = streams.order[place]
            found = follow_path(i, wp.static(known), i, i, step, scene, arrays, following)
            if not step.is_last:
                is_alive[i] = found & 1

    return stream_step


@exact_kernel
def move_hits(first: int, order: wp.array(dtype=int), queue: RayQueue, hits: HitBatch, moved: RayQueue, moved_hits: HitBatch):
    """Copies rays and their hits to another order. Item: a place."""
    place = first + wp.tid()
    i = order[place]
    move_ray(queue, i, moved, place)
    moved_hits.t[place] = hits.t[i]
    moved_hits.primitive[place] = hits.primitive[i]
    moved_hits.uv[place] = hits.uv[i]
