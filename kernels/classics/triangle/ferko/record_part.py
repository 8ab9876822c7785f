"""Parts of a triangle's record, one per step of Ferko and Ferko's test."""

from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.triangle.support.record_blocks import Corners, Record


@dataclass(frozen=True)
class Part:
    """Some floats of a triangle's record.

    Attributes:
        names: their names in the steps of a `LaneForm`.
        derive: `wp.func(corners) -> vector` that computes them.
    """

    names: tuple[str, ...]
    derive: wp.Function


@cache
def join(parts: tuple[Part, ...]) -> Record:
    """The record that holds the floats of all parts, in order."""
    own = sum(len(part.names) for part in parts)
    Own = wp.types.vector(length=own, dtype=wp.float32)

    @wp.func
    def nothing(corners: Corners):
        return Own()

    fill = nothing
    for part in parts:
        fill = followed_by(fill, part, place(parts, part))

    @wp.func
    def derive(corners: Corners, origin: wp.vec3):
        return fill(corners)

    return Record(own, derive)


def followed_by(earlier: wp.Function, part: Part, first: int) -> wp.Function:
    """`wp.func(corners) -> values`: the values of `earlier`, with those of `part` from number `first` on."""
    derive_part, count = part.derive, len(part.names)

    @wp.func
    def fill(corners: Corners):
        values = earlier(corners)
        some = derive_part(corners)
        for c in range(wp.static(count)):
            values[wp.static(first) + c] = some[c]
        return values

    return fill


def place(parts: tuple[Part, ...], part: Part) -> int:
    """Number of the part's first float in the record; -1 if the record does not contain the part."""
    return sum(len(p.names) for p in parts[: parts.index(part)]) if part in parts else -1
