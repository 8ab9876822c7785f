// Streams of a wide BVH, loaded with the list of its root, and the boxes around short rays
// (wrt.kernels.traversal.stream.stream_load).
#pragma once
#include "stream.h"
#include "stream_load.h"

namespace wrt {
namespace {

/// The test of rays in lanes against the boxes of the root's W children, one child after the other.
///
/// lanes: memory for (W + 1) L floats. last: for each child, the greatest t, or the greatest -t, at which the rays of a lane
/// enter it; any: bits of the children that they meet. list: words of the rays of the stream, of which there are `size`.
template <int W, Order ORDER, int L> struct RootTest {
    float* last;
    int* any;
    const float* bounds;
    unsigned used;
    int *words_of_rays, size;
    int met[L];

    CUDA_CALLABLE RootTest(float* lanes, const float* bounds_of, unsigned used_of, int* list_of, int size_of)
        : last(lanes)
        , any((int*)(lanes + W * L))
        , bounds(bounds_of)
        , used(used_of)
        , words_of_rays(list_of)
        , size(size_of)
    {
    }

    /// Before the first rays of a stream: the bits of the root's children.
    static CUDA_CALLABLE unsigned begin(const int* children, int empty, float* lanes)
    {
        unsigned used = 0;
        for (int c = 0; c < W; ++c) used |= children[c] != empty ? 1u << c : 0u;
        if (ORDER != Order::NONE) {
            WRT_FOR (W* L, k) {
                lanes[k] = -WRT_INFINITY;
            }
        }
        int* const any_of = (int*)(lanes + W * L);
        WRT_FOR (L, k) {
            any_of[k] = 0;
        }
        return used;
    }

    template <int> CUDA_CALLABLE void filter(const float (*words)[L], int* stored)
    {
        WRT_FOR (L, k) {
            met[k] = 0;
        }
        for (unsigned left = used; left; left &= left - 1u) {
            const int c = lowest_bit(left);
            const float low[3] = {bounds[c], bounds[W + c], bounds[2 * W + c]};
            const float high[3] = {bounds[3 * W + c], bounds[4 * W + c], bounds[5 * W + c]};
            WRT_FOR (L, k) {
                const Interval own = meet_box(low, high, box_ray<L>(words, k), words[RayRows::T_MIN][k], words[RayRows::T][k]);
                met[k] |= own.enter <= own.leave ? 1 << c : 0;
                if (ORDER != Order::NONE) {
                    const bool meets = (own.enter <= own.leave) & (stored[k] != 0);
                    const float entry = meets ? (ORDER == Order::NEAR ? -own.enter : own.enter) : -WRT_INFINITY;
                    last[c * L + k] = entry > last[c * L + k] ? entry : last[c * L + k];
                }
            }
        }
        WRT_FOR (L, k) {
            met[k] &= stored[k];
            any[k] |= met[k];
            stored[k] = met[k];
        }
    }

    CUDA_CALLABLE void list(unsigned kept)
    {
        int word[L];
        WRT_FOR (L, k) {
            word[k] = (int)((unsigned)met[k] << RAY_BITS);
        }
        int* const listed = words_of_rays + size;
        append<L>(listed, word, kept);
        WRT_FOR (L, k) {
            listed[k] |= size + k;
        }
    }

    /// After the last rays of a stream: writes the keys of the root's children; returns the bits of the leaves that a ray
    /// meets.
    static CUDA_CALLABLE unsigned end(const int* children, const float* lanes, int* keys)
    {
        const int* const any_of = (const int*)(lanes + W * L);
        unsigned reached = 0, leaves = 0;
        for (int k = 0; k < L; ++k) reached |= (unsigned)any_of[k];
        for (int c = 0; c < W; ++c) leaves |= children[c] < 0 ? 1u << c : 0u;
        float greatest[W];  // of each child
        if (ORDER != Order::NONE) row_maxima<W>((const float (*)[L])lanes, greatest);
        for (int c = 0; c < W; ++c) {
            const int entry
                = ORDER == Order::NONE ? 0 : __builtin_bit_cast(int, ORDER == Order::NEAR ? -greatest[c] : greatest[c]);
            const int key = ((ORDER == Order::FAR ? 0x7f7fffff - entry : entry) & -W) | c;
            keys[c] = (reached & ~leaves) >> c & 1u ? key : NO_CHILD;
        }
        return reached & leaves;
    }
};

/// The boxes around rays from origin to end, compared with those of the root's children in cells of a grid. On CUDA they are
/// not compared.
///
/// waiting: ROWS numbers of each of ROOM rays that wait. grid: cells per unit of length; what is added to x, y and z in cells;
/// the largest coordinate of a box around a ray for which MARGIN suffices; the scene's centre, from which coordinates count, as
/// floats. planes: six of each child, in cells, once for each lane.
template <int W, int L> struct RootGrid {
    static constexpr int ROWS = 9, ROOM = 2 * L, GRID = 8, FLOATS = ROWS * ROOM + GRID + 3 * W * L;

    /// Rays of a group whose box meets a child, so that the next boxes will not pay; groups for which they are left out.
    static constexpr int MANY = 12, PAUSE = 15;

    /// Cells by which the boxes of children are widened: 1.1 for the rounding of both boxes to cells, the rest for ERROR: that
    /// of the box around a ray, as a fraction of the sum of the largest coordinates of ray and scene.
    static constexpr int MARGIN = 2;
    static constexpr float ERROR = 3.814697265625e-06f;

    /// Cells along the longest side of the scene's box.
    static constexpr float CELLS = 65000.0f;

    /// 1.5 * 2^23: the bits of a float near it, less those of it, are the nearest whole number.
    static constexpr float WHOLE = 12582912.0f;
    static constexpr unsigned WHOLE_BITS = 0x4b400000u;

    float *waiting, *grid, *planes;

    explicit CUDA_CALLABLE RootGrid(float* lanes)
        : waiting(lanes + (W + 1) * L)
        , grid(waiting + ROWS * ROOM)
        , planes(grid + GRID)
    {
    }

#if WRT_VECTORS
    using Spans = Vector<float, L>;
    using Cells = Vector<short, L>;

    /// The cells of L coordinates, whole numbers.
    static Vector<int, L> cells_of(Spans x, float scale, float offset)
    {
        const Spans cell = x * scale + offset;
        return __builtin_bit_cast(Vector<int, L>, __builtin_bit_cast(Vector<unsigned, L>, cell) - WHOLE_BITS);
    }

    /// The nearest numbers of 16 bits.
    static Cells narrow(Vector<int, L> cell)
    {
        cell = __builtin_elementwise_max(cell, (Vector<int, L>)-32768);
        return __builtin_convertvector(__builtin_elementwise_min(cell, (Vector<int, L>)32767), Cells);
    }

    static unsigned flags(Vector<int, L> set)
    {
        const auto all = __builtin_convertvector(set, Vector<bool, L>);
        unsigned short own;
        __builtin_memcpy(&own, &all, sizeof(own));
        return own;
    }
#endif

    /// Writes the grid, and the planes of the root's children in cells. used: bits of these.
    template <class Vec, class Center>
    CUDA_CALLABLE void begin(const float* bounds, unsigned used, const Vec& low, const Vec& high, const Center& center)
    {
#if WRT_VECTORS
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
                const float at = used >> c & 1u ? (float)(bounds[plane * W + c] + rest[plane % 3]) : 0.0f;
                const int margin = plane < 3 ? -MARGIN : MARGIN;
                const Cells cell = narrow(cells_of((Spans)at, scale, grid[1 + plane % 3]) + margin);
                save(planes + (6 * c + plane) * (L / 2), cell);
            }
        }
#else
        (void)bounds, (void)used, (void)low, (void)high, (void)center;
#endif
    }

#if WRT_VECTORS
    /// Bits of the rays whose box meets a child, or ends so far away that this cannot be told. used: bits of the children.
    unsigned meet(const float* const* lanes_of, const float* t, unsigned used) const
    {
        const Spans far_t = load<Spans>(t);
        Spans lower = (Spans)WRT_INFINITY, upper = -lower;
        Cells from[3], to[3];
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) {
            Spans origin = load<Spans>(lanes_of[a]);
            const Spans along = load<Spans>(lanes_of[3 + a]);
            origin -= grid[5 + a];
            const Spans end = origin + far_t * along;
            const Spans low_end = origin < end ? origin : end, high_end = origin > end ? origin : end;
            lower = low_end < lower ? low_end : lower;
            upper = high_end > upper ? high_end : upper;
            from[a] = narrow(cells_of(low_end, grid[0], grid[1 + a]));
            to[a] = narrow(cells_of(high_end, grid[0], grid[1 + a]));
        }
        Cells apart = (Cells)-1;
        for (unsigned left = used; left; left &= left - 1u) {
            Cells plane[6], own = (Cells)0;
            __builtin_memcpy(plane, planes + lowest_bit(left) * 3 * L, sizeof(plane));
            WRT_UNROLLED
            for (int a = 0; a < 3; ++a)
                own |= __builtin_elementwise_sub_sat(to[a], plane[a]) | __builtin_elementwise_sub_sat(plane[3 + a], from[a]);
            apart &= own;
        }
        const auto meeting = __builtin_convertvector(apart >= (Cells)0, Vector<bool, L>);
        unsigned short bits_met;
        __builtin_memcpy(&bits_met, &meeting, sizeof(bits_met));
        return bits_met | flags(!((lower >= (Spans)-grid[4]) & (upper <= (Spans)grid[4])));
    }
