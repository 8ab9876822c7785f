"""Loads rays of a batch into a stream, 16 at a time.

The rays of a stream are stored one after the other, each with all its numbers, because filters and tests read them like that.
Here they are computed component by component, 16 rays to a vector, and then transposed (`TRANSPOSE`), so that a ray is written
by one or two vector stores. The per-ray data of the triangle test is included if the test supplies `TestForm.prepare_lanes`;
other tests prepare one ray after the other. The arithmetic is that of `load_ray`, `ray_slabs` and `prepare`, to the bit.
Figures: notebooks/records/2026-11-21-streams.md.

**Rays that leave at once.** Invalid rays are not stored. For a wide BVH, the rays are tested against the children of the root
while they are in lanes; those that meet none of them miss, and are not stored either. In open scenes and for rays from
anywhere that is a third to four fifths of all rays, and otherwise they would be prepared, stored, and given a place in a list
to find the same. The test is `slab_interval`, to the bit. It ends for a stream as soon as less than `WORTHWHILE` of its rays
have left. A stream is therefore loaded from as many rays as fill it. Figures: notebooks/records/2026-11-23-root-filter.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.simd.lanes import FOR_LANES, count_bits, lane_bits, lowest_bit
from wrt.kernels.simd.transpose import TRANSPOSE
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, ray_words, stream_ray
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

COMMON_WORDS = 14
"""4-byte words of a `stream_ray` before the state of the triangle test: slabs, t_min, best."""

PROBED = wp.constant(128)
"""Rays of a stream that are tested against the children of the root in any case."""

WORTHWHILE = wp.constant(0.25)
"""Share of the rays that must leave the stream at the root for the test to go on."""

RAYS_TO_LANES = (
    DIRECTION_LANES
    + """
    // not loaded to where they are stored below: of a select between the two the compiler makes a masked store, which is slow
    alignas(64) float ex[L], ey[L], ez[L], longest[L];
    // rays beyond the last are the first again, and not written
    auto number = [&](int k, int stride) { return (first + (k < here ? k : 0)) * stride; };
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    if (here == L && batch.origin_stride) {
        const float* o = (const float*)(batch.origins.data + first);
        WRT_FOR(L, k) {
            ox[k] = (float)((double)o[3 * k] - center_x);
            oy[k] = (float)((double)o[3 * k + 1] - center_y);
            oz[k] = (float)((double)o[3 * k + 2] - center_z);
        }
    } else WRT_SCALAR for (int k = 0; k < L; ++k) {
        const wp::vec3 o = batch.origins.data[number(k, batch.origin_stride)];
        ox[k] = (float)((double)o.c[0] - center_x);
        oy[k] = (float)((double)o.c[1] - center_y);
        oz[k] = (float)((double)o.c[2] - center_z);
    }
    if (here == L && batch.direction_stride) {
        const float* d = (const float*)(batch.directions.data + first);
        WRT_FOR(L, k) { ex[k] = d[3 * k]; ey[k] = d[3 * k + 1]; ez[k] = d[3 * k + 2]; }
    } else WRT_SCALAR for (int k = 0; k < L; ++k) {
        const wp::vec3 d = batch.directions.data[number(k, batch.direction_stride)];
        ex[k] = d.c[0]; ey[k] = d.c[1]; ez[k] = d.c[2];
    }
    if (here == L && batch.t_min_stride) { WRT_FOR(L, k) t_min[k] = batch.t_min.data[first + k]; }
    else WRT_SCALAR for (int k = 0; k < L; ++k) t_min[k] = batch.t_min.data[number(k, batch.t_min_stride)];
    if (here == L && batch.t_max_stride) { WRT_FOR(L, k) longest[k] = batch.t_max.data[first + k]; }
    else WRT_SCALAR for (int k = 0; k < L; ++k) longest[k] = batch.t_max.data[number(k, batch.t_max_stride)];
    WRT_FOR(L, k) {
        float x = ex[k], y = ey[k], z = ez[k];
        wrt_direction(x, y, z);
        dx[k] = x; dy[k] = y; dz[k] = z;
        t[k] = longest[k] > FARTHEST ? FARTHEST : longest[k];
    }
"""
)
"""C++ that loads the `here` rays of `batch` from `first` on, at most L: ox, oy, oz (relative to the centre), dx, dy, dz, t_min
and t."""

VALID_LANE = """
        const float x = dx[k], y = dy[k], z = dz[k], px = ox[k], py = oy[k], pz = oz[k];
        const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
        const bool valid = (x - x == 0.0f) & (y - y == 0.0f) & (z - z == 0.0f)
            & (px - px == 0.0f) & (py - py == 0.0f) & (pz - pz == 0.0f)
            & (size >= SHORTEST) & (t_min[k] >= 0.0f) & (t_min[k] <= t[k]);
