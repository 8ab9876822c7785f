"""The table of mailboxes: a ray or packet remembers the triangles that it has tested and does not test them again.

**Problem.** A triangle that straddles a splitting plane is in several leaves of a kd-tree. A ray or packet that visits two of
them tests it twice.

Forgetting a triangle is always correct: the same hit is found again and replaces nothing. Mailboxes hardly pay on the CPUs
measured, so "none" is the default, and the methods are in `wrt.kernels.classics.traversal.mailboxes`.

**Contract.** A mailbox is an array of ints for one ray or packet, initially 0, and `filter(width)`, a `wp.func(ids, block,
mask, mailbox) -> mask` that removes remembered triangles from the mask and remembers the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.on_demand import OnDemand

RING = 8
"""Number of triangles in an inverse mailbox."""

SLOTS = 64
"""Slots of a hashed mailbox, a power of two."""

PLACES = 256
"""Triangles that a plain mailbox remembers; it forgets those that come later."""


@cache
def no_filter(width: int) -> wp.Function:
    """A filter that keeps every triangle."""

    @wp.func
    def none(ids: wp.array(dtype=int), block: int, mask: wp.uint32, mailbox: wp.array(dtype=int)):
        return mask

    return none


@dataclass(frozen=True)
class Mailbox:
    """A method to avoid repeated triangle tests.

    Attributes:
        name: key in `MAILBOXES`.
        paper: authors, title, year.
        size: number of ints; at least one, because an array must not be empty.
        filter: width -> `wp.func(ids, block, mask, mailbox) -> mask`.
    """

    name: str
    paper: str
    size: int
    filter: Callable[[int], wp.Function]


NONE = "none"
_METHODS = "traversal.mailboxes"

MAILBOXES: dict[str, Mailbox] = {
    mailbox.name: mailbox
    for mailbox in (
        Mailbox(NONE, "every triangle is tested in every leaf that has it", 1, no_filter),
        Mailbox(
            "plain",
            "Arnaldi, Priol, Bouatouch: A new space subdivision method for ray tracing CSG modelled scenes (1987)",
            PLACES + 1,
            OnDemand(_METHODS, "plain_filter"),
        ),
        Mailbox(
            "hashed",
            "Wald et al.: Interactive rendering with coherent ray tracing (2001)",
            SLOTS,
            OnDemand(_METHODS, "hashed_filter"),
        ),
        Mailbox(
            "inverse",
            "Shevtsov, Soupikov, Kapustin: Ray-triangle intersection algorithm for modern CPU architectures (2007)",
            RING + 1,
            OnDemand(_METHODS, "inverse_filter"),
        ),
    )
}
"""Mailboxes by name."""