#endif

    /// Compares the `rays.here` rays in lanes, as the caller gives them, and lets them wait; then the lanes hold rays that have
    /// waited, and `number` their numbers. Returns false while these are not enough. count: rays that were loaded; 0 for the
    /// last. Invalid rays wait, too, or not: they miss. state: see `RootLoad` in wrt.kernels.traversal.stream.stream_load.
    template <class State> CUDA_CALLABLE bool exchange(RayLanes<L>& rays, int* number, int count, State& state)
    {
        float* const lanes_of[ROWS] = {rays.given_origin[0], rays.given_origin[1], rays.given_origin[2],
            rays.given_direction[0], rays.given_direction[1], rays.given_direction[2], (float*)number, rays.t_min, rays.t};
        if (count > 0 && state.unboxed > 0) {
            --state.unboxed;
            return true;
        }
        if (count > 0) {
            unsigned reach = (1u << rays.here) - 1u;
#if WRT_VECTORS
            const unsigned met = meet(lanes_of, rays.t, state.used);
            if (count_bits(met) > MANY) state.unboxed = PAUSE;
            reach &= met;
#endif
            int* const to_row = (int*)waiting + state.waiting;
            WRT_UNROLLED
            for (int row = 0; row < ROWS; ++row) append<L>(to_row + row * ROOM, (const int*)lanes_of[row], reach);
            state.waiting += count_bits(reach);
            if (state.waiting < L) return false;
        }
        rays.here = state.waiting < L ? state.waiting : L;
        state.waiting -= rays.here;
        WRT_UNROLLED
        for (int row = 0; row < ROWS; ++row) {
            float* const from = waiting + row * ROOM;
            WRT_FOR (L, k) {
                lanes_of[row][k] = from[k];
            }
            WRT_FOR (L, k) {
                from[k] = from[L + k];
            }
        }
        return true;
    }
};

