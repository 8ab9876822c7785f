"""The texels of an image around texture coordinates, between which its values are interpolated."""

import warp as wp

REPEAT = wp.constant(0)
CLAMP = wp.constant(1)
MIRROR_REPEAT = wp.constant(2)


@wp.struct
class Footprint:
    """The four texels around a point of an image, and where the point is between them."""

    left: int
    right: int
    top: int
    bottom: int
    across: float
    down: float


@wp.func
def folded(coordinate: float, wrap: int):
    """A texture coordinate, brought into [0, 1]."""
    found = coordinate - wp.floor(coordinate)
    if wrap == CLAMP:
        found = wp.clamp(coordinate, 0.0, 1.0)
    if wrap == MIRROR_REPEAT:
        found = 1.0 - wp.abs(coordinate - 2.0 * wp.floor(0.5 * coordinate) - 1.0)
    return found


@wp.func
def texel_number(place: int, size: int, wrap: int):
    """The number of a texel that may lie one beyond an edge.

    Of an image that repeats, it is at the other edge; else at this one.
    """
    number = wp.clamp(place, 0, size - 1)
    if wrap == REPEAT:
        number = wp.where(place < 0, size - 1, wp.where(place < size, place, 0))
    return number


@wp.func
def footprint(size: wp.vec2i, wrap: wp.vec2i, uv: wp.vec2):
    """The texels at texture coordinates. u grows to the right, v upward."""
    x = folded(uv[0], wrap[0]) * float(size[0]) - 0.5
    y = (1.0 - folded(uv[1], wrap[1])) * float(size[1]) - 0.5
    left = wp.clamp(int(wp.floor(x)), -1, size[0] - 1)
    top = wp.clamp(int(wp.floor(y)), -1, size[1] - 1)
    found = Footprint()
    found.across = x - float(left)
    found.down = y - float(top)
    found.right = texel_number(left + 1, size[0], wrap[0])
    found.bottom = texel_number(top + 1, size[1], wrap[1])
    found.left = texel_number(left, size[0], wrap[0])
    found.top = texel_number(top, size[1], wrap[1])
    return found
