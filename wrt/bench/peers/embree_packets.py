"""The loop over ray packets that calls Embree, as a kernel: so that packets are shared among threads as wrt's rays are.

Embree's functions are called by address, from native code. The kernel runs on the pool of `wrt.kernels.runtime.launch`, whose
threads claim chunks of packets; Python takes no part in it. Packets are `RTCRay4`, `RTCRay8`, `RTCRay16` or their `RTCRayHit`
forms: arrays of 32-bit words, one for each field, one element a ray.
"""

import warp as wp

from wrt.kernels.runtime.board import on_cpu

wp.set_module_options({"enable_backward": False})

REACH_FIELD = 8
"""Which field `tfar` is, in both forms."""

GEOMETRY_FIELD = 18
"""Which field `geomID` is, in the form with a hit."""

NO_GEOMETRY = 0xFFFFFFFF
"""RTC_INVALID_GEOMETRY_ID."""

TRACE = f"""
    alignas(64) int valid[16];
    for (int i = 0; i < 16; ++i) valid[i] = -1;
    float* const packet = (float*)packets + (size_t)number * fields * width;
    for (int i = 0; i < width; ++i) packet[{REACH_FIELD} * width + i] = t_max;
    if (closest)
        for (int i = 0; i < width; ++i) ((unsigned int*)packet)[{GEOMETRY_FIELD} * width + i] = {NO_GEOMETRY}u;
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
    ...


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
    trace_packet(function, scene, version, flags, packets, width, fields, closest, t_max, first + wp.tid())
