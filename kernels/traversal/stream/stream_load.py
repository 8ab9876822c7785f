"""Loads rays of a batch into a stream, 16 at a time.

The rays of a stream are stored one after the other, each with all its numbers, because filters and tests read them like that.
Here they are computed component by component, 16 rays to a vector, and then transposed (`kernels/native/stream_load.h`), so
that a ray is written by one or two vector stores. The per-ray data of the triangle test is included if the test supplies
`TestForm.native`; other tests prepare one ray after the other. The arithmetic is that of `load_ray`, `ray_slabs` and
`prepare`, to the bit. Figures: notebooks/records/2026-11-21-streams.md.

Invalid rays are not stored, so a stream is loaded from as many rays as fill it. For a wide BVH, neither are rays that meet no
child of the root (`wrt.kernels.traversal.stream.stream_root`).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import FARTHEST, NEGLIGIBLE, SHORTEST, RayBatch
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.simd.lanes import count_bits, lowest_bit
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, stream_ray
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

KEPT_SIZE = 7 * LIST_LANES
"""Floats of `own`: what `prepare_one_by_one` reads, origins, directions and numbers of the rays in lanes, component by
component."""

GUARDS = f"""
    static_assert(wrt::SLACK == {SLACK!r}f && wrt::SHORTEST == {SHORTEST!r}f && wrt::FARTHEST == {FARTHEST!r}f);
    static_assert(wrt::NEGLIGIBLE == {NEGLIGIBLE!r}f && wrt::MIN_SIZE == {SHORTEST / NEGLIGIBLE!r}f);
"""
"""C++: constants that kernels/native has too."""


def native_form(triangle_test: str) -> str:
    """C++ struct that prepares the rays of a triangle test."""
    return TRIANGLE_TESTS[triangle_test].native or "wrt::OneByOne"


@cache
def load_lanes(triangle_test: str) -> wp.Function:
    """`func(batch, wanted, low, high, stream, size, place, own) -> bits`: loads the next rays, from `wanted[0]` on, at most
    `wanted[1]` and at most 16 of them, and `place` after the first ray of the stream.

    Those that are valid are appended to the `size` rays of the stream; their bits are returned. low, high: bounds of the scene.
    own: receives what `prepare_one_by_one` reads (`KEPT_SIZE`), if it is needed.
    """
    form = f"{native_form(triangle_test)}, {LIST_LANES}"
    arguments = "batch, wanted[0], wanted[1], low, high, stream.data + size, place, own.data"

    @native.func_native("stream_load.h", f"{GUARDS}return wrt::load_rays<{form}>({arguments});")
    def load_lanes_native(
        batch: RayBatch,
        wanted: wp.vec2i,
        low: wp.vec3,
        high: wp.vec3,
        stream: wp.array(dtype=stream_ray(triangle_test)),
        size: int,
        place: int,
        own: wp.array(dtype=float),
    ) -> wp.uint32: ...

    return load_lanes_native


@cache
def prepare_one_by_one(triangle_test: str) -> wp.Function:
    """`wp.func(stream, size, bits, own)`: stores what a triangle test without a `native` form needs, and the numbers of the
    rays, after the rest has been stored. own: see `KEPT_SIZE`."""
    test = TRIANGLE_TESTS[triangle_test]
    StreamRay, RayState, prepare = stream_ray(triangle_test), test.ray_state, test.prepare

    @wp.func_native("stream.data[k].state = state; stream.data[k].number = number;")
    def put_state(stream: wp.array(dtype=StreamRay), k: int, state: RayState, number: int): ...

    @native.func_native("lanes.h", f"return ((const int*)own.data)[{6 * LIST_LANES} + k];")
    def number_of(own: wp.array(dtype=float), k: int) -> int: ...

    @wp.func
    def vector(own: wp.array(dtype=float), k: int, component: int):
        x = load_float(own, component * wp.static(LIST_LANES) + k)
        y = load_float(own, (component + 1) * wp.static(LIST_LANES) + k)
        return wp.vec3(x, y, load_float(own, (component + 2) * wp.static(LIST_LANES) + k))

    @wp.func
    def prepare_kept(stream: wp.array(dtype=StreamRay), size: int, bits: wp.uint32, own: wp.array(dtype=float)):
        left = wp.uint32(bits)
        k = int(size)
        while left != wp.uint32(0):
            lane = lowest_bit(left)
            put_state(stream, k, prepare(vector(own, lane, 0), vector(own, lane, 3)), number_of(own, lane))
            left = left & (left - wp.uint32(1))
            k += 1

    return prepare_kept


@cache
def load_stream(triangle_test: str, room: int) -> wp.Function:
    """`wp.func(rays, begin, end, low, high, stream, size) -> count`: loads rays from `begin` on, until the stream is full or
    ray `end` is reached.

    Returns how many rays were loaded; `size` becomes the number of those that are in the stream. The others miss.

    Args:
        triangle_test: name of the triangle test.
        room: of a stream, in rays.

    Args (of the function): low, high: bounds of the scene.
    """
    StreamRay, load = stream_ray(triangle_test), load_lanes(triangle_test)
    prepared = bool(TRIANGLE_TESTS[triangle_test].native)
    prepare_kept, group = prepare_one_by_one(triangle_test), min(room, LIST_LANES)

    @wp.func
    def load_rays(
        rays: RayBatch,
        begin: int,
        end: int,
        low: wp.vec3,
        high: wp.vec3,
        stream: wp.array(dtype=StreamRay),
        size: wp.ref[int],
    ):
        own = wp.zeros(shape=(KEPT_SIZE,), dtype=float)
        place = int(0)
        kept = int(0)
        while begin + place < end and kept <= wp.static(room - group):
            count = wp.min(end - begin - place, wp.static(group))
            bits = load(rays, wp.vec2i(begin + place, count), low, high, stream, kept, place, own)
            if wp.static(not prepared):
                prepare_kept(stream, kept, bits, own)
            place += count
            kept += count_bits(bits)
        size = kept  # noqa: F841 (a reference)
        return place

    return load_rays
