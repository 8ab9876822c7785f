"""The rays of a generation, and their compaction.

A step writes the rays that follow from ray i at the places i * branches .. i * branches + branches - 1 of a second queue, and
whether each goes on. Then the places are summed (count, scan), and the rays that go on are moved together (fill). Their order
stays, so the rays of a sample stay neighbours. Tile by tile, steps append rays instead (`wrt.kernels.shading.paths`,
`wrt.kernels.shading.ray_trees`).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class RayQueue:
    """Rays with what they carry."""

    origin: wp.array(dtype=wp.vec3)
    """Relative to the scene's centre."""
    direction: wp.array(dtype=wp.vec3)
    """Unit vectors."""
    weight: wp.array(dtype=wp.vec3)
    """Share of the radiance along the ray that reaches the sample."""
    density: wp.array(dtype=float)
    """Density with which the direction was sampled, per solid angle; 0 if there was only this one."""
    slot: wp.array(dtype=int)
    """Number of the sample in its wave."""
    media: wp.array(dtype=wp.uint64)
    """The media that contain the ray: `wrt.kernels.shading.bsdf.interior`."""


@wp.struct
class Wave:
    """The samples that are traced together: of some pixels, `samples` of each. Those of a pixel have consecutive numbers, and
    so have the pixels of a small square: rays of consecutive samples are similar."""

    order: wp.array(dtype=int)
    """(P,) numbers of the picture's pixels in the order in which they are traced."""
    first_pixel: int
    """Place of the first pixel in `order`."""
    first_sample: int
    samples: int


@wp.struct
class Gathered:
    """Light that the rays of a generation collect."""

    emitted: wp.array(dtype=wp.vec3)
    """(N,) weighted radiance that needs no further ray."""
    lit: wp.array(dtype=wp.vec3)
    """(N,) weighted radiance, if the shadow ray is not blocked."""
    shadow_origin: wp.array(dtype=wp.vec3)
    shadow_direction: wp.array(dtype=wp.vec3)
    """(N,) vectors to the light, at t = 1; 0 where there is none."""
    radiance: wp.array(dtype=wp.vec3)
    """(slots,) sums of the samples."""


@wp.func
def pixel_of(wave: Wave, slot: int):
    """Number of the pixel of a sample of a wave."""
    return wave.order[wave.first_pixel + slot / wave.samples]


@wp.func
def move_ray(source: RayQueue, i: int, target: RayQueue, to: int):
    """Copies ray i of one queue to a place of another."""
    target.origin[to] = source.origin[i]
    target.direction[to] = source.direction[i]
    target.weight[to] = source.weight[i]
    target.density[to] = source.density[i]
    target.slot[to] = source.slot[i]
    target.media[to] = source.media[i]


@exact_kernel
def fill(first: int, scratch: RayQueue, is_alive: wp.array(dtype=int), places: wp.array(dtype=int), queue: RayQueue):
    """Moves a ray that goes on to its place. Item: a place of the scratch queue; `places` are inclusive sums."""
    i = first + wp.tid()
    if is_alive[i] != 0:
        move_ray(scratch, i, queue, places[i] - 1)


@exact_kernel
def settle_paths(
    first: int,
    blocked: wp.array(dtype=wp.bool),
    rays: Gathered,
    scratch: RayQueue,
    is_alive: wp.array(dtype=int),
    places: wp.array(dtype=int),
    queue: RayQueue,
):
    """Adds the light of a shadow ray to its sample, and moves the path on to its place. Item: a path. A sample has one path, so
    no two items add to the same sample; `blocked` may be empty: there are no shadow rays."""
    i = first + wp.tid()
    if blocked.shape[0] > 0:  # noqa: SIM102 - in a kernel, `and` evaluates both sides
        if not blocked[i]:
            slot = scratch.slot[i]
            rays.radiance[slot] = rays.radiance[slot] + rays.lit[i]
    if is_alive[i] != 0:
        move_ray(scratch, i, queue, places[i] - 1)


@exact_kernel
def gather(
    first: int, count: int, slot: wp.array(dtype=int), with_emitted: bool, blocked: wp.array(dtype=wp.bool), rays: Gathered
):
    """Adds the light of a generation to its samples. Item: a ray; the first one of a sample adds for all of them, in order."""
    i = first + wp.tid()
    own = slot[i]
    is_first = True
    if i > 0:
        is_first = slot[i - 1] != own
    if is_first:
        total = rays.radiance[own]
        j = int(i)
        is_more = bool(True)
        while is_more:
            if with_emitted:
                total += rays.emitted[j]
            if blocked.shape[0] > 0:  # noqa: SIM102 - in a kernel, `and` evaluates both sides
                if not blocked[j]:
                    total += rays.lit[j]
            j += 1
            is_more = False
            if j < count:
                is_more = slot[j] == own
        rays.radiance[own] = total
