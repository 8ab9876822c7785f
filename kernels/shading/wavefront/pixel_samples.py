"""Random numbers of a pixel's samples: points in [0, 1)^2, one dimension for each effect.

A dimension is a pair of numbers: the place in the pixel, the place on the lens, the choice of a light at the second bounce.
A number depends on the seed, the pixel, the sample and the dimension, and on nothing else. In each dimension the samples of a
pixel together cover the square as the sampler says:

    regular   the centres of a grid, the same in all pixels
    random    independent
    jittered  a random point in each cell of a grid (Cook 1986)
    halton    Halton's sequence, shifted at random in each pixel (Cranley and Patterson 1976)
    sobol     Sobol's sequence with Owen's scrambling (`wrt.kernels.shading.sampling`)

The cells of a grid go to the samples in another random order in each dimension and pixel, so that effects are not correlated
(Cook's "prototype patterns" are permuted in the same way). The regular grid keeps its order in dimension 0, the place in the
pixel, and has one random order for all pixels in the others. Halton's sequence serves sixteen dimensions. Further ones are
random: its bases are then so large that few samples leave gaps.

References: halton-1960; cook-1984; cook-1986; kensler-2013 (a permutation by hashing).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.sampling import mix, spread_point, to_unit

SAMPLERS = ("regular", "random", "jittered", "halton", "sobol")
REGULAR, RANDOM, JITTERED, HALTON, SOBOL = (wp.constant(number) for number in range(5))

PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89, 97, 101, 103, 107, 109)
PRIMES += (113, 127, 131)

FILTER = wp.constant(0)
"""Dimension of the place in the pixel."""

LENS = wp.constant(1)
"""Dimension of the place on the lens."""

FIRST_BOUNCE = wp.constant(2)
"""First dimension of the camera ray's hit; each generation of rays has `PER_BOUNCE` dimensions."""

PER_BOUNCE = wp.constant(2)
"""Dimensions of a bounce: the place on a light, the direction of scattering."""


@wp.struct
class PixelSamples:
    """What random numbers depend on."""

    sampler: int
    samples: int
    """Samples of a pixel."""
    columns: int
    """Columns of a grid of a number of cells."""
    seed: wp.uint32
    primes: wp.array(dtype=int)


@wp.func
def permuted(index: int, count: int, seed: wp.uint32):
    """Element `index` of a random permutation of 0 .. count - 1.

    Steps that are invertible modulo a power of two are repeated until the number is below `count` (cycle walking).
    """
    mask = wp.uint32(count - 1)
    mask = mask | (mask >> wp.uint32(1))
    mask = mask | (mask >> wp.uint32(2))
    mask = mask | (mask >> wp.uint32(4))
    mask = mask | (mask >> wp.uint32(8))
    mask = mask | (mask >> wp.uint32(16))
    x = wp.uint32(index)
    is_inside = bool(False)
    while not is_inside:
        salt = wp.uint32(seed)
        for _round in range(4):
            salt = mix(salt, wp.uint32(5))
            x = (x * (salt | wp.uint32(1)) + (salt >> wp.uint32(7))) & mask
            x = x ^ ((x ^ (salt & mask)) >> wp.uint32(1))
            x = x ^ (x >> wp.uint32(3))
        is_inside = int(x) < count
    return int(x)


@wp.func
def radical_inverse(base: int, index: int):
    """The digits of a number behind the point, in reversed order."""
    rest = int(index)
    scale = float(1.0)
    total = float(0.0)
    while rest > 0:
        scale = scale / float(base)
        total += float(rest % base) * scale
        rest = rest / base
    return total


@wp.func
def shifted(value: float, shift: float):
    """Sum modulo 1, below 1."""
    total = value + shift
    return wp.min(total - wp.floor(total), 0.99999994)


@wp.func
def cell_point(source: PixelSamples, cell: int, inner: wp.vec2):
    """A point in a cell of the grid."""
    rows = source.samples / source.columns
    x = (float(cell % source.columns) + inner[0]) / float(source.columns)
    y = (float(cell / source.columns) + inner[1]) / float(rows)
    return wp.vec2(wp.min(x, 0.99999994), wp.min(y, 0.99999994))


@wp.func
def pixel_hash(source: PixelSamples, pixel: int):
    """The part of the random numbers that a pixel's dimensions have in common."""
    return mix(wp.uint32(pixel), source.seed)


@wp.func
def single_number(pixel: wp.uint32, sample: int, dimension: int):
    """An independent random number in [0, 1), for choices that need no stratification."""
    return to_unit(mix(mix(pixel, wp.uint32(0x10000 + dimension)), wp.uint32(sample)))


@wp.func
def pixel_point(source: PixelSamples, pixel: wp.uint32, sample: int, dimension: int):
    """The point of a sample in a dimension.

    Args:
        source: the settings.
        pixel: `pixel_hash` of the pixel.
        sample: number of the sample, from 0.
        dimension: number of the dimension, from 0.
    """
    own = mix(pixel, wp.uint32(dimension))
    result = wp.vec2()
    if source.sampler == SOBOL:
        result = spread_point(sample, own)
    elif source.sampler == REGULAR:
        cell = int(sample)
        if dimension > 0:
            cell = permuted(sample, source.samples, mix(source.seed, wp.uint32(dimension)))
        result = cell_point(source, cell, wp.vec2(0.5, 0.5))
    elif source.sampler == HALTON and dimension < 16:
        x = radical_inverse(source.primes[2 * dimension], sample)
        y = radical_inverse(source.primes[2 * dimension + 1], sample)
        result = wp.vec2(shifted(x, to_unit(own)), shifted(y, to_unit(mix(own, wp.uint32(3)))))
    else:
        salt = mix(own, wp.uint32(sample))
        result = wp.vec2(to_unit(salt), to_unit(mix(salt, wp.uint32(3))))
        if source.sampler == JITTERED:
            result = cell_point(source, permuted(sample, source.samples, own), result)
    return result


@exact_kernel
def list_points(first: int, source: PixelSamples, pixel: int, dimension: int, points: wp.array(dtype=wp.vec2)):
    """Writes the point of a sample. Item: a sample."""
    i = first + wp.tid()
    points[i] = pixel_point(source, pixel_hash(source, pixel), i, dimension)