/// Loads the next rays, and stores and lists those that meet a child of the root; returns their bits. BOXES: whether short rays
/// are first tested by the boxes around them.
template <class Test, int W, Order ORDER, bool BOXES, int L, class Batch, class Vec, class Ray, class State>
inline CUDA_CALLABLE unsigned load_root(const Batch& batch, int first, int count, const Vec& low, const Vec& high, Ray* stream,
    const float* bounds, int* list, float* lanes, float* own, State& state)
{
    const int place = state.loaded, size = state.kept;
    RayLanes<L> rays;
    RootTest<W, ORDER, L> root(lanes, bounds, state.used, list, size);
    rays.here = count < L ? count : L;
    if constexpr (BOXES) {
        int number[L];
        if (count > 0) load_lanes<false>(batch, first, rays);
        WRT_FOR (L, k) {
            number[k] = place + k;
        }
        if (!RootGrid<W, L>(lanes).exchange(rays, number, count, state)) return 0;
        center_lanes(batch, rays);
        check_lanes(rays);
        return store_rays<Test>(rays, low, high, stream + size, own, root, [&](int k) { return number[k]; });
    } else {
        if (count == 0) return 0;
        load_lanes<true>(batch, first, rays);
        check_lanes(rays);
        return store_rays<Test>(rays, low, high, stream + size, own, root, [&](int k) { return place + k; });
    }
}

}  // namespace
}  // namespace wrt
