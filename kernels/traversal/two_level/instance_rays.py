"""The rays of a packet in a scene of instances: kept in the scene's space, transformed in lanes, and their hits merged.

A packet's directions and origins, the latter in float64, are fetched once. At an instance all of them are transformed in lanes
of float64 and written straight into the components of a packet of the instance, which is bounded like any other. Its hits are
merged in lanes. Nothing leaves local memory until the packet is done. The arithmetic is that of
`wrt.kernels.layout.instance_maps.object_ray`, for one ray or for many.

Rays from one point have one origin in each instance, so they are packets with a shared origin there, too.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.traversal.packet.rays.packet_load import bounding

ROWS = ("scene_x", "scene_y", "scene_z", "scene_t_min", "best_t", "best_primitive", "best_u", "best_v")
"""Components of the rays in the scene, P floats each: direction, t_min, and the best hit of all instances so far."""


@wp.struct
class PacketMemory:
    """Local memory of a run of packets, used by one packet after the other."""

    number: wp.array(dtype=int)
    """(P,) number of each ray in the batch."""
    bound: wp.array(dtype=float)
    """(P,) t of the best hit of each ray, or its t_max; -inf if it is invalid or done."""
    waiting: wp.array(dtype=float)
    """(P,) t_max of each ray whose environment is still to be traced; -inf for the others. Used with environments only."""
    scene: wp.array(dtype=float)
    """(len(ROWS) P,) rays and hits."""
    origin: wp.array(dtype=wp.float64)
    """(3 P,) all x, then all y, then all z, relative to the scene's centre; only the first of each if the origin is shared."""
    packet: wp.array(dtype=float)
    """The packet (`wrt.kernels.traversal.packet.rays.packet_layout`), first of the scene, then of an instance."""
    walk: wp.array(dtype=int)
    """Memory for the walk through an instance."""


_SET = "".join(f"memory.{name} = {name}; " for name in ("number", "bound", "waiting", "scene", "origin", "packet", "walk"))


@native.func_native("lanes.h", _SET)
def set_arrays(
    memory: wp.ref[PacketMemory],
    number: wp.array(dtype=int),
    bound: wp.array(dtype=float),
    waiting: wp.array(dtype=float),
    scene: wp.array(dtype=float),
    origin: wp.array(dtype=wp.float64),
    packet: wp.array(dtype=float),
    walk: wp.array(dtype=int),
):
    """Makes the struct use local arrays; Warp assigns them to no field of a struct."""


def scene(layout: PacketLayout) -> str:
    """C++ expression for the rays in the array fields of a parameter `memory`."""
    return f"wrt::SceneRays<{layout.sizes}>(memory)"


@cache
def keep_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, memory) -> float`: fetches the rays of a packet, without hits.

    Returns the greatest absolute value of a coordinate of their origins.
    """

    @native.func_native("instances.h", f"return wrt::keep_rays({scene(layout)}, rays, first);")
    def keep_rays_native(rays: RayBatch, first: int, memory: wp.ref[PacketMemory]) -> float: ...

    return keep_rays_native


@cache
def keep_ranges(layout: PacketLayout) -> wp.Function:
    """`wp.func(memory)`: `bound` becomes the t of the packet that was loaded: t_max, or -inf for invalid rays."""

    @native.func_native("instances.h", f"wrt::keep_ranges({scene(layout)});")
    def keep_ranges_native(memory: wp.ref[PacketMemory]): ...

    return keep_ranges_native


@cache
def load_instance(layout: PacketLayout, slopes: bool) -> wp.Function:
    """`wp.func(memory, rays, place, low, high, bounds)`: `load_packet` of the rays in the space of an instance.

    They end at `bound`; those that the instance's mask hides are inactive. low, high: bounds of its tree. slopes: see
    `load_packet`.
    """
    what, rest = bounding(layout, slopes), f"rays, place, low, high, bounds, {layout.prepare}"

    @native.func_native(
        f"instances.h {layout.headers}",
        f"""static_assert(wrt::SceneRays<{layout.sizes}>::ROWS == {len(ROWS)});
        const wrt::SceneRays<{layout.sizes}> scene(memory);
        const {layout.type} own = scene.packet; {layout.state}
        wrt::load_instance<{what}>(scene, {rest});""",
    )
    def load_instance_native(
        memory: wp.ref[PacketMemory],
        rays: RayBatch,
        place: Placement,
        low: wp.vec3,
        high: wp.vec3,
        bounds: wp.ref[PacketBounds],
    ): ...

    return load_instance_native


@cache
def merge_hits(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, first) -> t_max`: merges the hits of a packet in an instance whose first triangle has this number.

    Shortens the rays, and returns the greatest t at which a hit still counts. In any-hit queries, rays with a hit are done.
    """

    @native.func_native("instances.h", f"return wrt::merge_hits<{cpp(any_hit)}>({scene(layout)}, first);")
    def merge_hits_native(memory: wp.ref[PacketMemory], first: int) -> float: ...

    return merge_hits_native


@cache
def store_rays(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, rays, first, hits)`: writes the hits of the rays that `keep_rays` fetched."""

    @native.func_native("instances.h", f"wrt::store_rays<{cpp(any_hit)}>({scene(layout)}, rays, first, hits);")
    def store_rays_native(memory: wp.ref[PacketMemory], rays: RayBatch, first: int, hits: HitBatch): ...

    return store_rays_native


@cache
def store_candidate(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, k, best)`: ray k of the packet has this hit, or none; in any-hit queries it is then done."""

    @native.func_native("packet_parts.h", f"wrt::store_hit<{cpp(any_hit)}>({layout.type}(memory.packet.data), k, best_of_ray);")
    def store_candidate_native(memory: wp.ref[PacketMemory], k: int, best_of_ray: wp.ref[BestHit]): ...

    return store_candidate_native


@cache
def is_active(layout: PacketLayout) -> wp.Function:
    """`wp.func(memory, k) -> bool`: whether ray k of the packet still looks for hits."""

    @native.func_native("packet.h", f"return {layout.type}(memory.packet.data).t[k] >= -0.0f;")
    def is_active_native(memory: wp.ref[PacketMemory], k: int) -> bool: ...

    return is_active_native
