"""Mailboxes: what has been tested already need not be tested again (survey, section 4.1).

**Problem.** A triangle that straddles a splitting plane is in several leaves of a kd-tree; a ray, or a packet, that visits
two of them tests it twice.

**Ideas.** Arnaldi, Priol and Bouatouch kept the last ray's number with each object. Threads would fight over these numbers,
so the memory moved to the ray. *Hashed* (Wald et al. 2001): a table a ray, a triangle's slot follows from its id, and a newer
triangle drives out an older one. *Inverse* (Shevtsov et al. 2007): the ids of the last eight triangles, in a ring; every
triangle is compared with all eight at once.

**Granularity: triangles.** Every leaf has blocks of its own, so a block is never met twice by one ray; its triangles are.
* A packet asks for the triangles of a block that its culling has left, a few of W, and each that it need not test saves
  P / W vector tests.
* A single ray tests W triangles at once, whether one is new or all: it can skip a block only if all of its triangles are
  known. A ring of eight does not even hold a block of sixteen.

**Measured** (one core of a Zen 5, the bunny, blocks of 16). Packets of 64: 1 to 4 % of a leaf's triangles are avoided, which
is 12 to 21 % of those that culling has left; camera rays run at 0.97 to 1.08 times the speed without, shadow rays at 0.9
times. Single rays can almost never skip a block of 16 and pay for asking: 0.65 to 0.86 times; with blocks of 4, at most 2 %
are avoided, at 0.8 to 0.92 times. Shevtsov et al. report 10 to 23 % for the inverse mailbox: as many are spared here, but
testing them takes little of the time. So "none" is the default.

Forgetting and testing again is always right: the same hit is found again, and replaces nothing.

**Contract.** A mailbox is an array of ints of one ray or packet, all 0 at first, and `filter(width)`, a
`wp.func(ids, block, mask, mailbox) -> mask` that takes the triangles which it remembers out of the mask, and notes the others.

References:
    B. Arnaldi, T. Priol, K. Bouatouch: A new space subdivision method for ray tracing CSG modelled scenes.
        The Visual Computer 3, 1987.
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
    M. Shevtsov, A. Soupikov, A. Kapustin: Ray-triangle intersection algorithm for modern CPU architectures.
        GraphiCon 2007.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.simd.lanes import FOR_LANES

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

RING = 8
"""Triangles that an inverse mailbox remembers."""

SLOTS = 64
"""Of a hashed mailbox, a power of two."""

# Memory holds id + 1, so that 0 is nobody.
_HASHED = """
    const int* id = ids.data + (size_t)block * W;
    unsigned fresh = 0;
    WRT_FOR_LANES(i) { fresh |= ((id[i] >= 0) & (mailbox.data[id[i] & (SLOTS - 1)] != id[i] + 1)) ? 1u << i : 0u; }
    fresh &= mask;
    for (int i = 0; i < W; ++i) if (fresh >> i & 1u) mailbox.data[id[i] & (SLOTS - 1)] = id[i] + 1;
    return fresh;
"""

_INVERSE = """
    const int* id = ids.data + (size_t)block * W;
    int ring[RING];
    for (int r = 0; r < RING; ++r) ring[r] = mailbox.data[r];
    unsigned fresh = 0;
    WRT_FOR_LANES(i) {
        int known = id[i] < 0 ? 1 : 0;
        for (int r = 0; r < RING; ++r) known |= ring[r] == id[i] + 1 ? 1 : 0;
        fresh |= known ? 0u : 1u << i;
    }
    fresh &= mask;
    int next = mailbox.data[RING];
    for (int i = 0; i < W; ++i) if (fresh >> i & 1u) { mailbox.data[next] = id[i] + 1; next = (next + 1) & (RING - 1); }
    mailbox.data[RING] = next;
    return fresh;
"""


def _lanes(width: int) -> str:
    return f"{FOR_LANES}    constexpr int W = {width}, RING = {RING}, SLOTS = {SLOTS};"


@cache
def hashed_filter(width: int) -> wp.Function:
    """A table of `SLOTS` ids."""

    @wp.func_native(_lanes(width) + _HASHED)
    def hashed(ids: wp.array(dtype=int), block: int, mask: wp.uint32, mailbox: wp.array(dtype=int)) -> wp.uint32: ...

    return hashed


@cache
def inverse_filter(width: int) -> wp.Function:
    """A ring of `RING` ids, and behind them the place of the next."""

    @wp.func_native(_lanes(width) + _INVERSE)
    def inverse(ids: wp.array(dtype=int), block: int, mask: wp.uint32, mailbox: wp.array(dtype=int)) -> wp.uint32: ...

    return inverse


@cache
def no_filter(width: int) -> wp.Function:
    """Everything is new."""

    @wp.func
    def none(ids: wp.array(dtype=int), block: int, mask: wp.uint32, mailbox: wp.array(dtype=int)):
        return mask

    return none


@dataclass(frozen=True)
class Mailbox:
    """A way to remember triangles.

    Attributes:
        name: key in `MAILBOXES`.
        paper: authors, title, year.
        size: ints of memory; at least one, for an array must not be empty.
        filter: width -> `wp.func(ids, block, mask, mailbox) -> mask`.
    """

    name: str
    paper: str
    size: int
    filter: Callable[[int], wp.Function]


NONE = "none"

MAILBOXES: dict[str, Mailbox] = {
    mailbox.name: mailbox
    for mailbox in (
        Mailbox(NONE, "every triangle is tested in every leaf that has it", 1, no_filter),
        Mailbox("hashed", "Wald et al.: Interactive rendering with coherent ray tracing (2001)", SLOTS, hashed_filter),
        Mailbox(
            "inverse",
            "Shevtsov, Soupikov, Kapustin: Ray-triangle intersection algorithm for modern CPU architectures (2007)",
            RING + 1,
            inverse_filter,
        ),
    )
}
