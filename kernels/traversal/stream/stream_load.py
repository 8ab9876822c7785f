"""Loads rays of a batch into a stream, 16 at a time.

The rays of a stream are stored one after the other, each with all its numbers, because filters and tests read them like that.
Here they are computed component by component, 16 rays to a vector, and then transposed (`kernels/native/lanes.h`), so that a
ray is written by one or two vector stores. The per-ray data of the triangle test is included if the test supplies
`TestForm.native`; other tests prepare one ray after the other. The arithmetic is that of `load_ray`, `ray_slabs` and
`prepare`, to the bit. Figures: notebooks/records/2026-11-21-streams.md.

Invalid rays are not stored, so a stream is loaded from as many rays as fill it. For a wide BVH, neither are rays that meet no
child of the root (`wrt.kernels.traversal.stream.stream_root`).
"""

from collections.abc import Callable
from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.simd.lanes import count_bits, lowest_bit
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, ray_words, stream_ray
from wrt.kernels.traversal.stream.stream_lists import LISTS
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

COMMON_WORDS = 14
"""4-byte words of a `stream_ray` before the state of the triangle test: slabs, t_min, best."""

FEW = 3
"""Greatest number of rays of a group that are written word by word, without a transposition."""


def _to_lanes(origin: str, relative: bool) -> str:
    """C++ that loads the `here` rays of `batch` from `first` on, at most L, into the arrays `origin` x, y and z (relative to
    the centre, or as the caller gives them), ex, ey, ez, t_min and t."""

    def numbers(array: str, names: str, of: Callable[[str, str], str]) -> str:
        to = [f"{names}{axis}[k] = " for axis in "xyz"]
        side_by_side = "".join(f"{to[a]}{of(f'v[3 * k + {a}]', 'xyz'[a])}; " for a in range(3))
        one_by_one = "".join(f"{to[a]}{of(f'v.c[{a}]', 'xyz'[a])}; " for a in range(3))
        return f"""
    if (here == L && batch.{array}_stride) {{
        const float* v = (const float*)(batch.{array}s.data + first);
        WRT_FOR(L, k) {{ {side_by_side}}}
    }} else WRT_SCALAR for (int k = 0; k < L; ++k) {{
        const wp::vec3 v = batch.{array}s.data[number(k, batch.{array}_stride)];
        {one_by_one}
    }}"""

    origins = numbers("origin", origin, lambda value, axis: _RELATIVE.format(value, axis) if relative else value)
    return f"""
    // rays beyond the last are the first again, and not written
    auto number = [&](int k, int stride) {{ return (first + (k < here ? k : 0)) * stride; }};
{origins}{numbers("direction", "e", lambda value, axis: value)}
    auto range = [&](const float* from, int stride, float* to) {{
        if (stride == 0) {{ const float all = from[0]; WRT_FOR(L, k) to[k] = all; }}
        else if (here == L) {{ WRT_FOR(L, k) to[k] = from[first + k]; }}
        else {{ WRT_SCALAR for (int k = 0; k < L; ++k) to[k] = from[number(k, 1)]; }}
    }};
    range(batch.t_min.data, batch.t_min_stride, t_min);
    range(batch.t_max.data, batch.t_max_stride, longest);
    WRT_FOR(L, k) t[k] = longest[k] > FARTHEST ? FARTHEST : longest[k];
"""


_RELATIVE = "(float)((double){0} - center_{1})"
"""C++ of a coordinate of an origin, relative to the centre."""

_GIVEN = (
    DIRECTION_LANES
    + """
    // not loaded to where they are stored below: of a select between the two the compiler makes a masked store, which is slow
    alignas(64) float ex[L], ey[L], ez[L], longest[L];
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
"""
)

_HEAD = f"""{_GIVEN}
    int here = count < L ? count : L;
    float ox[L], oy[L], oz[L], dx[L], dy[L], dz[L], t_min[L], t[L];
    int stored[L];
"""

_DIRECTIONS = """
    WRT_FOR(L, k) {
        float x = ex[k], y = ey[k], z = ez[k];
        wrt_direction(x, y, z);
        dx[k] = x; dy[k] = y; dz[k] = z;
    }
"""

RAYS_TO_LANES = _GIVEN + _to_lanes("o", relative=True) + _DIRECTIONS
"""C++ that loads the `here` rays of `batch` from `first` on, at most L, into the caller's arrays ox, oy, oz (relative to the
centre), dx, dy, dz, t_min and t."""

VALID_LANE = """
        const float x = dx[k], y = dy[k], z = dz[k], px = ox[k], py = oy[k], pz = oz[k];
        const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
        const bool valid = (x - x == 0.0f) & (y - y == 0.0f) & (z - z == 0.0f)
            & (px - px == 0.0f) & (py - py == 0.0f) & (pz - pz == 0.0f)
            & (size >= SHORTEST) & (t_min[k] >= 0.0f) & (t_min[k] <= t[k]);
"""
"""C++ that loads ray k of those and sets `valid`, as `load_ray` does."""

_VALID = f"""
    WRT_FOR(L, k) {{{VALID_LANE}
        stored[k] = valid ? -1 : 0;
    }}
"""

FETCH = f"""{_HEAD}
    if (count > 0) {{{_to_lanes("o", relative=True)}{_DIRECTIONS}{_VALID}
    }}
"""
"""C++ after `constants`: the `here` rays of the batch from `first` on, at most `count` and at most 16 of them, in lanes: ox,
oy, oz (relative to the centre), dx, dy, dz, t_min and t. `stored`: not 0 if a ray is valid. No memory of the batch is read if
`count` is 0."""

