"""Boxes around the rays of a stream, from origin to end, which tell that most short rays meet nothing.

**Problem.** Most of the short rays in an open scene, such as those of ambient occlusion, meet no child of the root. Before that
is known, each of them is prepared, with three divisions, and tested against all children. The few rays of a group that stay
then leave most lanes idle.

**Idea.** Compare the box around each ray with the boxes of the children. Both are rounded to the cells of a grid, so that 16
rays are compared at a time as 16-bit numbers: a saturated difference for each of six planes, whose sign is that of a gap. Rays
whose box meets no child are done. The others wait until there are 16 of them, which are then made relative to the scene's
centre, checked, prepared, tested and stored together.

Long rays meet most boxes. If more than `MANY` rays of a group of 16 stay, the next `PAUSE` groups are not compared, nor do they
wait.

**Exactness.** A hit is a point origin + t direction within the slack of its triangle's box. The children's boxes are widened
for that, for the rounding of the rays' ends (as in `wrt.kernels.traversal.packet.rays.reversed_bounds`), and for rounding to
cells. Rays that end so far away that this does not suffice meet every box. On CUDA boxes are not compared.

Figures: notebooks/records/2026-11-26-joined-packets.md, notebooks/records/2026-11-26-masked-stores.md.
"""

from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.reversed_bounds import ENDS_ERROR
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

MANY = 12
"""Rays of a group of 16 whose box meets a child, so that the next boxes will not pay."""

PAUSE = 15
"""Groups for which they are left out."""

ROWS = 9
"""Numbers of a waiting ray: origin, direction, number, t_min, t."""

ROOM = 2 * LIST_LANES
"""Waiting rays: less than a group, and the next group."""

CELLS = 65000
"""Cells along the longest side of the scene's box."""

MARGIN = 2
"""Cells by which the boxes of children are widened: 1.1 for the rounding of both boxes to cells, the rest for `ERROR`."""

ERROR = 3.0 * SLACK + ENDS_ERROR
"""By which the box around a ray must be widened, as a fraction of the sum of the largest coordinates of ray and scene."""

GRID = 8
"""Floats that describe the grid: cells per unit of length; what is added to x, y and z in cells; the largest coordinate of a
box around a ray for which `MARGIN` suffices; the scene's centre, from which coordinates count, as floats."""


def box_memory(width: int) -> int:
    """Floats of memory: waiting rays, the grid, and six planes of each child, in cells, once for each lane."""
    return ROWS * ROOM + GRID + 3 * width * LIST_LANES


BOX_CONSTANTS = f"""
    constexpr int ROWS = {ROWS}, ROOM = {ROOM}, GRID = {GRID}, MANY = {MANY}, PAUSE = {PAUSE}, MARGIN = {MARGIN};
    constexpr float ERROR = {ERROR!r}f, CELLS = {CELLS}.0f;
    constexpr float WHOLE = 12582912.0f;
    constexpr unsigned WHOLE_BITS = 0x4b400000u;
    float* const waiting = lanes.data + (W + 1) * L;
    float* const grid = waiting + ROWS * ROOM;
    float* const planes = grid + GRID;
#if defined(__clang__) && !defined(__CUDA_ARCH__)
    typedef float wrt_spans __attribute__((ext_vector_type(16)));
    typedef int wrt_numbers __attribute__((ext_vector_type(16)));
    typedef unsigned wrt_unsigned __attribute__((ext_vector_type(16)));
    typedef short wrt_cells __attribute__((ext_vector_type(16)));
    typedef bool wrt_flags __attribute__((ext_vector_type(16)));
    // WHOLE is 1.5 * 2^23: the bits of a float near it, less those of it, are the nearest whole number
    auto wrt_cell = [](wrt_spans x, float scale, float offset) {{
        const wrt_spans cell = x * scale + offset;
        return (wrt_numbers)(__builtin_bit_cast(wrt_unsigned, cell) - WHOLE_BITS);
    }};
    auto wrt_narrow = [](wrt_numbers cell) {{
        cell = __builtin_elementwise_max(cell, (wrt_numbers)-32768);
        return __builtin_convertvector(__builtin_elementwise_min(cell, (wrt_numbers)32767), wrt_cells);
    }};
#endif
"""
"""C++ after `lanes`, W and L. wrt_cell: the cells of 16 coordinates, whole numbers; wrt_narrow: the nearest 16-bit ones."""

