"""Light buffer on CPUs: 128 rays at a time, their tests 16 pairs of a ray and a triangle at a time.

**Problem.** A ray needs few triangles, often one or two: one ray against W triangles leaves lanes idle, and one ray after the
other waits for a cell, then an entry, then a triangle, each in another cache line.

**Idea.** The rays of an item go through each step together. Their cells are found in lanes, and each step prefetches what the
next one reads. In every round each remaining ray contributes its next triangle; the pairs, of any rays and triangles, are
tested 16 to a vector, as in a stream (`wrt.kernels.traversal.stream.stream_candidates`). A triangle here is one cache line of
vertices.

The arithmetic is that of `light_buffer_query`, to the bit. The triangle test must supply its code for such lanes
(`TestForm.native`); others use that kernel.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.light_cells import CELL_WORDS, DEPTH_SLACK, LightCells
from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.leaf import BOX_INTERVAL
from wrt.kernels.traversal.shadows.light_rays import LIT, OCCLUDED, UNDECIDED
from wrt.kernels.traversal.stream.stream_load import VALID_LANE
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import vertex_box

exact_module(__name__)

RUN = 128
"""Rays of an item: their numbers fit the first-level cache."""

RECORD_FLOATS = 16
"""Floats of a triangle in `make_pack_lines`: a cache line."""

_LOAD = """
        // rays beyond the last are the first again, and their results are dropped
        WRT_SCALAR for (int k = 0; k < L; ++k) {
            const size_t n = begin + WRT_NUMBER;
            const wp::vec3 o = batch.origins.data[n * batch.origin_stride];
            gx[k] = o.c[0]; gy[k] = o.c[1]; gz[k] = o.c[2];
            t_min[k] = batch.t_min.data[n * batch.t_min_stride];
            t[k] = batch.t_max.data[n * batch.t_max_stride];
        }
        WRT_FOR(L, k) {
            float x = (float)(light_x - (double)gx[k]), y = (float)(light_y - (double)gy[k]);
            float z = (float)(light_z - (double)gz[k]);
            ox[k] = (float)((double)gx[k] - center_x);
            oy[k] = (float)((double)gy[k] - center_y);
            oz[k] = (float)((double)gz[k] - center_z);
            wrt_direction(x, y, z);
            dx[k] = x; dy[k] = y; dz[k] = z;
        }
"""
"""C++ that loads L rays as `light_ray` does: number k of them is that of `WRT_NUMBER`, counted from the item's first."""

_REACH = """            float far = WRT_ABS(low.c[0] - px), f;
            f = WRT_ABS(high.c[0] - px); far = f > far ? f : far;
            f = WRT_ABS(low.c[1] - py); far = f > far ? f : far;
            f = WRT_ABS(high.c[1] - py); far = f > far ? f : far;
            f = WRT_ABS(low.c[2] - pz); far = f > far ? f : far;
            f = WRT_ABS(high.c[2] - pz); far = f > far ? f : far;
"""

