"""Mailboxes: an array, a hash table or a ring of the triangles that a ray or packet has tested.

**Ideas.** Arnaldi, Priol and Bouatouch stored the number of the last ray with each object. Several threads would write to these
numbers at the same time, so all methods here store the memory with the ray. *Plain*: an array of the ids of all triangles that
were tested, in their order, which is searched from the front: nothing is forgotten until the array is full. *Hashed* (Wald et
al. 2001): a table per ray; the slot of a triangle follows from its id, and a new triangle replaces the old one. *Inverse*
(Shevtsov et al. 2007): the ids of the last eight triangles, in a ring; every triangle is compared with all eight at once.
Rahikainen (2013, section 4.1) surveys the methods.

**Granularity: triangles.** Every leaf has blocks of its own, so a ray never meets a block twice; it meets its triangles twice.
* A packet filters the triangles of a block that culling has left, usually a few of W. Each triangle that is skipped saves P / W
  vector tests.
* A single ray tests W triangles at once, so it can skip a block only if all of its triangles are known. A ring of eight does
  not even hold a block of sixteen.

Forgetting a triangle is always correct: the same hit is found again and replaces nothing.

**Limits.** Mailboxes hardly pay on the CPUs measured, so "none" is the default
(notebooks/records/2026-11-21-kdtree-packets.md, notebooks/records/2026-11-22-plain-mailbox.md). The plain array avoids the most
tests, and to search it takes the longest.

References: arnaldi-1987; wald-2001; shevtsov-2007-triangle; rahikainen-2013.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.mailbox import PLACES, RING, SLOTS


@cache
def mailbox_filter(name: str, width: int, size: int) -> wp.Function:
    """`wp.func(ids, block, mask, mailbox) -> mask`: the triangles of a block that were not tested yet, which are noted.

    name: of the filter in kernels/native/leaf.h. size: number of ids."""
    ids = f"ids.data + (size_t)block * {width}"

    @native.func_native("leaf.h", f"return wrt::{name}<{width}, {size}>({ids}, mask, mailbox.data);")
    def not_tested(ids: wp.array(dtype=int), block: int, mask: wp.uint32, mailbox: wp.array(dtype=int)) -> wp.uint32: ...

    return not_tested


def plain_filter(width: int) -> wp.Function:
    """An array of `PLACES` ids, followed by their number."""
    return mailbox_filter("plain_mailbox", width, PLACES)


def hashed_filter(width: int) -> wp.Function:
    """A hash table of `SLOTS` ids."""
    return mailbox_filter("hashed_mailbox", width, SLOTS)


def inverse_filter(width: int) -> wp.Function:
    """A ring of `RING` ids, followed by the position of the next entry."""
    return mailbox_filter("inverse_mailbox", width, RING)