FETCH_GIVEN = f"""{_HEAD}
    float given_x[L], given_y[L], given_z[L];
    if (count > 0) {{{_to_lanes("given_", relative=False)}
    }}
"""
"""C++ of the first half of `FETCH`: origins `given_x`, `given_y`, `given_z` and directions ex, ey, ez as the caller gives them,
t_min and t."""

FINISH_GIVEN = f"""
    WRT_FOR(L, k) {{
        ox[k] = {_RELATIVE.format("given_x[k]", "x")};
        oy[k] = {_RELATIVE.format("given_y[k]", "y")};
        oz[k] = {_RELATIVE.format("given_z[k]", "z")};
    }}
{_DIRECTIONS}{_VALID}"""
"""C++ of the second half."""

_WRITE = """
    const float INF = __builtin_bit_cast(float, 0x7f800000);
    alignas(64) float words[WORDS < 16 ? 16 : WORDS][L];
    float *ix = words[0], *iy = words[1], *iz = words[2];
    int* primitive = (int*)words[11];
    WRT_FOR(L, k) {
        const float x = dx[k], y = dy[k], z = dz[k], px = ox[k], py = oy[k], pz = oz[k];
        float far = WRT_ABS(low.c[0] - px), f;
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
        words[9][k] = t_min[k] + 0.0f;  // turns -0 into +0: as an integer, -0 would be the least key of all
        words[10][k] = t[k];
        primitive[k] = -1;
        words[12][k] = 0.0f; words[13][k] = 0.0f;
    }
    WRT_ROOT
    const unsigned kept = wrt::bits<L>(stored) & ((1u << here) - 1u);
    if (kept == 0) return 0;
    WRT_LIST
    WRT_PREPARE
    if (WORDS > COMMON) { WRT_FOR(L, k) ((int*)words[WORDS - 1])[k] = WRT_NUMBER; }
    float* to = (float*)(stream.data + size);
    if (wrt::count_bits(kept) <= FEW) {
        for (unsigned left = kept; left; left &= left - 1u, to += RAY_WORDS) {
            const float* own_word = words[0] + wrt::lowest_bit(left);
            WRT_UNROLLED for (int c = 0; c < WORDS; ++c) to[c] = own_word[c * L];
        }
        return kept;
    }
    wrt::write_records(words[0], to, RAY_WORDS, kept);
    if (WORDS > 16) wrt::write_records(words[WORDS - 16], to + WORDS - 16, RAY_WORDS, kept);
    return kept;
"""

KEPT_SIZE = 7 * LIST_LANES
"""Floats of `own`: what `prepare_one_by_one` reads, origins, directions and numbers of the rays in lanes, component by
component."""

_KEEP = """
    const float* const kept_of[6] = {ox, oy, oz, dx, dy, dz};
    WRT_UNROLLED for (int row = 0; row < 6; ++row) { WRT_FOR(L, k) own.data[row * L + k] = kept_of[row][k]; }
    WRT_FOR(L, k) ((int*)own.data)[6 * L + k] = WRT_NUMBER;
"""


def constants(triangle_test: str) -> str:
    """C++ for the head of a function that contains `FETCH` or `written`.

    Raises:
        ValueError: a ray with the state of this triangle test does not fit into one or two vectors of 16 words.
    """
    words, prepared = ray_words(triangle_test), bool(TRIANGLE_TESTS[triangle_test].native)
    if not 16 <= words <= (32 if prepared else words):
        raise ValueError(f"triangle test {triangle_test!r} needs {words} words per ray; streams store 16 to 32 words per ray")
    return f"""{LISTS}
    constexpr int COMMON = {COMMON_WORDS}, FEW = {FEW}, RAY_WORDS = {words}, WORDS = {words if prepared else COMMON_WORDS};
    constexpr float SLACK = {SLACK!r}f;
    """


def written(triangle_test: str, root: str = "", listing: str = "", number: str = "place + k") -> str:
    """C++ that appends the stored ones of the `here` rays in lanes (`FETCH`) to the `size` rays of the stream and returns their
    bits. low, high: bounds of the scene. own: receives what `prepare_one_by_one` reads (`KEPT_SIZE`), if it is needed.

    Args:
        triangle_test: name of the triangle test.
        root: C++ that may clear `stored[k]`, then ray k is not stored. It finds the first `COMMON` words of the rays in
            `words`.
        listing: C++ for the rays that are stored, whose bits are `kept`; not carried out if there are none.
        number: C++ of the number of ray k, after the first ray of the stream.
    """
    test = TRIANGLE_TESTS[triangle_test]
    code = ("" if test.native else _KEEP) + _WRITE.replace("WRT_PREPARE", f"{test.native}::prepare<L>(words, dx, dy, dz, ox, oy, oz);" if test.native else "")
    code = code.replace("WRT_NUMBER", number)
    return code.replace("WRT_ROOT", root).replace("WRT_LIST", listing)


@cache
def load_lanes(triangle_test: str) -> wp.Function:
    """`func(batch, first, count, low, high, stream, size, place, own) -> bits`: loads the next rays, from `first` on, at most
    `count` and at most 16 of them, and `place` after the first ray of the stream.

    Those that are valid are appended to the `size` rays of the stream; their bits are returned. own: see `written`.
    """

    @native.func_native("triangle.h", constants(triangle_test) + FETCH + written(triangle_test))
    def load_lanes_native(
        batch: RayBatch,
        first: int,
        count: int,
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
    rays, after `written` has stored the rest. own: see `KEPT_SIZE`."""
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
            bits = load(rays, begin + place, count, low, high, stream, kept, place, own)
            if wp.static(not prepared):
                prepare_kept(stream, kept, bits, own)
            place += count
            kept += count_bits(bits)
        size = kept  # noqa: F841 (a reference)
        return place

    return load_rays
