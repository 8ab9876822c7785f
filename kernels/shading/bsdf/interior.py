"""Nested dielectrics: in which media a ray is, and which of them counts.

A glass of water with ice is three bodies whose surfaces overlap a little, because bodies that only touch would leave gaps. Of
the media that contain a point, the one with the highest priority is there. A ray keeps a list of the media that it is in. A
surface whose medium has a lower priority than another one of the list is no boundary: the ray passes it, and only the list
changes (Schmidt and Budge 2002).

The list has four places of 16 bits in one word, each 0 or a material's number plus 1. A ray that enters a fifth medium forgets
to note it.

References: schmidt-budge-2002.
"""

import warp as wp

PLACES = wp.constant(4)
PLACE = wp.constant(wp.uint64(0xFFFF))


@wp.func
def medium_at(media: wp.uint64, place: int):
    """The material in a place of the list; -1 for none."""
    return int((media >> wp.uint64(16 * place)) & PLACE) - 1


@wp.func
def leading_medium(media: wp.uint64, priority: wp.array(dtype=int)):
    """The material with the highest priority in the list, of equal ones the first; -1 for air."""
    best = int(-1)
    if media != wp.uint64(0):
        for place in range(PLACES):
            medium = medium_at(media, place)
            if medium >= 0:
                better = best < 0
                if best >= 0:
                    better = priority[medium] > priority[best]
                if better:
                    best = medium
    return best


@wp.func
def with_medium(media: wp.uint64, medium: int):
    """The list after entering a medium."""
    result = wp.uint64(media)
    is_noted = bool(False)
    for place in range(PLACES):
        if not is_noted and medium_at(media, place) < 0:
            result = result | (wp.uint64(medium + 1) << wp.uint64(16 * place))
            is_noted = True
    return result


@wp.func
def without_medium(media: wp.uint64, medium: int):
    """The list after leaving a medium; the same list if it is not in it."""
    result = wp.uint64(media)
    is_found = bool(False)
    for place in range(PLACES):
        if not is_found and medium_at(media, place) == medium:
            result = result & ~(PLACE << wp.uint64(16 * place))
            is_found = True
    return result
