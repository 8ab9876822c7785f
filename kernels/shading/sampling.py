"""Low-discrepancy random numbers without a table: Owen-scrambled Sobol points, with a separate sequence for every pixel.

**Problem.** A pixel's ambient rays should cover the hemisphere evenly, whatever their number. Those of neighbouring pixels
should be uncorrelated, otherwise the error shows as bands and ghost edges instead of fine grain.

**Method.** The first two dimensions of the Sobol sequence are a (0, 2)-sequence: every run of 2^k points that starts at a
multiple of 2^k has one point in each elementary box of area 2^-k. Owen scrambling flips each bit at random, depending on all
higher bits. It keeps that property, removes the regular pattern and makes the estimate unbiased. Laine and Karras found a hash
that does this from the lowest bit up, in a few multiplications. Burley applies it between two bit reversals, to the index (so
that each pixel has its own order) and to each coordinate. The constants are theirs.

References: sobol-1967; owen-1995; kollig-keller-2002; laine-karras-2011; burley-2020; duff-2017.
"""

import warp as wp

TWO_PI = wp.constant(6.283185307179586)
UNIT = wp.constant(2.0**-24)

# 32-bit constants: as literals in a kernel they would be signed.
MIX_1 = wp.constant(wp.uint32(0x9E3779B1))
MIX_2 = wp.constant(wp.uint32(0x85EBCA6B))
MIX_3 = wp.constant(wp.uint32(0xC2B2AE35))
OWEN_1 = wp.constant(wp.uint32(0x6C50B47C))
OWEN_2 = wp.constant(wp.uint32(0xB82F1E52))
OWEN_3 = wp.constant(wp.uint32(0xC7AFE638))
OWEN_4 = wp.constant(wp.uint32(0x8D22F6E6))


@wp.func
def mix(value: wp.uint32, salt: wp.uint32):
    """Hash of two numbers. Every bit of the result depends on every bit of both."""
    h = value * MIX_1 + salt
    h = (h ^ (h >> wp.uint32(16))) * MIX_2
    h = (h ^ (h >> wp.uint32(13))) * MIX_3
    return h ^ (h >> wp.uint32(16))


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __brev(x);
#else
    return __builtin_bitreverse32(x);
#endif
""")
def reverse_bits(x: wp.uint32) -> wp.uint32:
    """Reverses the order of the 32 bits."""


@wp.func
def owen_scramble_reversed(x: wp.uint32, seed: wp.uint32):
    """Scrambles a bit-reversed number: each bit is flipped depending on the bits below it (Laine and Karras 2011)."""
    r = x + seed
    r = r ^ (r * OWEN_1)
    r = r ^ (r * OWEN_2)
    r = r ^ (r * OWEN_3)
    return r ^ (r * OWEN_4)


@wp.func
def sobol_second(index: wp.uint32):
    """Second coordinate of the Sobol sequence, as a 32-bit fraction (the first is `reverse_bits(index)`).

    The bits of its matrix are Pascal's triangle modulo 2. That is Sierpinski's triangle: three of the four quarters are equal
    and one is empty, and so are their quarters in turn. So the product takes one step for each halving.
    """
    r = reverse_bits(index)
    r = r ^ (r << wp.uint32(16))
    r = r ^ ((r & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    r = r ^ ((r & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    r = r ^ ((r & wp.uint32(0x33333333)) << wp.uint32(2))
    return r ^ ((r & wp.uint32(0x55555555)) << wp.uint32(1))


@wp.func
def to_unit(x: wp.uint32):
    """A 32-bit fraction as a float in [0, 1)."""
    return float(x >> wp.uint32(8)) * UNIT


@wp.func
def spread_point(index: int, seed: wp.uint32):
    """Point number `index` of the sequence that belongs to `seed`, in [0, 1)^2."""
    order = reverse_bits(owen_scramble_reversed(reverse_bits(wp.uint32(index)), seed))
    x = owen_scramble_reversed(order, mix(seed, wp.uint32(1)))  # the first coordinate is the index, reversed
    y = owen_scramble_reversed(reverse_bits(sobol_second(order)), mix(seed, wp.uint32(2)))
    return wp.vec2(to_unit(reverse_bits(x)), to_unit(reverse_bits(y)))


@wp.func
def direction_of(turns: float):
    """Cosine and sine of an angle in turns, to 1e-7: polynomials within an eighth of a turn (Moshier's, of the library Cephes).
    Without a call, and with the same bits on all devices and in lanes."""
    quarters = wp.floor(4.0 * turns + 0.5)
    a = (4.0 * turns - quarters) * 1.5707963267948966
    z = a * a
    s = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * a + a
    c = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * z * z - 0.5 * z + 1.0
    quarter = int(quarters) & 3
    swaps = (quarter & 1) != 0
    first = wp.where(swaps, s, c)
    second = wp.where(swaps, c, s)
    return wp.vec2(wp.where(quarter == 1 or quarter == 2, -first, first), wp.where(quarter >= 2, -second, second))


@wp.func
def cosine_direction(normal: wp.vec3, point: wp.vec2):
    """Maps [0, 1)^2 to unit directions about a unit normal, with a density proportional to the cosine to it."""
    # basis of Duff et al. 2017
    sign = wp.where(normal[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    tangent = wp.vec3(1.0 + sign * normal[0] * normal[0] * a, sign * b, -sign * normal[0])
    bitangent = wp.vec3(b, sign + normal[1] * normal[1] * a, -normal[1])
    radius = wp.sqrt(point[0])
    turn = direction_of(point[1])
    height = wp.sqrt(wp.max(1.0 - point[0], 0.0))
    return radius * turn[0] * tangent + radius * turn[1] * bitangent + height * normal
