"""The loops over ray packets that call Embree, as kernels: so that packets are shared among threads as wrt's rays are.

Embree's functions are called by address, from native code. The kernels run on the pool of `wrt.kernels.runtime.launch`, whose
threads claim chunks of packets; Python takes no part in it. Packets are `RTCRay4`, `RTCRay8`, `RTCRay16` or their `RTCRayHit`
forms: arrays of 32-bit words, one for each field, one element a ray. `trace_packets` is for packets that were filled before,
`trace_arrays` fills each packet on the stack from flat arrays, and copies its answers to flat arrays.
"""

import warp as wp

from wrt.kernels.runtime.job_queue import on_cpu

wp.set_module_options({"enable_backward": False})

REACH_FIELD = 8
"""Which field `tfar` is, in both forms."""

GEOMETRY_FIELD = 18
"""Which field `geomID` is, in the form with a hit."""

MAX_FIELDS = 21
"""32-bit words a ray of the largest form: with a hit, of version 4."""

NO_GEOMETRY = 0xFFFFFFFF
"""RTC_INVALID_GEOMETRY_ID."""

CALL = f"""
    if (version == 3) {{
        // an RTCIntersectContext without a filter
        typedef void (*trace_t)(const int* valid, void* scene, void* context, void* packet);
        struct {{ int flags; void* filter; unsigned int instance; }} context = {{flags, nullptr, {NO_GEOMETRY}u}};
        ((trace_t)function)(valid, (void*)scene, &context, packet);
    }} else {{
        // RTCIntersectArguments, which have the layout of RTCOccludedArguments: all features, no context, no callbacks
        typedef void (*trace_t)(const int* valid, void* scene, void* packet, void* arguments);
        struct {{ int flags; unsigned int features; void* context; void* filter; void* intersect; }} arguments
            = {{flags, 0xFFFFFFFFu, nullptr, nullptr, nullptr}};
        ((trace_t)function)(valid, (void*)scene, packet, &arguments);
    }}
"""
"""C++ that has Embree trace the lanes of `packet` whose `valid` is -1."""

TRACE = f"""
    alignas(64) int valid[16];
    for (int i = 0; i < 16; ++i) valid[i] = -1;
    float* const packet = (float*)packets + (size_t)number * fields * width;
    for (int i = 0; i < width; ++i) packet[{REACH_FIELD} * width + i] = t_max;
    if (closest)
        for (int i = 0; i < width; ++i) ((unsigned int*)packet)[{GEOMETRY_FIELD} * width + i] = {NO_GEOMETRY}u;
    {CALL}
"""

FILL_AND_TRACE = f"""
    struct Four {{ enum {{ lanes = 4 }}; }};
    struct Eight {{ enum {{ lanes = 8 }}; }};
    struct Sixteen {{ enum {{ lanes = 16 }}; }};
    auto trace = [&](auto of_width) {{  // with a constant width, so that loops are vector instructions
        constexpr int W = decltype(of_width)::lanes;
        alignas(64) int valid[W];
        alignas(64) float packet[{MAX_FIELDS} * W];
        int* const words = (int*)packet;
        const int first = number * W, left = count - first, last = (left < W ? left : W) - 1;
        const float* const o = (const float*)origins + (size_t)first * origin_step;
        const float* const d = (const float*)directions + (size_t)first * 3;
        if (last == W - 1 && origin_step == 0) {{
            for (int i = 0; i < W; ++i) for (int k = 0; k < 3; ++k) packet[k * W + i] = o[k];
            for (int i = 0; i < W; ++i) for (int k = 0; k < 3; ++k) packet[(4 + k) * W + i] = d[3 * i + k];
        }} else if (last == W - 1) {{
            for (int i = 0; i < W; ++i) for (int k = 0; k < 3; ++k) packet[k * W + i] = o[3 * i + k];
            for (int i = 0; i < W; ++i) for (int k = 0; k < 3; ++k) packet[(4 + k) * W + i] = d[3 * i + k];
        }} else {{
            for (int i = 0; i < W; ++i) for (int k = 0; k < 3; ++k) {{
                const int ray = i < last ? i : last;
                packet[k * W + i] = o[ray * origin_step + k];
                packet[(4 + k) * W + i] = d[ray * 3 + k];
            }}
        }}
        for (int i = 0; i < W; ++i) {{
            valid[i] = i <= last ? -1 : 0;
            packet[3 * W + i] = 0.0f;  // tnear
            packet[7 * W + i] = 0.0f;  // time
            packet[{REACH_FIELD} * W + i] = t_max;
            words[9 * W + i] = -1;  // mask
            words[10 * W + i] = words[11 * W + i] = 0;  // id and flags
        }}
        if (closest) for (int i = 0; i < W; ++i) {{
            packet[15 * W + i] = packet[16 * W + i] = 0.0f;  // u, v
            words[{GEOMETRY_FIELD} * W + i] = words[17 * W + i] = -1;  // geomID, primID
        }}
        {CALL}
        const float* const reach = packet + {REACH_FIELD} * W;
        const int stored = last + 1;
        auto store = [&](int n) {{
            if (!closest) {{
                for (int i = 0; i < n; ++i) ((bool*)occluded)[first + i] = reach[i] < 0.0f;
                return;
            }}
            for (int i = 0; i < n; ++i) ((float*)t)[first + i] = words[17 * W + i] < 0 ? (float)INFINITY : reach[i];
            for (int i = 0; i < n; ++i) ((int*)primitive)[first + i] = words[17 * W + i];
            for (int i = 0; i < n; ++i) ((float*)u)[first + i] = packet[15 * W + i];
            for (int i = 0; i < n; ++i) ((float*)v)[first + i] = packet[16 * W + i];
        }};
        if (stored == W) store(W); else store(stored);
    }};
    if (width == 16) trace(Sixteen()); else if (width == 8) trace(Eight()); else trace(Four());
"""


