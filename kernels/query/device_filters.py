"""Hits in user kernels that a function of the user decides about.

The hits of a ray are asked for one after the other, by t, then by triangle (`wrt.kernels.answers.next_crossing`): each is asked
about once, none is skipped, and no ray starts again behind one by a distance.
"""

from collections.abc import Callable
from typing import Any

import warp as wp

from wrt.kernels.query.device_functions import first_hit, next_hit


def hit_where(accept: Callable[..., Any]) -> Callable[..., Any]:
    """A function for kernels: the first hit of a ray that a function accepts.

        @wp.func
        def is_opaque(scene: Any, hit: wrt.device.Hit, glass: wp.array(dtype=wp.bool)):
            return not glass[hit.primitive_id]

        opaque_hit = wrt.device.hit_where(is_opaque)

        # in a kernel of wrt.device.kernel
        hit = opaque_hit(scene, origin, direction, t_min, t_max, glass)

    Hits are those of `first_hit` and `next_hit`. Each that is refused costs a search from there on; for a fixed choice of
    triangles, the handle of `Scene.filtered(ignore=...)` costs none.

    Args:
        accept: a `wp.func` of (scene, hit, data) that returns a bool; data is any kernel argument.

    Returns:
        `wp.func(scene, origin, direction, t_min, t_max, data) -> Hit`; arguments as in `closest_hit`.

    Raises:
        TypeError: `accept` is no `wp.func`, or takes another number of arguments.
    """
    if not isinstance(accept, wp.Function):
        raise TypeError(
            f"accept must be a wp.func of (scene, hit, data), not {type(accept).__name__}; decorate it with @wp.func"
        )
    if len(accept.input_types) != 3:
        raise TypeError(f"accept must take (scene, hit, data), and takes {', '.join(accept.input_types) or 'nothing'}")

    @wp.func
    def find(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float, data: Any):
        hit = first_hit(scene, origin, direction, t_min, t_max)
        passes = bool(True)
        while passes and hit.triangle >= 0:
            passes = not accept(scene, hit, data)
            if passes:
                hit = next_hit(scene, origin, direction, hit, t_max)
        return hit

    return find