BEGIN_BOXES = """
#if defined(__clang__) && !defined(__CUDA_ARCH__)
    float longest = 0.0f, scene = 0.0f;
    double rest[3];  // of the centre, which has more digits than a float
    for (int a = 0; a < 3; ++a) {
        grid[5 + a] = (float)center.c[a];
        rest[a] = center.c[a] - (double)grid[5 + a];
        longest = high.c[a] - low.c[a] > longest ? high.c[a] - low.c[a] : longest;
        scene = WRT_ABS(low.c[a]) > scene ? WRT_ABS(low.c[a]) : scene;
        scene = WRT_ABS(high.c[a]) > scene ? WRT_ABS(high.c[a]) : scene;
    }
    const float scale = CELLS < 1e30f * longest ? CELLS / longest : 1e30f;  // 0 if the length is infinite
    grid[0] = scale;
    grid[4] = (MARGIN - 1.1f) / (ERROR * scale) - scene;
    for (int a = 0; a < 3; ++a) {
        grid[1 + a] = (float)(WHOLE - 0.5 * CELLS - (low.c[a] + rest[a]) * scale);
        grid[4] -= 2.0f * WRT_ABS((float)rest[a]);
    }
    for (int c = 0; c < W; ++c) {
        for (int plane = 0; plane < 6; ++plane) {
            const float at = used >> c & 1u ? (float)(bounds.data[plane * W + c] + rest[plane % 3]) : 0.0f;
            const int margin = plane < 3 ? -MARGIN : MARGIN;
            const wrt_cells cell = wrt_narrow(wrt_cell((wrt_spans)at, scale, grid[1 + plane % 3]) + margin);
            __builtin_memcpy(planes + (6 * c + plane) * (L / 2), &cell, sizeof(cell));
        }
    }
#endif
"""
"""C++ after `BOX_CONSTANTS`: writes the grid, and the planes of the root's children in cells."""

BOXES = """
    int own_number[L];
    WRT_FOR(L, k) own_number[k] = place + k;
    float* const lanes_of[ROWS] = {given_x, given_y, given_z, ex, ey, ez, (float*)own_number, t_min, t};
    bool waits = count == 0;
    if (count > 0 && state.unboxed > 0) --state.unboxed;
    else if (count > 0) {
        unsigned bits = (1u << here) - 1u;
#if defined(__clang__) && !defined(__CUDA_ARCH__)
        wrt_spans far_t, least = (wrt_spans)WRT_INFINITY, most = -least;
        wrt_cells from[3], to[3];
        __builtin_memcpy(&far_t, t, sizeof(far_t));
        WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            wrt_spans origin, along;
            __builtin_memcpy(&origin, lanes_of[a], sizeof(origin));
            __builtin_memcpy(&along, lanes_of[3 + a], sizeof(along));
            origin -= grid[5 + a];
            const wrt_spans end = origin + far_t * along;
            const wrt_spans low_end = origin < end ? origin : end, high_end = origin > end ? origin : end;
            least = low_end < least ? low_end : least; most = high_end > most ? high_end : most;
            from[a] = wrt_narrow(wrt_cell(low_end, grid[0], grid[1 + a]));
            to[a] = wrt_narrow(wrt_cell(high_end, grid[0], grid[1 + a]));
        }
        wrt_cells apart = (wrt_cells)-1;
        for (unsigned left = state.used; left; left &= left - 1u) {
            wrt_cells plane[6];
            __builtin_memcpy(plane, planes + wrt::lowest_bit(left) * 3 * L, sizeof(plane));
            wrt_cells own = (wrt_cells)0;
            WRT_UNROLLED for (int a = 0; a < 3; ++a) {
                own |= __builtin_elementwise_sub_sat(to[a], plane[a]) | __builtin_elementwise_sub_sat(plane[3 + a], from[a]);
            }
            apart &= own;
        }
        const wrt_flags meet = __builtin_convertvector(apart >= (wrt_cells)0, wrt_flags);
        const wrt_flags beyond = __builtin_convertvector(
            !((least >= (wrt_spans)-grid[4]) & (most <= (wrt_spans)grid[4])), wrt_flags);
        unsigned short meeting, leaving;
        __builtin_memcpy(&meeting, &meet, sizeof(meeting)); __builtin_memcpy(&leaving, &beyond, sizeof(leaving));
        const unsigned reach = meeting | leaving;
        if (wrt::count_bits(reach) > MANY) state.unboxed = PAUSE;
        bits &= reach;
#endif
        int* const to_row = (int*)waiting + state.waiting;
        WRT_UNROLLED for (int row = 0; row < ROWS; ++row) wrt::append<L>(to_row + row * ROOM, (const int*)lanes_of[row], bits);
        state.waiting += wrt::count_bits(bits);
        waits = true;
    }
    if (waits) {
        if (state.waiting < L && count > 0) return 0;
        here = state.waiting < L ? state.waiting : L;
        state.waiting -= here;
        WRT_UNROLLED for (int row = 0; row < ROWS; ++row) {
            float* const from = waiting + row * ROOM;
            WRT_FOR(L, k) lanes_of[row][k] = from[k];
            WRT_FOR(L, k) from[k] = from[L + k];
        }
    }
"""
"""C++ between `wrt.kernels.traversal.stream.stream_load.FETCH_GIVEN`, after `BOX_CONSTANTS`, and `FINISH_GIVEN`: compares the
rays in lanes and lets them wait; then the lanes hold rays that have waited, and `own_number` their numbers. Returns 0 while
these are not enough. Invalid rays wait, too, or not: they miss.
state: see `wrt.kernels.traversal.stream.stream_root.RootLoad`."""