_FIND = """
    alignas(64) float gx[L], gy[L], gz[L], ox[L], oy[L], oz[L], dx[L], dy[L], dz[L], words[WORDS][L];
    float *ix = words[0], *iy = words[1], *iz = words[2], *t_min = words[9], *t = words[10];
    alignas(64) float most[RUN], sure[RUN], least[RUN];
    alignas(64) int cell[RUN], state[RUN];
    const double center_x = batch.center.c[0], center_y = batch.center.c[1], center_z = batch.center.c[2];
    const double light_x = target.c[0], light_y = target.c[1], light_z = target.c[2];
    const int resolution = cells.resolution;
    const float half_resolution = 0.5f * (float)resolution, slack_depth = cells.slack, limit = cells.limit;
    const wp::vec3 low = cells.low, high = cells.high;
    for (int from = 0; from < count; from += L) {
        const int here = count - from < L ? count - from : L;
WRT_LOAD        WRT_FOR(L, k) {
WRT_VALIDWRT_REACH            const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
            const bool main_x = xy & xz, main_y = !xy & yz;
            const float depth = main_x ? size_x : main_y ? size_y : size_z, ahead = main_x ? x : main_y ? y : z;
            const float u = -(main_x ? y : main_y ? z : x) / depth, v = -(main_x ? z : main_y ? x : y) / depth;
            int i = (int)((u + 1.0f) * half_resolution), j = (int)((v + 1.0f) * half_resolution);
            i = i < resolution - 1 ? i : resolution - 1;
            j = j < resolution - 1 ? j : resolution - 1;
            const int face = (main_x ? 0 : main_y ? 2 : 4) + (ahead > 0.0f ? 1 : 0);
            const float start = (1.0f - t_min[k]) * depth, end = (1.0f - t[k]) * depth;
            const int place = (face * resolution + j) * resolution + i;
            cell[from + k] = valid ? place : 0;
            most[from + k] = start * (1.0f + DEPTH_SLACK) + slack_depth;
            sure[from + k] = start * (1.0f - DEPTH_SLACK) - slack_depth;
            least[from + k] = t[k] == 1.0f ? 0.0f : end * (1.0f + DEPTH_SLACK) + slack_depth;
            const bool decided = (far <= limit) & (t[k] <= 1.0f);
            state[from + k] = valid ? (decided ? WAITING : UNDECIDED) : LIT;
        }
        for (int k = 0; k < here; ++k) WRT_FETCH(cells.cells.data + CELL_WORDS * (size_t)cell[from + k]);
    }
"""
"""C++: the cells of the rays of an item, as `find_cell`, and the depths of their hits."""

_PREPARE = """
    alignas(64) float rays_words[RUN * STRIDE];
    for (int from = 0; from < waiting; from += L) {
        const int here = waiting - from < L ? waiting - from : L;
WRT_LOAD        WRT_FOR(L, k) {
            const float px = ox[k], py = oy[k], pz = oz[k];
WRT_REACH            const float slack = SLACK * far, jx = 1.0f / dx[k], jy = 1.0f / dy[k], jz = 1.0f / dz[k];
            const float step_x = jx < 0.0f ? -slack : slack, step_y = jy < 0.0f ? -slack : slack;
            const float step_z = jz < 0.0f ? -slack : slack;
            ix[k] = jx; iy[k] = jy; iz[k] = jz;
            words[3][k] = px + step_x; words[4][k] = py + step_y; words[5][k] = pz + step_z;
            words[6][k] = px - step_x; words[7][k] = py - step_y; words[8][k] = pz - step_z;
            words[11][k] = 0.0f; words[12][k] = 0.0f; words[13][k] = 0.0f;
        }
        WRT_PREPARE
        wrt::write_records(words[0], rays_words + from * STRIDE, STRIDE, (1u << here) - 1u);
        wrt::write_records(words[WORDS - 16], rays_words + from * STRIDE + WORDS - 16, STRIDE, (1u << here) - 1u);
    }
"""
"""C++: what box and triangle tests read of the rays that wait."""