"""
"""C++ that loads ray k of those and sets `valid`, as `load_ray` does."""

_LOAD = """
    const float INF = __builtin_bit_cast(float, 0x7f800000);
    const int here = count < L ? count : L;
    float *ox = own.data, *oy = ox + L, *oz = oy + L, *dx = oz + L, *dy = dx + L, *dz = dy + L;
    alignas(64) float words[WORDS < 16 ? 16 : WORDS][L];
    float *ix = words[0], *iy = words[1], *iz = words[2], *t_min = words[9];
    alignas(64) float t[L];
    int *primitive = (int*)words[11], stored[L];
WRT_RAYS    WRT_FOR(L, k) {
WRT_VALID        float far = WRT_ABS(low.c[0] - px), f;
        f = WRT_ABS(high.c[0] - px); far = f > far ? f : far;
        f = WRT_ABS(low.c[1] - py); far = f > far ? f : far;
        f = WRT_ABS(high.c[1] - py); far = f > far ? f : far;
        f = WRT_ABS(low.c[2] - pz); far = f > far ? f : far;
        f = WRT_ABS(high.c[2] - pz); far = f > far ? f : far;
        const float slack = SLACK * far, jx = 1.0f / x, jy = 1.0f / y, jz = 1.0f / z;
        const float step_x = jx < 0.0f ? -slack : slack, step_y = jy < 0.0f ? -slack : slack;
        const float step_z = jz < 0.0f ? -slack : slack;
        ix[k] = jx; iy[k] = jy; iz[k] = jz;
        words[3][k] = px + step_x; words[4][k] = py + step_y; words[5][k] = pz + step_z;
        words[6][k] = px - step_x; words[7][k] = py - step_y; words[8][k] = pz - step_z;
        t_min[k] = t_min[k] + 0.0f;  // turns -0 into +0: as an integer, -0 would be the least key of all
        words[10][k] = t[k];
        primitive[k] = -1;
        words[12][k] = 0.0f; words[13][k] = 0.0f;
        stored[k] = valid ? -1 : 0;
    }
    WRT_ROOT
    const unsigned kept = wrt_bits(stored) & ((1u << here) - 1u);
    if (kept == 0) return 0;
    WRT_PREPARE
    if (WORDS > COMMON) { WRT_FOR(L, k) ((int*)words[WORDS - 1])[k] = place + k; }
    float* to = (float*)(stream.data + size);
    wrt_write(words[0], to, RAY_WORDS, kept);
    if (WORDS > 16) wrt_write(words[WORDS - 16], to + WORDS - 16, RAY_WORDS, kept);
    return kept;
"""

_ROOT = """
    if (testing) {
        int met[L] = {};
        for (int c = 0; c < W; ++c) {
            const float low_x = bounds.data[c], low_y = bounds.data[W + c], low_z = bounds.data[2 * W + c];
            const float high_x = bounds.data[3 * W + c], high_y = bounds.data[4 * W + c], high_z = bounds.data[5 * W + c];
            WRT_FOR(L, k) {
                const float jx = ix[k], jy = iy[k], jz = iz[k];
                float enter = t_min[k], leave = t[k], s;
                s = ((jx < 0.0f ? high_x : low_x) - words[3][k]) * jx; enter = s > enter ? s : enter;
                s = ((jy < 0.0f ? high_y : low_y) - words[4][k]) * jy; enter = s > enter ? s : enter;
                s = ((jz < 0.0f ? high_z : low_z) - words[5][k]) * jz; enter = s > enter ? s : enter;
                s = ((jx < 0.0f ? low_x : high_x) - words[6][k]) * jx; leave = s < leave ? s : leave;
                s = ((jy < 0.0f ? low_y : high_y) - words[7][k]) * jy; leave = s < leave ? s : leave;
                s = ((jz < 0.0f ? low_z : high_z) - words[8][k]) * jz; leave = s < leave ? s : leave;
                met[k] |= enter <= leave ? -1 : 0;
            }
        }
        WRT_FOR(L, k) stored[k] &= met[k];
    }
