"""The rays of a packet in a scene of instances: kept in the scene's space, transformed in lanes, and their hits merged.

A packet's directions and origins, the latter in float64, are fetched once. At an instance all of them are transformed in lanes
of float64 and written straight into the components of a packet of the instance, which is bounded like any other. Its hits are
merged in lanes. Nothing leaves local memory until the packet is done. The arithmetic is that of
`wrt.kernels.layout.instance_maps.object_ray`, for one ray or for many.

Rays from one point have one origin in each instance, so they are packets with a shared origin there, too.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.layout.ray_batch import DIRECTION_LANES, HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.leaf import Candidate
from wrt.kernels.traversal.packet.rays.packet_bounding import bound_packet
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import fill_head, fill_packet
from wrt.kernels.traversal.packet.rays.ray_numbers import NUMBERS

exact_module(__name__)

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
    ...


def memory_head(layout: PacketLayout) -> str:
    """C++: the head of the layout, and a pointer to each of `ROWS`, for a function with a parameter `memory`."""
    rows = "".join(f"    float* {name} = memory.scene.data + {k} * P;\n" for k, name in enumerate(ROWS))
    rest = "    float* bound = memory.bound.data;\n    int* best = (int*)best_primitive;\n"
    rest += "    double *from_x0 = memory.origin.data, *from_y0 = from_x0 + P, *from_z0 = from_y0 + P;\n"
    return "    auto& packet = memory.packet;\n" + layout.head + rows + rest


_KEEP = """
    const double center_x = rays.center.c[0], center_y = rays.center.c[1], center_z = rays.center.c[2];
    int* to = memory.number.data;
    for_rays([&](int k, int n) { to[k] = n; });
    for (int k = here; k < P; ++k) to[k] = to[0];
    auto fetch = [&](int stride, auto take) {  // take(k, n): ray k has what is at place n
        if (stride) { WRT_SCALAR for (int k = 0; k < P; ++k) take(k, to[k]); }
        else { WRT_FOR(P, k) take(k, 0); }
    };
    fetch(rays.direction_stride, [&](int k, int n) {
        const float* d = (const float*)rays.directions.data + 3 * (size_t)n;
        scene_x[k] = d[0]; scene_y[k] = d[1]; scene_z[k] = d[2];
    });
    fetch(rays.t_min_stride, [&](int k, int n) { scene_t_min[k] = rays.t_min.data[n]; });
    auto centred = [&](int k, int n) {
        const float* o = (const float*)rays.origins.data + 3 * (size_t)n;
        from_x0[k] = (double)o[0] - center_x; from_y0[k] = (double)o[1] - center_y; from_z0[k] = (double)o[2] - center_z;
    };
    if (SHARED) centred(0, 0);
    else fetch(rays.origin_stride, centred);
    WRT_FOR(P, k) {
        wrt_direction(scene_x[k], scene_y[k], scene_z[k]);
        best_t[k] = INF; best[k] = -1; best_u[k] = 0.0f; best_v[k] = 0.0f;
    }
    int farthest = 0;  // sizes as integers, in the order of the floats: NaN and infinity are beyond all numbers
    WRT_FOR(SHARED ? 1 : P, k) {
        const int x = __builtin_bit_cast(int, (float)from_x0[k]) & 0x7fffffff;
        const int y = __builtin_bit_cast(int, (float)from_y0[k]) & 0x7fffffff;
        const int z = __builtin_bit_cast(int, (float)from_z0[k]) & 0x7fffffff;
        int size = x > y ? x : y; size = size > z ? size : z;
        size = size < 0x7f800000 ? size : 0;
        farthest = size > farthest ? size : farthest;
    }
    return __builtin_bit_cast(float, farthest);
"""


@cache
def keep_rays(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, memory) -> float`: fetches the rays of a packet, without hits.

    Returns the greatest absolute value of a coordinate of their origins.
    """

    @native.func_native("lanes.h", memory_head(layout) + DIRECTION_LANES + NUMBERS + _KEEP)
    def keep_rays_native(rays: RayBatch, first: int, memory: wp.ref[PacketMemory]) -> float: ...

    return keep_rays_native


@cache
def keep_ranges(layout: PacketLayout) -> wp.Function:
    """`wp.func(memory)`: `bound` becomes the t of the packet that was loaded: t_max, or -inf for invalid rays."""

    @native.func_native("lanes.h", memory_head(layout) + "    WRT_FOR(P, k) { bound[k] = t[k]; }\n")
    def keep_ranges_native(memory: wp.ref[PacketMemory]): ...

    return keep_ranges_native


