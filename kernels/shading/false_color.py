"""Values of pixels as colours: depths and costs by a table of colours, directions, and numbers of things.

Colours are for display, in [0, 1]. `to_bytes` rounds them to 8 bits.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

GREY = wp.constant(wp.vec3(0.16, 0.17, 0.19))
"""Of pixels without a value."""

MIN_RANGE = wp.constant(1.0e-30)
"""Least length of a scale: values that are all equal have one of length 0."""


@wp.func
def heat(share: float):
    """Colour of a share in [0, 1]: black, violet, red, orange, yellow, white; brighter for more."""
    x = wp.clamp(share, 0.0, 1.0)
    red = wp.clamp(1.5 * x + 0.4 * x * (1.0 - x), 0.0, 1.0)
    green = wp.clamp(1.8 * x - 0.7, 0.0, 1.0)
    blue = wp.clamp(1.6 * x * (1.0 - 1.6 * x), 0.0, 1.0) + wp.clamp(4.0 * x - 3.0, 0.0, 1.0)
    return wp.vec3(red, green, blue)


@exact_kernel
def color_values(first: int, values: wp.array(dtype=float), low: float, high: float, image: wp.array(dtype=wp.vec3)):
    """Item: a pixel. The colour of its value between `low` and `high`; `GREY` for one that is NaN or infinite."""
    i = first + wp.tid()
    value = values[i]
    if wp.isfinite(value):
        image[i] = heat((value - low) / wp.max(high - low, MIN_RANGE))
    else:
        image[i] = GREY


@exact_kernel
def color_depths(first: int, t: wp.array(dtype=float), low: float, high: float, image: wp.array(dtype=wp.vec3)):
    """Item: a pixel. White for `low`, dark for `high`; `GREY` for a miss."""
    i = first + wp.tid()
    if wp.isfinite(t[i]):
        share = wp.clamp((t[i] - low) / wp.max(high - low, MIN_RANGE), 0.0, 1.0)
        bright = 1.0 - 0.92 * share
        image[i] = wp.vec3(bright, bright, bright)
    else:
        image[i] = GREY


@exact_kernel
def color_normals(first: int, normals: wp.array(dtype=wp.vec3), image: wp.array(dtype=wp.vec3)):
    """Item: a pixel. Components from -1 to 1 as red, green and blue from 0 to 1; `GREY` for a normal of 0."""
    i = first + wp.tid()
    n = normals[i]
    image[i] = wp.where(wp.length_sq(n) > 0.0, wp.vec3(0.5 + 0.5 * n[0], 0.5 + 0.5 * n[1], 0.5 + 0.5 * n[2]), GREY)


SHIFT, FIRST, SECOND = (wp.constant(wp.uint32(number)) for number in (0x9E3779B9, 0x85EBCA6B, 0xC2B2AE35))


@wp.func
def mixed(number: int):
    """A number as 24 bits that look random (the finaliser of MurmurHash3)."""
    h = wp.uint32(number) + SHIFT
    h = (h ^ (h >> wp.uint32(16))) * FIRST
    h = (h ^ (h >> wp.uint32(13))) * SECOND
    return (h ^ (h >> wp.uint32(16))) & wp.uint32(0xFFFFFF)


@exact_kernel
def color_ids(first: int, ids: wp.array(dtype=int), image: wp.array(dtype=wp.vec3)):
    """Item: a pixel. A bright colour for each id, the same in each picture; `GREY` for ids below 0."""
    i = first + wp.tid()
    if ids[i] >= 0:
        bits = mixed(ids[i])
        red = float(bits & wp.uint32(255)) / 255.0
        green = float((bits >> wp.uint32(8)) & wp.uint32(255)) / 255.0
        blue = float(bits >> wp.uint32(16)) / 255.0
        image[i] = wp.vec3(0.25 + 0.75 * red, 0.25 + 0.75 * green, 0.25 + 0.75 * blue)
    else:
        image[i] = GREY


@exact_kernel
def to_bytes(first: int, image: wp.array(dtype=wp.vec3), pixels: wp.array(dtype=wp.uint8)):
    """Item: a pixel. pixels: (3 N,), red, green and blue of each, rounded to the nearest as `wrt.save_image` does."""
    i = first + wp.tid()
    for c in range(3):
        pixels[3 * i + c] = wp.uint8(wp.rint(wp.clamp(image[i][c], 0.0, 1.0) * 255.0))