"""
"""C++: clears `stored` for the rays that meet no child of the node at `bounds`."""


@cache
def load_lanes(triangle_test: str, width: int) -> wp.Function:
    """`func(batch, first, count, low, high, bounds, testing, stream, size, place, own) -> bits`: loads the next rays.

    They are the rays from `first` on, at most `count` and at most 16 of them, and `place` after the first ray of the stream.
    Those that are valid and, if `testing`, meet a child of the root are appended to the `size` rays of the stream; their bits
    are returned. bounds: as of `load_stream`. own: the origins and directions of the 16 rays, component by component.

    Raises:
        ValueError: a ray with the state of this triangle test does not fit into one or two vectors of 16 words.
    """
    test = TRIANGLE_TESTS[triangle_test]
    StreamRay, words, prepared = stream_ray(triangle_test), ray_words(triangle_test), bool(test.prepare_lanes)
    if not 16 <= words <= (32 if prepared else words):
        raise ValueError(f"triangle test {triangle_test!r} needs {words} words per ray; streams store 16 to 32 words per ray")
    constants = f"""{FOR_LANES}{TRANSPOSE}
    constexpr int L = {LIST_LANES}, W = {width}, COMMON = {COMMON_WORDS};
    constexpr int RAY_WORDS = {words}, WORDS = {words if prepared else COMMON_WORDS};
    constexpr float SLACK = {SLACK!r}f;
    {lane_bits("L")}
    """
    code = _LOAD.replace("WRT_RAYS", RAYS_TO_LANES).replace("WRT_VALID", VALID_LANE)
    code = code.replace("WRT_ROOT", _ROOT if width else "").replace("WRT_PREPARE", test.prepare_lanes)

    @wp.func_native(constants + code)
    def load_lanes_native(
        batch: RayBatch,
        first: int,
        count: int,
        low: wp.vec3,
        high: wp.vec3,
        bounds: wp.array(dtype=float),
        testing: wp.bool,
        stream: wp.array(dtype=StreamRay),
        size: int,
        place: int,
        own: wp.array(dtype=float),
    ) -> wp.uint32: ...

    return load_lanes_native


@cache
def prepare_one_by_one(triangle_test: str) -> wp.Function:
    """`wp.func(stream, size, bits, place, own)`: stores what a triangle test without `prepare_lanes` needs, and the numbers of
    the rays; arguments as of `load_lanes`, which has stored the rest."""
    test = TRIANGLE_TESTS[triangle_test]
    StreamRay, RayState, prepare = stream_ray(triangle_test), test.ray_state, test.prepare

    @wp.func_native("stream.data[k].state = state; stream.data[k].number = number;")
    def put_state(stream: wp.array(dtype=StreamRay), k: int, state: RayState, number: int): ...

    @wp.func
    def vector(own: wp.array(dtype=float), k: int, component: int):
        x = load_float(own, component * wp.static(LIST_LANES) + k)
        y = load_float(own, (component + 1) * wp.static(LIST_LANES) + k)
        return wp.vec3(x, y, load_float(own, (component + 2) * wp.static(LIST_LANES) + k))

    @wp.func
    def prepare_kept(stream: wp.array(dtype=StreamRay), size: int, bits: wp.uint32, place: int, own: wp.array(dtype=float)):
        left = wp.uint32(bits)
        k = int(size)
        while left != wp.uint32(0):
            lane = lowest_bit(left)
            put_state(stream, k, prepare(vector(own, lane, 0), vector(own, lane, 3)), place + lane)
            left = left & (left - wp.uint32(1))
            k += 1

    return prepare_kept


@cache
def load_stream(triangle_test: str, room: int, width: int = 0) -> wp.Function:
    """`wp.func(rays, begin, end, low, high, bounds, stream, size) -> count`: loads rays from `begin` on, until the stream
    is full or ray `end` is reached.

    Returns how many rays were loaded; `size` becomes the number of those that are in the stream. The others miss.

    Args:
        triangle_test: name of the triangle test.
        room: of a stream, in rays.
        width: children of a node of the wide BVH whose root the rays are tested against; 0 for none.

    Args (of the function): low, high: bounds of the scene. bounds: of the tree's nodes (`wrt.kernels.layout.bvh_nodes`); any
        array if `width` is 0.
    """
    StreamRay, load = stream_ray(triangle_test), load_lanes(triangle_test, width)
    prepared, own_size = bool(TRIANGLE_TESTS[triangle_test].prepare_lanes), 6 * LIST_LANES
    prepare_kept, group = prepare_one_by_one(triangle_test), min(room, LIST_LANES)

    @wp.func
    def load_rays(
        rays: RayBatch,
        begin: int,
        end: int,
        low: wp.vec3,
        high: wp.vec3,
        bounds: wp.array(dtype=float),
        stream: wp.array(dtype=StreamRay),
        size: wp.ref[int],
    ):
        own = wp.zeros(shape=(own_size,), dtype=float)
        place = int(0)
        kept = int(0)
        while begin + place < end and kept <= wp.static(room - group):
            testing = place < PROBED or float(place - kept) >= WORTHWHILE * float(place)
            count = wp.min(end - begin - place, wp.static(group))
            bits = load(rays, begin + place, count, low, high, bounds, testing, stream, kept, place, own)
            if wp.static(not prepared):
                prepare_kept(stream, kept, bits, place, own)
            place += count
            kept += count_bits(bits)
        size = kept  # noqa: F841 (a reference)
        return place

    return load_rays
