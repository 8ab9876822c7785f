// Shadow rays from points to groups of samples of an area light, a frustum for each
// (wrt.kernels.traversal.shadows.multi_frusta).
#pragma once
#include "packet_leaves.h"
#include "packet_load.h"

namespace wrt {
namespace {

/// Fraction of a direction's size below which a component may be flushed to 0, with room for rounding; the steepest slope.
constexpr float FLUSHED = 0x1p-90f, STEEPEST = 1e6f;

/// The pattern of samples that a point uses (`pattern_of` of wrt.kernels.layout.light_samples).
inline CUDA_CALLABLE int pattern_of(unsigned point, unsigned patterns)
{
    unsigned h = point * 0x9E3779B1u;
    h = (h ^ (h >> 16)) * 0x85EBCA6Bu;
    return (int)((h ^ (h >> 13)) % patterns);
}

/// The rays from a point to a group of samples: bounds as in a packet, the box around them where directions have both signs,
/// and the intervals of the directions.
struct LightFrustum {
    struct Vec3 {
        float c[3];
    };
    int active, mixed_axes, passes;
    float t_min, t_max, slack;
    Vec3 inverse_large, inverse_small, forward_small, backward_small;
    Vec3 origin_in, origin_out, origin_low, origin_high;
    float box_low[3], box_high[3], direction_low[3], direction_high[3];
    int point, group;

    /// The bounds along an axis. o: the point; range_end: the end of the rays' range.
    inline CUDA_CALLABLE void bound_axis(int a, float o, float flushed, float range_end)
    {
        const float d0 = direction_low[a], d1 = direction_high[a];
        const bool forward = d0 > flushed, backward = d1 < -flushed, mixed = !forward & !backward;
        mixed_axes += mixed ? 1 : 0;
        inverse_large.c[a] = mixed ? WRT_NAN : backward ? 1.0f / d1 : 1.0f / d0;
        inverse_small.c[a] = mixed ? WRT_NAN : backward ? 1.0f / d0 : 1.0f / d1;
        forward_small.c[a] = (mixed & (d1 > 0.0f)) ? 1.0f / d1 : 0.0f;
        backward_small.c[a] = (mixed & (d0 < 0.0f)) ? 1.0f / d0 : 0.0f;
        origin_in.c[a] = backward ? o - slack : o + slack;
        origin_out.c[a] = backward ? o + slack : o - slack;
        origin_low.c[a] = origin_high.c[a] = o;
        // from the point to the ends of its rays, widened as boxes are, and by rounding
        const float to0 = (d0 < 0.0f ? d0 : 0.0f) * range_end, to1 = (d1 > 0.0f ? d1 : 0.0f) * range_end;
        const float wide = 2.0f * slack + SLACK * ((to1 - to0) + WRT_ABS(o));
        box_low[a] = mixed ? (o + to0) - wide : -WRT_INFINITY;
        box_high[a] = mixed ? (o + to1) + wide : WRT_INFINITY;
    }

    /// Sets the frustum `number` of P rays, without a ray; returns whether it is valid. low, high: the scene.
    template <int P, class Batch, class Light, class Scene>
    inline CUDA_CALLABLE bool set(const Batch& rays, const Light& light, int number, const Scene& low, const Scene& high)
    {
        point = number / light.groups;
        group = number - point * light.groups;
        const float* p = rays.origins.data[(size_t)point * rays.origin_stride].c;
        float o[3];
        for (int a = 0; a < 3; ++a) o[a] = (float)((double)p[a] - rays.center.c[a]);
        const float range_begin = rays.t_min.data[(size_t)point * rays.t_min_stride];
        const float given = rays.t_max.data[(size_t)point * rays.t_max_stride], range_end = given > FARTHEST ? FARTHEST : given;
        const int pattern = pattern_of((unsigned)point, (unsigned)light.patterns);
        const float* box = light.bounds.data + 6 * ((size_t)pattern * light.groups + group);
        float far = 0.0f, size = 0.0f;
        bool valid = (range_begin >= 0.0f) & (range_begin <= range_end);
        for (int a = 0; a < 3; ++a) {
            const float down = WRT_ABS(low.c[a] - o[a]), up = WRT_ABS(high.c[a] - o[a]);
            far = down > far ? down : far;
            far = up > far ? up : far;
            const float d0 = box[a] - p[a], d1 = box[3 + a] - p[a];
            direction_low[a] = d0;
            direction_high[a] = d1;
            size = WRT_ABS(d0) > size ? WRT_ABS(d0) : size;
            size = WRT_ABS(d1) > size ? WRT_ABS(d1) : size;
            valid = valid & (o[a] - o[a] == 0.0f) & (d0 - d0 == 0.0f) & (d1 - d1 == 0.0f);
        }
        valid = valid & (size >= SHORTEST);
        slack = SLACK * far;
        active = P, passes = 0;
        t_min = range_begin, t_max = valid ? range_end : -WRT_INFINITY;
        mixed_axes = 0;
        for (int a = 0; a < 3; ++a) bound_axis(a, o[a], size * FLUSHED + 1e-37f, range_end);
        return valid;
    }
};

/// Planes through the corner rays of a frustum around its main axis: slopes against it, from the ends of the intervals.
struct CornerPlanes {
    int main = -1, axes[2];
    float sign, low[2], high[2], steep[2];

