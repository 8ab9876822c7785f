"""Bounds of a run of rays of any length, without loading them into a packet: for tiles, which are tested only as a whole.

A packet takes the interval of 1 / direction over its rays (`wrt.kernels.traversal.packet.rays.packet_load`). A tile takes the
intervals of directions and origins and derives the rest from their ends. Quotients, products and differences round
monotonically, so the ends still bound the values that each ray computes. This costs a minimum and a maximum per component and
ray, and no division.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds

RUN = 64
"""Rays that are loaded at a time."""


@native.func_native("packet_load.h", f"wrt::bound_rays<{RUN}>(rays, first, count, low, high, bounds);")
def bound_rays(rays: RayBatch, first: int, count: int, low: wp.vec3, high: wp.vec3, bounds: wp.ref[PacketBounds]):
    """Bounds of the rays first .. first + count - 1 of a batch, clipped to its end; low, high: bounds of the scene.

    If no ray is active, only `bounds.active` is set.
    """
    ...
