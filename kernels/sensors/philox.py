"""Random numbers by a counter: Philox4x32-10.

**Problem.** The noise of a return must not depend on threads, chunks or the order in which returns are computed, and the same
seed must give the same bits.

**Idea.** A block cipher of few rounds maps a counter to four random words; the key is the seed. So the noise of a return is a
function of its number. The generator passes the tests of BigCrush, and its authors publish known answers, which the tests use.

References: salmon-2011; box-muller-1958.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

ROUNDS = 10
MULTIPLIER_0 = wp.constant(wp.uint64(0xD2511F53))
MULTIPLIER_1 = wp.constant(wp.uint64(0xCD9E8D57))
WEYL_0 = wp.constant(wp.uint32(0x9E3779B9))
WEYL_1 = wp.constant(wp.uint32(0xBB67AE85))
SHIFT = wp.constant(wp.uint64(32))
UNIT = wp.constant(wp.float64(2.0**-32))
TWO_PI = wp.constant(wp.float64(6.283185307179586))


@wp.func
def philox(counter: wp.vec4ui, key: wp.vec2ui):
    """Four random words of 32 bits for a counter of four words and a key of two."""
    c0 = counter[0]
    c1 = counter[1]
    c2 = counter[2]
    c3 = counter[3]
    k0 = key[0]
    k1 = key[1]
    for _ in range(ROUNDS):
        product_0 = MULTIPLIER_0 * wp.uint64(c0)
        product_1 = MULTIPLIER_1 * wp.uint64(c2)
        c0 = wp.uint32(product_1 >> SHIFT) ^ c1 ^ k0
        c1 = wp.uint32(product_1)
        c2 = wp.uint32(product_0 >> SHIFT) ^ c3 ^ k1
        c3 = wp.uint32(product_0)
        k0 = k0 + WEYL_0
        k1 = k1 + WEYL_1
    return wp.vec4ui(c0, c1, c2, c3)


@wp.func
def uniform(word: wp.uint32):
    """A random word as a number in (0, 1), never 0 or 1."""
    return (wp.float64(word) + wp.float64(0.5)) * UNIT


@wp.func
def normal_number(first: wp.uint32, second: wp.uint32):
    """The first number of `normal_pair`."""
    radius = wp.sqrt(wp.float64(-2.0) * wp.log(uniform(first)))
    return radius * wp.cos(TWO_PI * uniform(second))


@wp.func
def normal_pair(first: wp.uint32, second: wp.uint32):
    """Two independent numbers of the standard normal distribution from two random words (Box and Muller 1958)."""
    radius = wp.sqrt(wp.float64(-2.0) * wp.log(uniform(first)))
    angle = TWO_PI * uniform(second)
    return wp.vec2d(radius * wp.cos(angle), radius * wp.sin(angle))


@wp.kernel
def random_words(first: int, key: wp.vec2ui, counters: wp.array(dtype=wp.vec4ui), words: wp.array(dtype=wp.vec4ui)):
    """Writes the words of a counter. Item: a counter."""
    i = first + wp.tid()
    words[i] = philox(counters[i], key)