_CELLS = """
    // without branches: which rays wait is hard to predict
    alignas(64) int rest[RUN + 1], place[RUN], last[RUN], ignored[RUN], waits[RUN];
    for (int from = 0; from < count; from += L) {
        const int* word = cells.cells.data;
        WRT_FOR(L, i) {
            const int k = from + i, at = CELL_WORDS * (from + i < count ? cell[k] : 0);
            const float far = __builtin_bit_cast(float, word[at + 2]), nearest = __builtin_bit_cast(float, word[at + 3]);
            const int first = word[at], entries = word[at + 1], before = state[k];
            const int skip = skipped.data[(begin + (from + i < count ? k : 0)) * skip_stride];
            const bool behind = far <= most[k], open = behind & !(least[k] <= nearest), hidden = (far <= sure[k]) & (skip < 0);
            const int found = (open | (behind & (skip >= 0) & !hidden)) ? UNDECIDED : hidden ? OCCLUDED : LIT;
            state[k] = before == WAITING ? found : before;
            waits[k] = ((before == WAITING) & !open & !hidden & (nearest <= most[k])) ? 1 : 0;
            place[k] = first; last[k] = first + entries; ignored[k] = skip;
        }
    }
    int waiting = 0, slot[RUN];
    for (int k = 0; k < count; ++k) {
        rest[waiting] = k;
        slot[k] = waiting;
        waiting += waits[k];
    }
    for (int n = 0; n < waiting; ++n) WRT_FETCH(cells.entries.data + place[rest[n]]);
"""
"""C++: the lists of the rays that wait."""

_ROUNDS = """
    int pair_ray[RUN + 2 * L], pair_triangle[RUN + 2 * L];
    while (waiting) {
        // rays that are left with long lists fill the vectors with several triangles each
        const int share = waiting < 2 * L ? 2 * L / waiting : 1;
        int pairs = 0;
        for (int turn = 0; turn < share; ++turn) for (int n = 0; n < waiting; ++n) {
            const int k = rest[n], at = place[k], end = last[k];
            const unsigned long long entry = cells.entries.data[at < end ? at : end - 1];
            const int triangle = (int)(unsigned)entry;
            const bool ahead = (at < end) & (__builtin_bit_cast(float, (unsigned)(entry >> 32)) <= most[k]);
            WRT_FETCH(records.data + RECORD * (size_t)triangle);
            pair_ray[pairs] = k;
            pair_triangle[pairs] = triangle;
            pairs += (ahead & (triangle != ignored[k])) ? 1 : 0;
            place[k] = ahead ? at + 1 : end;
        }
        for (int p = pairs; p < pairs + L; ++p) { pair_ray[p] = pair_ray[0]; pair_triangle[p] = pair_triangle[0]; }
        for (int first = 0; first < pairs; first += L) {
            alignas(64) float words[WORDS][L], corner[16][L], t[L], u[L], v[L];
            int near[L];
            const float *from[L], *line[L];
            WRT_SCALAR for (int i = 0; i < L; ++i) {
                from[i] = rays_words + slot[pair_ray[first + i]] * STRIDE;
                line[i] = records.data + RECORD * (size_t)pair_triangle[first + i];
            }
            wrt::read_records(line, 0, corner[0]);
            wrt::read_records(from, 0, words[0]);
            wrt::read_records(from, WORDS - 16, words[WORDS - 16]);
            CANDIDATE_LANES
            WRT_FOR_LANES(i) {
                float low[3], high[3];
                VERTEX_BOX
                const float ix = words[0][i], iy = words[1][i], iz = words[2][i];
                const float in_x = words[3][i], in_y = words[4][i], in_z = words[5][i];
                const float out_x = words[6][i], out_y = words[7][i], out_z = words[8][i];
                const bool back_x = ix < 0.0f, back_y = iy < 0.0f, back_z = iz < 0.0f, meets = t[i] == t[i];
                float at = t[i];
                BOX_INTERVAL
                near[i] = (meets & (enter <= leave) & (at >= words[9][i]) & (at <= words[10][i])) ? -1 : 0;
            }
            for (unsigned hit = wrt::bits<W>(near); hit; hit &= hit - 1u)
                state[pair_ray[first + wrt::lowest_bit(hit)]] = OCCLUDED;
        }
        int left = 0;
        for (int n = 0; n < waiting; ++n) {
            const int k = rest[n];
            rest[left] = k;
            left += ((state[k] != OCCLUDED) & (place[k] < last[k])) ? 1 : 0;
        }
        waiting = left;
    }
    bool open = false;
    for (int k = 0; k < count; ++k) {
        answers.data[begin + k] = (unsigned char)state[k];
        open |= state[k] == UNDECIDED;
    }
    if (open) undecided.data[0] = 1;
"""
"""C++: rounds of tests, and the answers."""