_TRANSFORM = """
    const double* m = &place.to_object.data[0][0];
    const double m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3], m4 = m[4], m5 = m[5], m6 = m[6], m7 = m[7], m8 = m[8];
    const double px = place.origin.c[0], py = place.origin.c[1], pz = place.origin.c[2];
    float to_x[P], to_y[P], to_z[P], from_x[P], from_y[P], from_z[P], least[P], most[P];
    WRT_FOR(P, k) {
        const double x = scene_x[k], y = scene_y[k], z = scene_z[k];
        to_x[k] = (float)((m0 * x + m1 * y) + m2 * z);
        to_y[k] = (float)((m3 * x + m4 * y) + m5 * z);
        to_z[k] = (float)((m6 * x + m7 * y) + m8 * z);
    }
    WRT_FOR(SHARED ? 1 : P, k) {
        const double x = from_x0[k] - px, y = from_y0[k] - py, z = from_z0[k] - pz;
        from_x[k] = (float)((m0 * x + m1 * y) + m2 * z);
        from_y[k] = (float)((m3 * x + m4 * y) + m5 * z);
        from_z[k] = (float)((m6 * x + m7 * y) + m8 * z);
    }
    const float ox0 = SHARED ? from_x[0] : 0.0f, oy0 = SHARED ? from_y[0] : 0.0f, oz0 = SHARED ? from_z[0] : 0.0f;
    WRT_FOR(P, k) { least[k] = scene_t_min[k]; most[k] = bound[k]; }
    if (rays.mask.shape[0] > 0) for (int k = 0; k < P; ++k) {
        if (!(place.mask & rays.mask.data[memory.number.data[k] * rays.mask_stride])) most[k] = -INF;
    }
    const bool ranged = true;
"""


@cache
def load_instance(layout: PacketLayout, slopes: bool) -> wp.Function:
    """`wp.func(memory, rays, place, low, high, bounds)`: `load_packet` of the rays in the space of an instance.

    They end at `bound`; those that the instance's mask hides are inactive. low, high: bounds of its tree. slopes: see
    `load_packet`.
    """

    @native.func_native(
        "lanes.h",
        memory_head(layout) + fill_head(layout, slopes) + _TRANSFORM + fill_packet(layout) + bound_packet(layout, slopes),
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


_MERGE = """
    const int* found = (const int*)primitive;
    WRT_FOR(P, k) {
        const int id = first + found[k];
        const bool nearer = (t[k] < best_t[k]) | ((t[k] == best_t[k]) & ((unsigned)id < (unsigned)best[k]));
        const bool hit = (found[k] >= 0) & (ANY_HIT | nearer);
        best_t[k] = hit ? t[k] : best_t[k];
        best[k] = hit ? id : best[k];
        best_u[k] = hit ? u[k] : best_u[k];
        best_v[k] = hit ? v[k] : best_v[k];
        bound[k] = hit ? t[k] : bound[k];
    }
    // as integers: in the order of the floats that are not negative (adding 0 turns -0 into +0), and -inf below them
    int farthest = (int)0x80000000;
    WRT_FOR(P, k) { const int bits = __builtin_bit_cast(int, bound[k] + 0.0f); farthest = bits > farthest ? bits : farthest; }
    return farthest < 0 ? -INF : __builtin_bit_cast(float, farthest);
"""


@cache
def merge_hits(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, first) -> t_max`: merges the hits of a packet in an instance whose first triangle has this number.

    Shortens the rays, and returns the greatest t at which a hit still counts. In any-hit queries, rays with a hit are done.
    """
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"

    @native.func_native("lanes.h", memory_head(layout) + constant + _MERGE)
    def merge_hits_native(memory: wp.ref[PacketMemory], first: int) -> float: ...

    return merge_hits_native


_STORE = """
    if (ANY_HIT) {
        for_rays([&](int k, int n) { hits.occluded.data[n] = best[k] >= 0; });
        return;
    }
    float* __restrict__ t_out = hits.t.data;
    int* __restrict__ primitive_out = hits.primitive.data;
    float* __restrict__ uv_out = (float*)hits.uv.data;
    for_rays([&](int k, int n) { t_out[n] = best_t[k]; });
    for_rays([&](int k, int n) { primitive_out[n] = best[k]; });
    for_rays([&](int k, int n) { uv_out[2 * (size_t)n] = best_u[k]; uv_out[2 * (size_t)n + 1] = best_v[k]; });
"""


@cache
def store_rays(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, rays, first, hits)`: writes the hits of the rays that `keep_rays` fetched."""
    constant = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n"

    @native.func_native("lanes.h", memory_head(layout) + constant + NUMBERS + _STORE)
    def store_rays_native(memory: wp.ref[PacketMemory], rays: RayBatch, first: int, hits: HitBatch): ...

    return store_rays_native


@cache
def store_candidate(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(memory, k, best)`: ray k of the packet has this hit, or none; in any-hit queries it is then done."""
    t = "best_of_ray.primitive >= 0 ? -INF : best_of_ray.t" if any_hit else "best_of_ray.t"
    body = f"    t[k] = {t}; ((int*)primitive)[k] = best_of_ray.primitive; u[k] = best_of_ray.u; v[k] = best_of_ray.v;\n"

    @native.func_native("lanes.h", memory_head(layout) + body)
    def store_candidate_native(memory: wp.ref[PacketMemory], k: int, best_of_ray: wp.ref[Candidate]): ...

    return store_candidate_native


@cache
def is_active(layout: PacketLayout) -> wp.Function:
    """`wp.func(memory, k) -> bool`: whether ray k of the packet still looks for hits."""

    @native.func_native("lanes.h", memory_head(layout) + "    return t[k] >= -0.0f;\n")
    def is_active_native(memory: wp.ref[PacketMemory], k: int) -> bool: ...

    return is_active_native
