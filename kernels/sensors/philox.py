"""Random numbers by a counter: Philox4x32-10.

**Problem.** The noise of a return must not depend on threads, chunks or the order in which returns are computed, and the same
seed must give the same bits.

**Idea.** A block cipher of few rounds maps a counter to four random words; the key is the seed. So the noise of a return is a
function of its number. The generator passes the tests of BigCrush, and its authors publish known answers, which the tests use.

References: salmon-2011; box-muller-1958.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel


@native.func_native(
    "sensor_noise.h",
    """const wrt::PhiloxWords from {{counter.c[0], counter.c[1], counter.c[2], counter.c[3]}};
    const wrt::PhiloxWords words = wrt::philox(from, key.c[0], key.c[1]);
    return {words.c[0], words.c[1], words.c[2], words.c[3]};""",
)
def philox(counter: wp.vec4ui, key: wp.vec2ui) -> wp.vec4ui:
    """Four random words of 32 bits for a counter of four words and a key of two."""


@native.func_native(
    "sensor_noise.h",
    """const double radius = wrt::square_root(-2.0 * wrt::log_of_unit(first));
    const wrt::CosineSine turn = wrt::turn_by_unit(second);
    return {radius * turn.cosine, radius * turn.sine};""",
)
def normal_pair(first: wp.uint32, second: wp.uint32) -> wp.vec2d:
    """Two independent numbers of the standard normal distribution from two random words (Box and Muller 1958)."""


@exact_kernel
def random_words(first: int, key: wp.vec2ui, counters: wp.array(dtype=wp.vec4ui), words: wp.array(dtype=wp.vec4ui)):
    """Writes the words of a counter. Item: a counter."""
    i = first + wp.tid()
    words[i] = philox(counters[i], key)
