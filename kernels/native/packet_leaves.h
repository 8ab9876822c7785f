// The rays of a packet against the triangles of a block (wrt.kernels.traversal.packet.leaves).
//
// A triangle test of W rays x one triangle is a function `test(corner, pass, each)`, which calls each(lines) for the triangle
// at `corner` and the rays of a main axis. lines(f, accept) then tests the rays from f on; it calls accept(inside, hit) if some
// line meets the triangle: those where inside[i] is not 0, at hit(i, k), k = f + i. A test of W rays x a triangle for each is
// an object: see `WoopPairs` in woop_packets.h.
#pragma once
#include "packet_culling.h"
#include "triangle.h"

namespace wrt {
namespace {

/// Stores a hit of ray k if it counts: t is that of a meeting with the triangle's own widened box, from `low` to `high` (the
/// consistency rule). normal: of a triangle that is hit only from its front.
template <bool ANY_HIT, bool FRONTS, int P, int W, bool SHARED, class Hit>
inline CUDA_CALLABLE void accept(const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, int k, const float* low,
    const float* high, const double* normal, bool inside, const Hit& hit, int id)
{
    const Interval own = ray_slab(packet, shared, k, low, high, -WRT_INFINITY, WRT_INFINITY);
    const float at = clamped(hit.t, own);
    bool within = inside & (own.enter <= own.leave) & (at >= packet.t_min[k]);
    if (FRONTS) within = within & is_front(normal, packet.inverse_x[k], packet.inverse_y[k], packet.inverse_z[k]);
    const float last = packet.t[k];
    const int found = packet.primitive[k];
    if (ANY_HIT) {  // any hit suffices; u and v are unused
        const bool counts = within & (at <= last);
        packet.t[k] = counts ? -WRT_INFINITY : last;
        packet.primitive[k] = counts ? id : found;
    } else {  // no hit so far is -1, the greatest number without a sign
        const bool counts = within & ((at < last) | ((at == last) & ((unsigned)id < (unsigned)found)));
        packet.t[k] = counts ? at : last;
        packet.primitive[k] = counts ? id : found;
        packet.u[k] = counts ? hit.u : packet.u[k];
        packet.v[k] = counts ? hit.v : packet.v[k];
    }
}

/// Tests the triangles `mask` of a block, W rays x one triangle at a time. PASSES: those that the test needs.
template <int PASSES, bool ANY_HIT, bool FRONTS, int P, int W, bool SHARED, class Bounds, class Test>
inline CUDA_CALLABLE void test_triangles(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, const float* block, const int* ids, unsigned mask, Test test)
{
    const SharedOrigin shared = shared_origin(bounds);
    for (; mask; mask &= mask - 1u) {
        const int lane = lowest_bit(mask), id = ids[lane];
        const float* corner = block + lane;
        float low[3], high[3];
        double normal[3];
        vertex_box<W>(corner, low, high);
        if (FRONTS) face_normal<W>(corner, normal);
        WRT_UNROLLED
        for (int pass = 0; pass < PASSES; ++pass) {
            if (PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
            test(corner, pass, [&](const auto& lines) {
                for (int f = 0; f < P; f += W)
                    lines(f, [&](const int* inside, const auto& hit) {
                        WRT_FOR_LANES (i) {
                            accept<ANY_HIT, FRONTS>(
                                packet, shared, f + i, low, high, normal, inside[i] != 0, hit(i, f + i), id);
                        }
                    });
            });
        }
    }
}

/// Pairs of a triangle of `mask` and a ray that meets its box.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int count_active(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, const float* block, unsigned mask)
{
    const SharedOrigin shared = shared_origin(bounds);
    int active = 0;
    for (; mask; mask &= mask - 1u) {
        float low[3], high[3];
        vertex_box<W>(block + lowest_bit(mask), low, high);
        for (int k = 0; k < P; ++k) {
            const Interval own = ray_slab(packet, shared, k, low, high, packet.t_min[k], packet.t[k]);
            active += ((own.enter <= own.leave) & (packet.t[k] > -WRT_INFINITY)) ? 1 : 0;
        }
    }
    return active;
}

#if WRT_VECTORS
/// Constants of wrt.kernels.traversal.packet.leaves.edge_functions.
constexpr float WIDEST = 4.0f, EDGE_ERROR = 16.0f, EDGE_TINY = 1e-36f, LARGEST_HALF = 1e12f;

/// The point through which all lines of a packet pass, within `half`; `holds`: whether there is one.
struct ConvergingLines {
    float point[3], half = 0.0f;
    bool holds;

    template <class Bounds> explicit ConvergingLines(const Bounds& bounds)
    {
        for (int a = 0; a < 3; ++a) {
            const float in = bounds.origin_in.c[a], out = bounds.origin_out.c[a], own = 0.5f * WRT_ABS(in - out);
            point[a] = 0.5f * (in + out);
            half = own > half ? own : half;
        }
        holds = (bounds.passes & (bounds.passes - 1)) == 0 && half <= WIDEST * bounds.slack && half < LARGEST_HALF;
    }
};

/// The areas of W triangles as linear functions of the slopes of rays through one point, and the bounds of their errors.
template <int W> struct EdgeFunctions {
    alignas(4 * W) float edges[9][W];
    alignas(4 * W) float errors[W];

    /// main_axis: the bit of the main axis of all rays.
    EdgeFunctions(const ConvergingLines& lines, int main_axis, const float* block)
    {
        const int z = axis_of(main_axis), x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
        const float from_x = lines.point[x], from_y = lines.point[y], from_z = lines.point[z], half = lines.half;
        const float *first_x = block + x * W, *first_y = block + y * W, *first_z = block + z * W;
        WRT_FOR_LANES (i) {
            const float px = first_x[i], qx = first_x[3 * W + i], rx = first_x[6 * W + i];
            const float py = first_y[i], qy = first_y[3 * W + i], ry = first_y[6 * W + i];
            const float pz = first_z[i], qz = first_z[3 * W + i], rz = first_z[6 * W + i];
            float size = 0.0f;
            // the normal of the plane through the point and an edge, of which v is a vertex
            const auto edge = [&](int n, float ex, float ey, float ez, float vx, float vy, float vz) {
                size = WRT_ABS(ex) > size ? WRT_ABS(ex) : size;
                size = WRT_ABS(ey) > size ? WRT_ABS(ey) : size;
                size = WRT_ABS(ez) > size ? WRT_ABS(ez) : size;
                edges[n][i] = ex * vy - ey * vx;
                edges[n + 1][i] = ey * vz - ez * vy;
                edges[n + 2][i] = ez * vx - ex * vz;
            };
            edge(0, rx - qx, ry - qy, rz - qz, qx - from_x, qy - from_y, qz - from_z);
            edge(3, px - rx, py - ry, pz - rz, rx - from_x, ry - from_y, rz - from_z);
            edge(6, qx - px, qy - py, qz - pz, px - from_x, py - from_y, pz - from_z);
            errors[i] = EDGE_ERROR * half * (size + half) + EDGE_TINY;
        }
    }

    /// Which of W rays may meet the triangle in a lane.
    Ints<W> may_meet(int lane, Floats<W> sx, Floats<W> sy) const
    {
        const auto area = [&](int n) {
            const float e0 = edges[n][lane], e1 = edges[n + 1][lane], e2 = edges[n + 2][lane];
            return sum_of_product(sx, (Floats<W>)e1, sum_of_product(sy, (Floats<W>)e2, (Floats<W>)e0));
        };
        const Floats<W> a = area(0), b = area(3), c = area(6);
        const Floats<W> less = a < b ? a : b, more = a < b ? b : a;
        const Floats<W> min_area = less < c ? less : c, max_area = more > c ? more : c;
        return ~((min_area < -errors[lane]) & (max_area > errors[lane]));
    }
};

/// Writes a word for each ray: a bit for each triangle of the block that it may meet. MIN_LISTED: triangles from which they
/// are told apart; fewer are those of every ray.
template <int MIN_LISTED, int P, int W, bool SHARED, class Bounds, class Test>
inline void list_pairs(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, const float* block, unsigned mask, Test& test, int* pairs)
{
    Ints<W> met[P / W];
    const bool listed = count_bits(mask) >= MIN_LISTED;
    WRT_UNROLLED
    for (int f = 0; f < P; f += W) met[f / W] = listed ? 0 : (int)mask;
    const ConvergingLines lines(bounds);
    if (listed && lines.holds) {
        const EdgeFunctions<W> functions(lines, bounds.passes, block);
        for (unsigned left = mask; left; left &= left - 1u) {
            const int lane = lowest_bit(left);
            WRT_UNROLLED
            for (int f = 0; f < P; f += W) {
                const Floats<W> sx = load<Floats<W>>(packet.slope_x + f), sy = load<Floats<W>>(packet.slope_y + f);
                met[f / W] = met[f / W] | (functions.may_meet(lane, sx, sy) & (1 << lane));
            }
        }
    } else if (listed) {
        for (int pass = 0; pass < Test::PASSES; ++pass) {
            if (Test::PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
            test.begin(pass);
            for (unsigned left = mask; left; left &= left - 1u) {
                const int lane = lowest_bit(left);
                WRT_UNROLLED
                for (int f = 0; f < P; f += W) met[f / W] = met[f / W] | (test.may_meet(block + lane, f) & (1 << lane));
            }
        }
    }
    WRT_UNROLLED
    for (int f = 0; f < P; f += W)
        save(pairs + f, met[f / W] & (load<Floats<W>>(packet.t + f) >= load<Floats<W>>(packet.t_min + f)));
}

/// What the tests of a block read of its W triangles: vertices, and planes of their boxes, less the origin if it is shared.
/// planar: whether near and far planes are the same for all rays; otherwise they are the low and the high ones.
template <int W> struct BlockRows {
    alignas(4 * W) float corners[9][W];
    alignas(4 * W) float planes[6][W];
    bool planar;

    template <bool SHARED, class Bounds>
    inline void load_block(const Bounds& bounds, const SharedOrigin& shared, const float* block)
    {
        planar = SHARED && bounds.mixed_axes == 0;
        WRT_FOR_LANES (i) {
            float low[3], high[3];
            vertex_box<W>(block + i, low, high);
            for (int a = 0; a < 3; ++a) {
                const bool back = bounds.inverse_large.c[a] < 0.0f;
                const float step = back ? -shared.slack : shared.slack;
                const float near = (back ? high[a] : low[a]) - (shared.origin[a] + step);
                const float far = (back ? low[a] : high[a]) - (shared.origin[a] - step);
                planes[a][i] = planar ? near : low[a];
                planes[3 + a][i] = planar ? far : high[a];
                for (int vertex = 0; vertex < 9; vertex += 3) {
                    const float at = block[(vertex + a) * W + i];
                    corners[vertex + a][i] = SHARED ? at - shared.origin[a] : at;
                }
            }
        }
    }

    /// The intervals of the rays from f on in the boxes of the lanes `which`.
    template <int P, bool SHARED>
    inline void slabs(const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, int f, Ints<W> which, Floats<W>& enter,
        Floats<W>& leave) const
    {
        const float* const inverses[3] = {packet.inverse_x, packet.inverse_y, packet.inverse_z};
        const float* const starts[3] = {packet.origin_x, packet.origin_y, packet.origin_z};
        enter = (Floats<W>)(-WRT_INFINITY), leave = (Floats<W>)WRT_INFINITY;
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) {
            const Floats<W> low = chosen<W>(planes[a], which), high = chosen<W>(planes[3 + a], which);
            const Floats<W> inverse = load<Floats<W>>(inverses[a] + f);
            Floats<W> to_near = low, to_far = high;
            if (!planar) {
                Floats<W> from, wide;
                if constexpr (SHARED) from = (Floats<W>)shared.origin[a], wide = (Floats<W>)shared.slack;
                else from = load<Floats<W>>(starts[a] + f), wide = load<Floats<W>>(packet.slack + f);
                const Ints<W> back = inverse < 0.0f;
                const Floats<W> step = back ? -wide : wide;
                to_near = (back ? high : low) - (from + step);
                to_far = (back ? low : high) - (from - step);
            }
            const Floats<W> near = to_near * inverse, far = to_far * inverse;
            enter = near > enter ? near : enter;
            leave = far < leave ? far : leave;
        }
    }
};

/// Removes the lanes of `hit` whose ray comes from behind its triangle.
template <int P, int W, bool SHARED>
inline void drop_backs(const Packet<P, W, SHARED>& packet, const float* block, int f, Ints<W> which, Ints<W>& hit)
{
    for (unsigned left = bits_of(hit); left; left &= left - 1u) {
        const int i = lowest_bit(left), k = f + i;
        double normal[3];
        face_normal<W>(block + which[i], normal);
        if (!is_front(normal, packet.inverse_x[k], packet.inverse_y[k], packet.inverse_z[k])) hit[i] = 0;
    }
}

/// Tests the rays from f on, each with the triangle in its lane of `which`, where `paired` is not 0. Of any-hit queries, rays
/// with a hit lose what is `left` to be tested.
template <bool ANY_HIT, bool FRONTS, int P, int W, bool SHARED, class Bounds, class Test>
inline void test_pair(const Packet<P, W, SHARED>& packet, const Bounds& bounds, const SharedOrigin& shared,
    const BlockRows<W>& rows, const float* block, const int* ids, int f, Ints<W> which, Ints<W> paired, Ints<W>& left,
    Test& test)
{
    constexpr int SIGN = (int)0x80000000;
    for (int pass = 0; pass < Test::PASSES; ++pass) {
        if (Test::PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
        test.begin(pass);
        Ints<W> inside;
        TriangleHit<Floats<W>> found;
        if (!test.test(rows.corners, which, paired, f, inside, found)) continue;
        Floats<W> enter, leave, at = found.t;
        rows.slabs(packet, shared, f, which, enter, leave);
        at = at > enter ? at : enter;
        at = (at < leave ? at : leave) + 0.0f;  // as `clamped`
        const Floats<W> last = load<Floats<W>>(packet.t + f);
        Ints<W> hit = inside & (enter <= leave) & (at >= load<Floats<W>>(packet.t_min + f));
        const Ints<W> number = (Ints<W>)chosen<W>(ids, which), before = load<Ints<W>>(packet.primitive + f);
        if (ANY_HIT) {  // any hit suffices; u and v are unused
            hit = hit & (at <= last);
            if (FRONTS) drop_backs(packet, block, f, which, hit);
            replace<W>(packet.t + f, hit, (Floats<W>)(-WRT_INFINITY));
            left = hit ? 0 : left;
        } else {  // no hit so far is -1, the greatest number without a sign
            hit = hit & ((at < last) | ((at == last) & ((number ^ SIGN) < (before ^ SIGN))));
            if (FRONTS) drop_backs(packet, block, f, which, hit);
            replace<W>(packet.t + f, hit, at);
            replace<W>(packet.u + f, hit, found.u);
            replace<W>(packet.v + f, hit, found.v);
        }
        replace<W>(packet.primitive + f, hit, number);
    }
}

/// Tests the triangles `mask` of a block, each ray against those that it may meet.
template <bool ANY_HIT, bool FRONTS, int MIN_LISTED, int P, int W, bool SHARED, class Bounds, class Test>
inline void test_pairs(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, const float* block, const int* ids, unsigned mask, Test test)
{
    const SharedOrigin shared = shared_origin(bounds);
    alignas(4 * W) int pairs[P];
    list_pairs<MIN_LISTED>(packet, bounds, block, mask, test, pairs);
    BlockRows<W> rows;
    rows.template load_block<SHARED>(bounds, shared, block);
    for (int f = 0; f < P; f += W)
        for (Ints<W> left = load<Ints<W>>(pairs + f); bits_of(left);) {
            const Ints<W> lowest = left & -left, paired = left != 0;
            const Ints<W> exponent = ((Ints<W>)__builtin_convertvector(lowest, Floats<W>) >> 23) - 127;  // of a power of 2
            left = left ^ lowest;
            test_pair<ANY_HIT, FRONTS>(packet, bounds, shared, rows, block, ids, f, exponent & (W - 1), paired, left, test);
        }
}
#endif

}  // namespace
}  // namespace wrt