@wp.func_native(on_cpu(TRACE))
def trace_packet(
    function: wp.uint64,
    scene: wp.uint64,
    version: int,
    flags: int,
    packets: wp.uint64,
    width: int,
    fields: int,
    closest: wp.bool,
    t_max: float,
    number: int,
) -> int:
    """Sets a packet's results back and has Embree trace it."""


@wp.kernel
def trace_packets(
    first: int,
    function: wp.uint64,
    scene: wp.uint64,
    version: int,
    flags: int,
    packets: wp.uint64,
    width: int,
    fields: int,
    closest: wp.bool,
    t_max: float,
):
    """Item: a packet.

    Args:
        first: number of the first packet.
        function: address of `rtcIntersect4`, `8` or `16` (`closest`), or of `rtcOccluded4`, `8` or `16`.
        scene: the RTCScene.
        version: of Embree: 3, or 4.
        flags: of the RTCIntersectContext, or of the arguments.
        packets: address of the packets, aligned to 64 bytes; results are left in them.
        width: rays of a packet.
        fields: 32-bit words a ray.
        closest: whether packets have hits.
        t_max: end of all rays.
    """
    trace_packet(function, scene, version, flags, packets, width, fields, closest, t_max, first + wp.tid())  # type: ignore[operator]


@wp.func_native(on_cpu(FILL_AND_TRACE))
def trace_part(
    function: wp.uint64,
    scene: wp.uint64,
    version: int,
    flags: int,
    width: int,
    closest: wp.bool,
    t_max: float,
    origins: wp.uint64,
    origin_step: int,
    directions: wp.uint64,
    count: int,
    t: wp.uint64,
    primitive: wp.uint64,
    u: wp.uint64,
    v: wp.uint64,
    occluded: wp.uint64,
    number: int,
) -> int:
    """Fills a packet on the stack with the rays number * width and following, has Embree trace it, and copies the answers."""


@wp.kernel
def trace_arrays(
    first: int,
    function: wp.uint64,
    scene: wp.uint64,
    version: int,
    flags: int,
    width: int,
    closest: wp.bool,
    t_max: float,
    origins: wp.uint64,
    origin_step: int,
    directions: wp.uint64,
    count: int,
    t: wp.uint64,
    primitive: wp.uint64,
    u: wp.uint64,
    v: wp.uint64,
    occluded: wp.uint64,
):
    """Item: `width` rays, in order. All arrays are addresses of contiguous ones; those of answers not asked for are 0.

    Args:
        first, function, scene, version, flags, width, closest, t_max: as in `trace_packets`.
        origins: (count, 3) float32, or one for all rays.
        origin_step: 3, or 0 if the rays share their origin.
        directions: (count, 3) float32.
        count: number of rays.
        t: (count,) float32; inf for a miss.
        primitive: (count,) int32; -1 for a miss.
        u, v: (count,) float32; 0 for a miss.
        occluded: (count,) bool.
    """
    trace_part(
        function,
        scene,
        version,
        flags,
        width,
        closest,
        t_max,
        origins,
        origin_step,
        directions,
        count,
        t,
        primitive,
        u,
        v,
        occluded,
        first + wp.tid(),  # type: ignore[operator]
    )