    explicit CUDA_CALLABLE CornerPlanes(const LightFrustum& bounds)
    {
        float best = 0.0f;
        for (int a = 0; a < 3; ++a) {
            const float d0 = bounds.direction_low[a], d1 = bounds.direction_high[a];
            const float shortest = d0 > 0.0f ? d0 : d1 < 0.0f ? -d1 : 0.0f;
            if (shortest > best) best = shortest, main = a;
        }
        if (main < 0) return;
        axes[0] = main == 2 ? 0 : main + 1, axes[1] = axes[0] == 2 ? 0 : axes[0] + 1;
        sign = bounds.direction_low[main] > 0.0f ? 1.0f : -1.0f;
        const float m0 = WRT_ABS(bounds.direction_low[main]), m1 = WRT_ABS(bounds.direction_high[main]);
        const float shorter = m0 < m1 ? m0 : m1, longer = m0 < m1 ? m1 : m0;
        for (int a = 0; a < 2; ++a) {
            const float d0 = bounds.direction_low[axes[a]], d1 = bounds.direction_high[axes[a]];
            low[a] = d0 / (d0 < 0.0f ? shorter : longer);
            high[a] = d1 / (d1 < 0.0f ? longer : shorter);
            steep[a] = 1.0f + (WRT_ABS(low[a]) > WRT_ABS(high[a]) ? WRT_ABS(low[a]) : WRT_ABS(high[a]));
        }
        const bool flat = (low[0] > -STEEPEST) & (high[0] < STEEPEST) & (low[1] > -STEEPEST) & (high[1] < STEEPEST);
        if (!flat) main = -1;
    }
};

/// Triangles of a block of which no plane has all vertices outside. The watertight test is exact for vertices moved by 5.5 u R
/// at most (wrt.kernels.triangle.watertight.woop_areas), a third of a slack along each axis. So the lines of no ray meet a
/// triangle whose vertices are beyond a plane by more than 4 slacks, rounding of slopes and products included.
template <int W> inline CUDA_CALLABLE unsigned light_corner_mask(const LightFrustum& bounds, const float* block, unsigned kept)
{
    const CornerPlanes planes(bounds);
    if (planes.main < 0) return kept;
    const int main = planes.main, next = planes.axes[0], other = planes.axes[1];
    const float o_m = bounds.origin_low.c[main], o_u = bounds.origin_low.c[next], o_v = bounds.origin_low.c[other];
    const float u0 = planes.low[0], u1 = planes.high[0], v0 = planes.low[1], v1 = planes.high[1], cap = 4.0f * bounds.slack;
    int stays[W];
    WRT_FOR_LANES (i) {
        float beyond_u0 = -WRT_INFINITY, beyond_u1 = WRT_INFINITY, front = -WRT_INFINITY;
        float beyond_v0 = -WRT_INFINITY, beyond_v1 = WRT_INFINITY;
        for (int k = 0; k < 3; ++k) {
            const float m = planes.sign * (block[(3 * k + main) * W + i] - o_m);
            const float u = block[(3 * k + next) * W + i] - o_u, v = block[(3 * k + other) * W + i] - o_v;
            const float a = u - u0 * m, b = u - u1 * m, c = v - v0 * m, d = v - v1 * m;
            beyond_u0 = a > beyond_u0 ? a : beyond_u0;
            beyond_u1 = b < beyond_u1 ? b : beyond_u1;
            beyond_v0 = c > beyond_v0 ? c : beyond_v0;
            beyond_v1 = d < beyond_v1 ? d : beyond_v1;
            front = m > front ? m : front;
        }
        const bool outside = (beyond_u0 < -cap * planes.steep[0]) | (beyond_u1 > cap * planes.steep[0])
            | (beyond_v0 < -cap * planes.steep[1]) | (beyond_v1 > cap * planes.steep[1]) | (front < -cap);
        stays[i] = outside ? 0 : -1;
    }
    return bits<W>(stays) & kept;
}

/// Frusta that walk a tree together. COMPONENTS: of a packet of P rays; RECORD: floats of a triangle; LEVELS: of the tree;
/// CORNERS: whether triangles are culled by corner rays.
template <int FRUSTA, int P, int W, int COMPONENTS, int RECORD, int LEVELS, bool CORNERS> struct MultiFrusta {
    using Rays = Packet<P, W, true>;
    struct Waiting {
        int node;
        unsigned mask;
        int order;
    };
    LightFrustum frusta[FRUSTA];
    alignas(64) float rows_of[FRUSTA][COMPONENTS * P];
    Waiting stack[LEVELS * (W - 1) + 1];
    unsigned alive = 0, made = 0;
    int waiting = 0;

    inline CUDA_CALLABLE Rays rays_of(int f) { return Rays(rows_of[f]); }

    /// Makes the rays of a frustum. prepare: see `set_tested`.
    template <class Batch, class Light, class Prepare>
    inline CUDA_CALLABLE void make_rays(int f, const Batch& rays, const Light& light, const Prepare& prepare)
    {
        LightFrustum& own = frusta[f];
        const Rays packet = rays_of(f);
        const float* p = rays.origins.data[(size_t)own.point * rays.origin_stride].c;
        const int pattern = pattern_of((unsigned)own.point, (unsigned)light.patterns);
        const float* sample = light.positions.data + (size_t)pattern * (light.groups * 3 * P) + own.group * 3 * P;
        const int rest = light.samples - own.group * P, here = rest < P ? rest : P;
        const float ox = own.origin_low.c[0], oy = own.origin_low.c[1], oz = own.origin_low.c[2];
        const float px = p[0], py = p[1], pz = p[2], range_end = own.t_max, range_begin = own.t_min;
        int main_axes = 0;
        float to_x[P], to_y[P], to_z[P];
        WRT_FOR (P, k) {
            float x = sample[k] - px, y = sample[P + k] - py, z = sample[2 * P + k] - pz;
            drop_negligible(x, y, z);
            to_x[k] = x, to_y[k] = y, to_z[k] = z;
        }
        WRT_FOR (P, k) {
            const float x = to_x[k], y = to_y[k], z = to_z[k];
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            float size = size_x > size_y ? size_x : size_y;
            size = size > size_z ? size : size_z;
            const bool valid = (size >= SHORTEST) & (size < WRT_INFINITY) & (k < here);
            packet.t_min[k] = range_begin;
            packet.t[k] = valid ? range_end : -WRT_INFINITY;
            main_axes |= set_tested(packet, k, x, y, z, ox, oy, oz, own.origin_low, own.origin_low, prepare);
        }
        own.passes = main_axes;
    }

    /// Whether a ray of a frustum meets the box in a lane of a node. A comparison with NaN is false: an axis along which the
    /// ray stands still within the box counts as met.
    inline CUDA_CALLABLE bool meets_box(int f, const float* box)
    {
        const LightFrustum& own = frusta[f];
        const Rays packet = rays_of(f);
        float low[3], high[3];
        for (int a = 0; a < 3; ++a) {
            low[a] = (box[a * W] - own.slack) - own.origin_low.c[a];
            high[a] = (box[(3 + a) * W] + own.slack) - own.origin_low.c[a];
        }
        int any = 0;
        WRT_FOR (P, k) {
            const float inverse[3] = {packet.inverse_x[k], packet.inverse_y[k], packet.inverse_z[k]};
            Interval range = {packet.t_min[k], packet.t[k]};
            WRT_UNROLLED
            for (int a = 0; a < 3; ++a) {
                const float p = low[a] * inverse[a], q = high[a] * inverse[a];
                const float near = inverse[a] < 0.0f ? q : p, far = inverse[a] < 0.0f ? p : q;
                range.enter = near > range.enter ? near : range.enter;
                range.leave = far < range.leave ? far : range.leave;
            }
            any |= range.enter > range.leave ? 0 : 1;
        }
        return any != 0;
    }

    /// The keys of the children of a node that a frustum meets.
    inline CUDA_CALLABLE void find_children(const LightFrustum& own, const float* box, int* key) const
    {
        interval_keys<W>(box, own, key);
        if (!own.mixed_axes) return;
        WRT_FOR_LANES (i) {
            bool in = key[i] != NO_CHILD;
            for (int a = 0; a < 3; ++a)
                in = in & (box[a * W + i] <= own.box_high[a]) & (box[(3 + a) * W + i] >= own.box_low[a]);
            key[i] = in ? key[i] : NO_CHILD;
        }
    }

    /// Tests a leaf, the child in a lane of a node whose boxes are at `box`, for the frusta `mask`. make(f): makes the rays of
    /// a frustum; test(f, block, triangles): tests them.
    template <class Make, class Test>
    inline CUDA_CALLABLE void visit_leaf(
        int child, const float* box, const float* records, unsigned mask, const Make& make, const Test& test)
    {
        int block = ~child >> 6;
        for (int left = ~child & 63; left > 0; left -= W, ++block) {
            const float* triangles = records + (size_t)block * (RECORD * W);
            for (unsigned here = mask & alive; here; here &= here - 1u) {
                const int f = lowest_bit(here);
                unsigned kept = interval_mask<W>(triangles, frusta[f]);
                if (CORNERS && kept) kept = light_corner_mask<W>(frusta[f], triangles, kept);
                if (!kept) continue;
                if (!(made >> f & 1u)) {
                    made |= 1u << f;
                    make(f);
                }
                if (!meets_box(f, box)) continue;
                test(f, block, kept);
                alive &= frusta[f].t_max < 0.0f ? ~(1u << f) : ~0u;
            }
        }
    }

    /// Visits a node for the frusta `mask`; children that they meet wait, the nearest on top.
    template <class Tree, class Make, class Test>
    inline CUDA_CALLABLE void visit_node(
        const Tree& tree, const float* records, int node, unsigned mask, const Make& make, const Test& test)
    {
        const float* box = tree.bounds.data + (size_t)node * (6 * W);
        alignas(64) int met[W];
        alignas(64) int first[W];
        alignas(64) int key[W];
        alignas(64) int some[W];
        WRT_FOR_LANES (i) {
            met[i] = 0, first[i] = NO_CHILD;
        }
        for (unsigned left = mask; left; left &= left - 1u) {
            const int f = lowest_bit(left), bit = 1 << f;
            find_children(frusta[f], box, key);
            WRT_FOR_LANES (i) {
                met[i] |= key[i] != NO_CHILD ? bit : 0;
                first[i] = key[i] < first[i] ? key[i] : first[i];
            }
        }
        const int* child = tree.child.data + (size_t)node * W;
        WRT_FOR_LANES (i) {
            some[i] = met[i] ? -1 : 0;
        }
        const int begin_inner = waiting;
        for (unsigned lanes = bits<W>(some); lanes; lanes &= lanes - 1u) {
            const int i = lowest_bit(lanes), word = child[i];
            if (word < 0) {
                visit_leaf(word, box + i, records, (unsigned)met[i], make, test);
                continue;
            }
            int at = waiting++;
            for (; at > begin_inner && stack[at - 1].order < first[i]; --at) stack[at] = stack[at - 1];
            stack[at] = {word, (unsigned)met[i], first[i]};
        }
    }

    /// Traces the frusta begin .. begin + count - 1.
    template <class Tree, class Batch, class Light, class Make, class Test>
    inline CUDA_CALLABLE void trace(const Tree& tree, const float* records, const Batch& rays, const Light& light, int begin,
        int count, const Make& make, const Test& test)
    {
        for (int f = 0; f < count; ++f)
            alive |= frusta[f].template set<P>(rays, light, begin + f, tree.low, tree.high) ? 1u << f : 0u;
        stack[waiting++] = {0, alive, 0};
        while (waiting && alive) {
            const Waiting top = stack[--waiting];
            const unsigned mask = top.mask & alive;
            if (mask) visit_node(tree, records, top.node, mask, make, test);
        }
    }

    /// Writes the answers of each ray, or the number of occluded ones of each point.
    template <bool EACH, class Light>
    inline CUDA_CALLABLE void store(const Light& light, int count, unsigned char* occluded, int* counts)
    {
        for (int f = 0; f < count; ++f) {
            const LightFrustum& own = frusta[f];
            const int rest = light.samples - own.group * P, here = rest < P ? rest : P;
            const int* found = rays_of(f).primitive;
            const bool any = made >> f & 1u;
            if (EACH) {
                unsigned char* to = occluded + (size_t)own.point * light.samples + own.group * P;
                for (int k = 0; k < here; ++k) to[k] = any && found[k] >= 0 ? 1 : 0;
            } else {
                int dark = 0;
                if (any)
                    for (int k = 0; k < here; ++k) dark += found[k] >= 0 ? 1 : 0;
                counts[own.point] = (own.group ? counts[own.point] : 0) + dark;
            }
        }
    }
};

}  // namespace
}  // namespace wrt
