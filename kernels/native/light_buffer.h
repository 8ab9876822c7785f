// Shadow rays to a point light through a buffer of lists of triangles (wrt.kernels.traversal.shadows.light_buffer_lanes).
#pragma once
#include "ray.h"
#include "triangle.h"

namespace wrt {
namespace {

/// Answers of rays, and of those that are not yet answered.
enum LightAnswer { LIT, OCCLUDED, UNDECIDED, WAITING };

/// Ints of a cell; relative error of depths in float32.
constexpr int CELL_WORDS = 4;
constexpr float DEPTH_SLACK = 0x1p-20f;

/// At most RUN rays that are answered together, L at a time. max_depth, sure, min_depth: depths of their hits; place, last: of
/// the entries of their cells that are still to be tested; ignored: a triangle of each, or -1; rest: the rays that wait,
/// `waiting` of them; slot: where `words` has what tests read of a ray. RECORD: floats of a triangle.
template <class Test, int RUN, int RECORD> struct LightRays {
    static constexpr int L = 16, WORDS = 23, STRIDE = WORDS + 1;
    alignas(64) float max_depth[RUN];
    alignas(64) float sure[RUN];
    alignas(64) float min_depth[RUN];
    alignas(64) int cell[RUN];
    alignas(64) int state[RUN];
    alignas(64) int rest[RUN + 1];
    alignas(64) int place[RUN];
    alignas(64) int last[RUN];
    alignas(64) int ignored[RUN];
    alignas(64) int waits[RUN];
    alignas(64) float words[RUN * STRIDE];
    int slot[RUN], waiting = 0;

    /// Loads L rays to the light at `target`, number(k) of the item each, as `light_ray` does.
    template <class Batch, class Vec3d, class Number>
    inline CUDA_CALLABLE void load(
        const Batch& batch, const Vec3d& target, int begin, RayLanes<L>& rays, const Number& number) const
    {
        const double light_x = target.c[0], light_y = target.c[1], light_z = target.c[2];
        WRT_SCALAR
        for (int k = 0; k < L; ++k) {
            const size_t n = begin + number(k);
            const auto& o = batch.origins.data[n * batch.origin_stride];
            rays.given_origin[0][k] = o.c[0], rays.given_origin[1][k] = o.c[1], rays.given_origin[2][k] = o.c[2];
            rays.t_min[k] = batch.t_min.data[n * batch.t_min_stride];
            rays.t[k] = batch.t_max.data[n * batch.t_max_stride];
        }
        center_lanes(batch, rays);
        WRT_FOR (L, k) {
            float x = (float)(light_x - (double)rays.given_origin[0][k]);
            float y = (float)(light_y - (double)rays.given_origin[1][k]);
            float z = (float)(light_z - (double)rays.given_origin[2][k]);
            drop_negligible(x, y, z);
            rays.direction[0][k] = x, rays.direction[1][k] = y, rays.direction[2][k] = z;
        }
    }

    /// Finds the cells of rays from + 0 .. from + L - 1, as `find_cell`, and the depths of their hits.
    template <class Cells> inline CUDA_CALLABLE void find_cells(const Cells& cells, const RayLanes<L>& rays, int from)
    {
        const int resolution = cells.resolution;
        const float half_resolution = 0.5f * (float)resolution, slack = cells.slack, limit = cells.limit;
        WRT_FOR (L, k) {
            const float x = rays.direction[0][k], y = rays.direction[1][k], z = rays.direction[2][k], t = rays.t[k];
            const float px = rays.origin[0][k], py = rays.origin[1][k], pz = rays.origin[2][k];
            const bool valid = is_ray(x, y, z, px, py, pz, rays.t_min[k], t);
            const float far = reach(cells.low, cells.high, px, py, pz);
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
            const bool main_x = xy & xz, main_y = !xy & yz;
            const float depth = main_x ? size_x : main_y ? size_y : size_z, ahead = main_x ? x : main_y ? y : z;
            const float u = -(main_x ? y : main_y ? z : x) / depth, v = -(main_x ? z : main_y ? x : y) / depth;
            int i = (int)((u + 1.0f) * half_resolution), j = (int)((v + 1.0f) * half_resolution);
            i = i < resolution - 1 ? i : resolution - 1;
            j = j < resolution - 1 ? j : resolution - 1;
            const int face = (main_x ? 0 : main_y ? 2 : 4) + (ahead > 0.0f ? 1 : 0);
            const float start = (1.0f - rays.t_min[k]) * depth, end = (1.0f - t) * depth;
            const int own = (face * resolution + j) * resolution + i;
            cell[from + k] = valid ? own : 0;
            max_depth[from + k] = start * (1.0f + DEPTH_SLACK) + slack;
            sure[from + k] = start * (1.0f - DEPTH_SLACK) - slack;
            min_depth[from + k] = t == 1.0f ? 0.0f : end * (1.0f + DEPTH_SLACK) + slack;
            const bool decided = (far <= limit) & (t <= 1.0f);
            state[from + k] = valid ? (decided ? WAITING : UNDECIDED) : LIT;
        }
    }

    /// Finds the lists of the rays that wait, without branches: which do is hard to predict. skipped: a triangle that each ray
    /// ignores, or -1.
    template <class Cells>
    inline CUDA_CALLABLE void find_lists(const Cells& cells, const int* skipped, int skip_stride, int begin, int count)
    {
        for (int from = 0; from < count; from += L) {
            const int* word = cells.cells.data;
            WRT_FOR (L, i) {
                const int k = from + i, at = CELL_WORDS * (from + i < count ? cell[k] : 0);
                const float far = __builtin_bit_cast(float, word[at + 2]), nearest = __builtin_bit_cast(float, word[at + 3]);
                const int first = word[at], entries = word[at + 1], before = state[k];
                const int skip = skipped[(begin + (from + i < count ? k : 0)) * skip_stride];
                const bool behind = far <= max_depth[k], open = behind & !(min_depth[k] <= nearest);
                const bool hidden = (far <= sure[k]) & (skip < 0);
                const int found = (open | (behind & (skip >= 0) & !hidden)) ? UNDECIDED : hidden ? OCCLUDED : LIT;
                state[k] = before == WAITING ? found : before;
                waits[k] = ((before == WAITING) & !open & !hidden & (nearest <= max_depth[k])) ? 1 : 0;
                place[k] = first, last[k] = first + entries, ignored[k] = skip;
            }
        }
        for (int k = 0; k < count; ++k) {
            rest[waiting] = k;
            slot[k] = waiting;
            waiting += waits[k];
        }
        for (int n = 0; n < waiting; ++n) WRT_FETCH(cells.entries.data + place[rest[n]]);
    }

    /// Writes what box and triangle tests read of L rays from number `from` on of those that wait.
    template <class Cells> inline CUDA_CALLABLE void prepare(const Cells& cells, const RayLanes<L>& rays, int from, int here)
    {
        alignas(64) float own[WORDS][L];
        write_rows<L>(rays, cells.low, cells.high, own);
        Test::template prepare<L>(
            own, rays.direction[0], rays.direction[1], rays.direction[2], rays.origin[0], rays.origin[1], rays.origin[2]);
        write_records(own[0], words + from * STRIDE, STRIDE, (1u << here) - 1u);
        write_records(own[WORDS - 16], words + from * STRIDE + WORDS - 16, STRIDE, (1u << here) - 1u);
    }

    /// Tests L pairs of a ray and a triangle; rays with a hit are occluded.
    inline CUDA_CALLABLE void test_pairs(const float* records, const int* pair_ray, const int* pair_triangle)
    {
        alignas(64) float own[WORDS][L];
        alignas(64) float corner[16][L];
        alignas(64) float t[L];
        alignas(64) float u[L];
        alignas(64) float v[L];
        int near[L];
        const float *from[L], *line[L];
        WRT_SCALAR
        for (int i = 0; i < L; ++i) {
            from[i] = words + slot[pair_ray[i]] * STRIDE;
            line[i] = records + RECORD * (size_t)pair_triangle[i];
        }
        read_records(line, 0, corner[0]);
        read_records(from, 0, own[0]);
        read_records(from, WORDS - 16, own[WORDS - 16]);
        Test::template test<L>(own, corner, t, u, v);
        WRT_FOR (L, i) {
            float low[3], high[3];
            vertex_box<L>(corner[0] + i, low, high);
            const Interval box = meet_box(low, high, box_ray<L>(own, i), -WRT_INFINITY, WRT_INFINITY);
            const bool meets = t[i] == t[i];
            const float at = clamped(t[i], box);
            near[i] = (meets & (box.enter <= box.leave) & (at >= own[RayRows::T_MIN][i]) & (at <= own[RayRows::T][i])) ? -1 : 0;
        }
        for (unsigned hit = bits<L>(near); hit; hit &= hit - 1u) state[pair_ray[lowest_bit(hit)]] = OCCLUDED;
    }

    /// One round: the next triangles of all rays that wait. Rays that are left with long lists fill the vectors with several
    /// each.
    template <class Cells> inline CUDA_CALLABLE void test_round(const Cells& cells, const float* records)
    {
        int pair_ray[RUN + 2 * L], pair_triangle[RUN + 2 * L], pairs = 0, left = 0;
        const int share = waiting < 2 * L ? 2 * L / waiting : 1;
        for (int turn = 0; turn < share; ++turn) {
            for (int n = 0; n < waiting; ++n) {
                const int k = rest[n], at = place[k], end = last[k];
                const unsigned long long entry = cells.entries.data[at < end ? at : end - 1];
                const int triangle = (int)(unsigned)entry;
                const bool ahead = (at < end) & (__builtin_bit_cast(float, (unsigned)(entry >> 32)) <= max_depth[k]);
                WRT_FETCH(records + RECORD * (size_t)triangle);
                pair_ray[pairs] = k;
                pair_triangle[pairs] = triangle;
                pairs += (ahead & (triangle != ignored[k])) ? 1 : 0;
                place[k] = ahead ? at + 1 : end;
            }
        }
        for (int p = pairs; p < pairs + L; ++p) pair_ray[p] = pair_ray[0], pair_triangle[p] = pair_triangle[0];
        for (int first = 0; first < pairs; first += L) test_pairs(records, pair_ray + first, pair_triangle + first);
        for (int n = 0; n < waiting; ++n) {
            const int k = rest[n];
            rest[left] = k;
            left += ((state[k] != OCCLUDED) & (place[k] < last[k])) ? 1 : 0;
        }
        waiting = left;
    }

    /// Writes the answers of rays begin .. begin + count - 1 of a batch; returns whether some are UNDECIDED. Rays beyond the
    /// last of L are the first again, and their results are dropped.
    template <class Cells, class Batch, class Vec3d>
    inline CUDA_CALLABLE bool answer(const Cells& cells, const float* records, const Batch& batch, const Vec3d& target,
        const int* skipped, int skip_stride, int begin, int count, unsigned char* answers)
    {
        RayLanes<L> rays;
        for (int from = 0; from < count; from += L) {
            const int here = count - from < L ? count - from : L;
            load(batch, target, begin, rays, [&](int k) { return from + (k < here ? k : 0); });
            find_cells(cells, rays, from);
            for (int k = 0; k < here; ++k) WRT_FETCH(cells.cells.data + CELL_WORDS * (size_t)cell[from + k]);
        }
        find_lists(cells, skipped, skip_stride, begin, count);
        for (int from = 0; from < waiting; from += L) {
            const int here = waiting - from < L ? waiting - from : L;
            load(batch, target, begin, rays, [&](int k) { return rest[from + (k < here ? k : 0)]; });
            prepare(cells, rays, from, here);
        }
        while (waiting) test_round(cells, records);
        bool open = false;
        for (int k = 0; k < count; ++k) {
            answers[begin + k] = (unsigned char)state[k];
            open |= state[k] == UNDECIDED;
        }
        return open;
    }
};

}  // namespace
}  // namespace wrt