WORDS = 23
"""Words of a ray: slabs, t_min, t_max, three unused ones, and the state of the triangle test."""


@cache
def make_answer(triangle_test: str) -> wp.Function:
    """`wp.func(cells, records, batch, target, skipped, skip_stride, begin, count, answers, undecided)`: the rays of an item."""
    test = TRIANGLE_TESTS[triangle_test]
    constants = f"""
    constexpr int L = 16, W = 16, RUN = {RUN}, WORDS = {WORDS}, STRIDE = {WORDS + 1}, RECORD = {RECORD_FLOATS};
    constexpr int CELL_WORDS = {CELL_WORDS}, LIT = {LIT}, OCCLUDED = {OCCLUDED}, UNDECIDED = {UNDECIDED}, WAITING = 3;
    constexpr float SLACK = {SLACK!r}f, DEPTH_SLACK = {DEPTH_SLACK!r}f;
    {DIRECTION_LANES}
    """
    pieces = {"WRT_REACH": _REACH, "WRT_VALID": VALID_LANE}
    find = _FIND.replace("WRT_LOAD", _LOAD.replace("WRT_NUMBER", "from + (k < here ? k : 0)"))
    prepare = _PREPARE.replace("WRT_LOAD", _LOAD.replace("WRT_NUMBER", "rest[from + (k < here ? k : 0)]"))
    prepare = prepare.replace("WRT_PREPARE", f"{test.native}::prepare<L>(words, dx, dy, dz, ox, oy, oz);")
    for name, piece in pieces.items():
        find, prepare = find.replace(name, piece), prepare.replace(name, piece)
    rounds = _ROUNDS.replace("CANDIDATE_LANES", f"{test.native}::test<L>(words, corner, t, u, v);")
    rounds = rounds.replace("VERTEX_BOX", vertex_box("corner[0]", "i")).replace("BOX_INTERVAL", BOX_INTERVAL)

    @native.func_native("ray.h triangle.h", constants + find + _CELLS + prepare + rounds)
    def answer_native(
        cells: LightCells,
        records: wp.array(dtype=float),
        batch: RayBatch,
        target: wp.vec3d,
        skipped: wp.array(dtype=int),
        skip_stride: int,
        begin: int,
        count: int,
        answers: wp.array(dtype=wp.uint8),
        undecided: wp.array(dtype=int),
    ): ...

    return answer_native


@cache
def make_lane_kernel(triangle_test: str) -> wp.Kernel:
    """The kernel for a triangle test with a `native` form; arguments as of `light_buffer_query.make_kernel`."""
    answer = make_answer(triangle_test)

    def light_buffer_lanes(
        first: int,
        cells: LightCells,
        records: wp.array(dtype=float),
        rays: RayBatch,
        target: wp.vec3d,
        skipped: wp.array(dtype=int),
        skip_stride: int,
        answers: wp.array(dtype=wp.uint8),
        undecided: wp.array(dtype=int),
    ):
        """Item: a run of rays; records are those of `pack_lines`."""
        begin = (first + wp.tid()) * wp.static(RUN)
        count = wp.min(wp.static(RUN), rays.count - begin)
        answer(cells, records, rays, target, skipped, skip_stride, begin, count, answers, undecided)

    return specialised_kernel(light_buffer_lanes)


@wp.kernel
def pack_lines(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    records: wp.array(dtype=float),
):
    """Writes the vertices of a triangle to a cache line. Item: a triangle."""
    i = first + wp.tid()
    face = faces[i]
    at = i * wp.static(RECORD_FLOATS)
    for corner in range(3):
        vertex = vertices[face[corner]]
        for axis in range(3):
            records[at + 3 * corner + axis] = vertex[axis]
