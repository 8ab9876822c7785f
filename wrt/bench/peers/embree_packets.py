"""The loops over ray packets that call Embree, as kernels: so that packets are shared among threads as wrt's rays are.

Embree's functions are called by address, from native code. The kernels run on the pool of `wrt.kernels.runtime.launch`, whose
threads claim chunks of packets; Python takes no part in it. Packets are `RTCRay4`, `RTCRay8`, `RTCRay16` or their `RTCRayHit`
forms: arrays of 32-bit words, one for each field, one element a ray. `trace_packets` is for packets that were filled before,
`trace_arrays` fills each packet on the stack from flat arrays, and copies its answers to flat arrays.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.job_queue import on_cpu

wp.set_module_options({"enable_backward": False})

NO_GEOMETRY = 0xFFFFFFFF
"""RTC_INVALID_GEOMETRY_ID."""


@wp.struct
class EmbreeCall:
    """What Embree is asked.

    Attributes:
        function: address of `rtcIntersect4`, `8` or `16` (`closest`), or of `rtcOccluded4`, `8` or `16`.
        scene: the RTCScene.
        version: of Embree: 3, or 4.
        flags: of the RTCIntersectContext, or of the arguments.
        width: rays of a packet.
        closest: whether packets have hits.
        t_max: end of all rays.
    """

    function: wp.uint64
    scene: wp.uint64
    version: int
    flags: int
    width: int
    closest: bool
    t_max: float


@wp.struct
class FilledPackets:
    """Packets that were filled before.

    Attributes:
        address: of the packets, aligned to 64 bytes; results are left in them.
        fields: 32-bit words a ray.
    """

    address: wp.uint64
    fields: int


@wp.struct
class FlatRays:
    """Addresses of contiguous arrays of rays.

    Attributes:
        origins: (count, 3) float32, or one for all rays.
        origin_step: 3, or 0 if the rays share their origin.
        directions: (count, 3) float32.
        count: number of rays.
    """

    origins: wp.uint64
    origin_step: int
    directions: wp.uint64
    count: int


@wp.struct
class FlatAnswers:
    """Addresses of contiguous arrays of answers; 0 where they are not asked for.

    Attributes:
        t: (count,) float32; inf for a miss.
        primitive: (count,) int32; -1 for a miss.
        u, v: (count,) float32; 0 for a miss.
        occluded: (count,) bool.
    """

    t: wp.uint64
    primitive: wp.uint64
    u: wp.uint64
    v: wp.uint64
    occluded: wp.uint64


@native.func_native(
    "embree_packets.h",
    on_cpu(f"static_assert(wrt::embree::NO_GEOMETRY == {NO_GEOMETRY}u);\nwrt::embree::trace_filled(call, packets, number);"),
)
def trace_filled(call: EmbreeCall, packets: FilledPackets, number: int) -> int:
    """Sets a packet's results back and has Embree trace it."""


@wp.kernel
def trace_packets(first: int, call: EmbreeCall, packets: FilledPackets):
    """Item: a packet; first: number of the first one."""
    trace_filled(call, packets, first + wp.tid())  # type: ignore[operator]


@native.func_native("embree_packets.h", on_cpu("wrt::embree::trace_flat(call, rays, answers, number);"))
def trace_flat(call: EmbreeCall, rays: FlatRays, answers: FlatAnswers, number: int) -> int:
    """Fills a packet on the stack with the rays number * width and following, has Embree trace it, and copies the answers."""


@wp.kernel
def trace_arrays(first: int, call: EmbreeCall, rays: FlatRays, answers: FlatAnswers):
    """Item: `width` rays, in order; first: number of the first item."""
    trace_flat(call, rays, answers, first + wp.tid())  # type: ignore[operator]
