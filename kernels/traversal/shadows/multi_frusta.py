"""Multi-frusta tracing of shadow rays to an area light (Benthin and Wald 2009).

**Problem.** The shadow rays of one point to an area light are alike, those of neighbouring points less so. A packet of both has
loose bounds: it visits many nodes that few of its rays meet.

**Idea.** The rays from one point to a group of 16 samples of the light are a *frustum*: with a common origin, bounds are
intervals of directions alone, and these are known from the point and the box of the group, without a ray. 16 frusta walk the
tree together. A node has a bit for each frustum that meets it; a frustum against the W boxes of a node is one lane loop. Each
frustum ends when all of its rays are answered. Its rays are made when it first meets a triangle, so most frusta of lit points
never have any.

**Both signs.** Where an interval of directions contains 0, slabs bound nothing (`interval_culling` says what remains). There
the box around the frustum, from the point to the group, must meet the node's box.

**At leaves** the frustum is tested against the boxes of W triangles, and these against the four planes through its corner rays:
a triangle is culled if all of its vertices lie outside one of them. (For accurate triangle tests, whose hits lie near their
triangles; others cull by boxes.) What is left is tested only if one of the rays that are still open meets the box of the leaf,
because a wide frustum meets many leaves that none of its rays meets (notebooks/records/2026-11-23-multi-frusta.md). Rays are
tested 16 x one triangle, by the code of packets (`packet_block`).

**The same answers as `occluded`** of the same rays: bounds are rounded monotonically from the same expressions, so a frustum
meets every box that one of its rays meets; triangle test and consistency rule are those of every traversal. A direction whose
component may be flushed to 0 (`wrt.kernels.layout.ray_batch`, short directions) counts as one of both signs.

**Differences from the paper.** The children of a wide node are in the lanes, as elsewhere in this project. Back faces are not
culled at leaves, because `occluded` is hit by both sides. Eye rays have a traversal of their own
(`wrt.kernels.traversal.frusta.eye_frusta`).

References:
    C. Benthin, I. Wald: Efficient ray traced soft shadows using multi-frusta tracing. High Performance Graphics 2009.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (section 2.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.light_samples import GROUP, PATTERN_OF, LightSamples
from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.culling.interval_culling import BOXES, TRIANGLES
from wrt.kernels.traversal.packet.leaves.packet_block import block_code, block_constants
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

exact_module(__name__)

FRUSTA = 16
"""Frusta that walk the tree together."""

FLUSHED = 2.0**-90
"""Fraction of a direction's size below which a component may be flushed to 0, with room for rounding (`NEGLIGIBLE`)."""

_FRUSTA = """
    struct Frustum {
        int active, mixed_axes, passes;
        float t_min, t_max, slack;
        wp::vec3 inverse_large, inverse_small, forward_small, backward_small;
        wp::vec3 origin_in, origin_out, origin_low, origin_high;
        float box_low[3], box_high[3], direction_low[3], direction_high[3];
        int point, group;
    };
    Frustum frusta[FRUSTA];
    alignas(64) float rows_of[FRUSTA][COMPONENTS * P];
    const double center_x = rays.center.c[0], center_y = rays.center.c[1], center_z = rays.center.c[2];
    unsigned alive = 0, made = 0;
    const int pattern_floats = light.groups * 3 * P;
    for (int f = 0; f < count; ++f) {
        Frustum& b = frusta[f];
        const int number = begin + f;
        b.point = number / light.groups; b.group = number - b.point * light.groups;
        const size_t n = (size_t)b.point * rays.origin_stride;
        const wp::vec3 p = rays.origins.data[n];
        const float o[3] = {(float)((double)p.c[0] - center_x), (float)((double)p.c[1] - center_y),
                            (float)((double)p.c[2] - center_z)};
        const float least = rays.t_min.data[(size_t)b.point * rays.t_min_stride];
        const float given = rays.t_max.data[(size_t)b.point * rays.t_max_stride], most = given > FARTHEST ? FARTHEST : given;
        const int pattern = wrt_pattern_of((unsigned)b.point, (unsigned)light.patterns);
        const float* group = light.bounds.data + 6 * ((size_t)pattern * light.groups + b.group);
        float far = 0.0f, size = 0.0f;
        bool valid = (least >= 0.0f) & (least <= most);
        for (int a = 0; a < 3; ++a) {
            const float down = WRT_ABS(tree.low.c[a] - o[a]), up = WRT_ABS(tree.high.c[a] - o[a]);
            far = down > far ? down : far; far = up > far ? up : far;
            const float d0 = group[a] - p.c[a], d1 = group[3 + a] - p.c[a];
            b.direction_low[a] = d0; b.direction_high[a] = d1;
            size = WRT_ABS(d0) > size ? WRT_ABS(d0) : size; size = WRT_ABS(d1) > size ? WRT_ABS(d1) : size;
            valid = valid & (o[a] - o[a] == 0.0f) & (d0 - d0 == 0.0f) & (d1 - d1 == 0.0f);
        }
        valid = valid & (size >= SHORTEST);
        const float slack = SLACK * far, flushed = size * FLUSHED + 1e-37f;
        b.active = P; b.t_min = least; b.t_max = valid ? most : -INF; b.slack = slack;
        b.mixed_axes = 0;
        for (int a = 0; a < 3; ++a) {
            const float d0 = b.direction_low[a], d1 = b.direction_high[a];
            const bool forward = d0 > flushed, backward = d1 < -flushed, mixed = !forward & !backward;
            b.mixed_axes += mixed ? 1 : 0;
            b.inverse_large.c[a] = mixed ? WRT_NAN : backward ? 1.0f / d1 : 1.0f / d0;
            b.inverse_small.c[a] = mixed ? WRT_NAN : backward ? 1.0f / d0 : 1.0f / d1;
            b.forward_small.c[a] = (mixed & (d1 > 0.0f)) ? 1.0f / d1 : 0.0f;
            b.backward_small.c[a] = (mixed & (d0 < 0.0f)) ? 1.0f / d0 : 0.0f;
            b.origin_in.c[a] = backward ? o[a] - slack : o[a] + slack;
            b.origin_out.c[a] = backward ? o[a] + slack : o[a] - slack;
            b.origin_low.c[a] = b.origin_high.c[a] = o[a];
            // from the point to the ends of its rays, widened as boxes are, and by rounding
            const float to0 = (d0 < 0.0f ? d0 : 0.0f) * most, to1 = (d1 > 0.0f ? d1 : 0.0f) * most;
            const float wide = 2.0f * slack + SLACK * ((to1 - to0) + WRT_ABS(o[a]));
            b.box_low[a] = mixed ? (o[a] + to0) - wide : -INF;
            b.box_high[a] = mixed ? (o[a] + to1) + wide : INF;
        }
        alive |= valid ? 1u << f : 0u;
    }
    const unsigned all = alive;
"""
"""C++: the frusta of an item, from points and boxes of groups, without a ray."""

_MAKE = """
    auto make_rays = [&](int number) {
        Frustum& b = frusta[number];
        float* rows = rows_of[number];
        POINTERS
        const wp::vec3 p = rays.origins.data[(size_t)b.point * rays.origin_stride];
        const int pattern = wrt_pattern_of((unsigned)b.point, (unsigned)light.patterns);
        const float* sample = light.positions.data + (size_t)pattern * pattern_floats + b.group * 3 * P;
        const int rest = light.samples - b.group * P, here = rest < P ? rest : P;
        const float ox = b.origin_low.c[0], oy = b.origin_low.c[1], oz = b.origin_low.c[2];
        const float px = p.c[0], py = p.c[1], pz = p.c[2], most = b.t_max, least = b.t_min;
        int main_axes = 0;
        float to_x[P], to_y[P], to_z[P];
        WRT_FOR(P, k) {
            float x = sample[k] - px, y = sample[P + k] - py, z = sample[2 * P + k] - pz;
            wrt_direction(x, y, z);
            to_x[k] = x; to_y[k] = y; to_z[k] = z;
        }
        WRT_FOR(P, k) {
            const float x = to_x[k], y = to_y[k], z = to_z[k];
            const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
            float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
            const bool valid = (size >= SHORTEST) & (size < INF) & (k < here);
            const float ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
            inverse_x[k] = ix; inverse_y[k] = iy; inverse_z[k] = iz;
            t_min[k] = least;
            t[k] = valid ? most : -INF;
            ((int*)primitive)[k] = -1;
            const bool xy = size_x >= size_y, xz = size_x >= size_z, yz = size_y >= size_z;
            const bool main_x = xy & xz, main_y = !xy & yz;
            const float major = main_x ? x : main_y ? y : z;
            const float sx = (main_x ? y : main_y ? z : x) / major, sy = (main_x ? z : main_y ? x : y) / major;
            slope_x[k] = sx; slope_y[k] = sy;
            ((int*)main_axis)[k] = main_x ? 0 : main_y ? 1 : 2;
            main_axes |= main_x ? 1 : main_y ? 2 : 4;
            WRT_PREPARE
        }
        b.passes = PASSES == 1 ? 1 : main_axes;
    };
    auto test_rays = [&](int number, int block, unsigned mask) {
        Frustum& bounds = frusta[number];
        float* rows = rows_of[number];
        POINTERS
        WRT_TEST
    };
    auto meets_box = [&](int number, const float* box) {
        const Frustum& bounds = frusta[number];
        float* rows = rows_of[number];
        POINTERS
        const float wide = bounds.slack;
        const float x = bounds.origin_low.c[0], y = bounds.origin_low.c[1], z = bounds.origin_low.c[2];
        const float x0 = (box[0] - wide) - x, y0 = (box[W] - wide) - y, z0 = (box[2 * W] - wide) - z;
        const float x1 = (box[3 * W] + wide) - x, y1 = (box[4 * W] + wide) - y, z1 = (box[5 * W] + wide) - z;
        int any = 0;
        WRT_FOR(P, k) {
            // a comparison with NaN is false: an axis along which the ray stands still within the box counts as met
            const float ax = x0 * inverse_x[k], bx = x1 * inverse_x[k], ay = y0 * inverse_y[k], by = y1 * inverse_y[k];
            const float az = z0 * inverse_z[k], bz = z1 * inverse_z[k];
            float from = t_min[k], to = t[k];
            const float nx = inverse_x[k] < 0.0f ? bx : ax, fx = inverse_x[k] < 0.0f ? ax : bx;
            const float ny = inverse_y[k] < 0.0f ? by : ay, fy = inverse_y[k] < 0.0f ? ay : by;
            const float nz = inverse_z[k] < 0.0f ? bz : az, fz = inverse_z[k] < 0.0f ? az : bz;
            from = nx > from ? nx : from; from = ny > from ? ny : from; from = nz > from ? nz : from;
            to = fx < to ? fx : to; to = fy < to ? fy : to; to = fz < to ? fz : to;
            any |= from > to ? 0 : 1;
        }
        return any != 0;
    };
    auto cull_boxes = [&](const Frustum& bounds, int node, int* key_row) {
        struct Keys { int* data; };
        const Keys keys = {key_row};
        constexpr int first = 0;
        WRT_BOXES
    };
    auto cull_triangles = [&](const Frustum& bounds, int block) -> unsigned {
        WRT_TRIANGLES
    };
"""
"""C++: the rays of a frustum, made on demand, and its tests."""

_CORNERS = """
    // planes through the corner rays around the directions; a vertex beyond one by more than 4 slack is farther from it than a
    // hit from its triangle (1 slack), rounding of slopes and products included
    auto cull_corners = [&](const Frustum& bounds, int block, unsigned kept) -> unsigned {
        const float* r = &records.data[(size_t)block * (RECORD * W)];
        int main = -1;
        float best = 0.0f;
        for (int a = 0; a < 3; ++a) {
            const float d0 = bounds.direction_low[a], d1 = bounds.direction_high[a];
            const float least = d0 > 0.0f ? d0 : d1 < 0.0f ? -d1 : 0.0f;
            if (least > best) { best = least; main = a; }
        }
        if (main < 0) return kept;
        const int next = main == 2 ? 0 : main + 1, other = next == 2 ? 0 : next + 1;
        const float sign = bounds.direction_low[main] > 0.0f ? 1.0f : -1.0f;
        const float m0 = WRT_ABS(bounds.direction_low[main]), m1 = WRT_ABS(bounds.direction_high[main]);
        const float short_ = m0 < m1 ? m0 : m1, long_ = m0 < m1 ? m1 : m0;
        // slopes of the rays against the main axis, from the ends of the intervals
        float low[2], high[2];
        for (int a = 0; a < 2; ++a) {
            const float d0 = bounds.direction_low[a ? other : next], d1 = bounds.direction_high[a ? other : next];
            low[a] = d0 / (d0 < 0.0f ? short_ : long_); high[a] = d1 / (d1 < 0.0f ? long_ : short_);
        }
        const float o_m = bounds.origin_low.c[main], o_u = bounds.origin_low.c[next], o_v = bounds.origin_low.c[other];
        const float u0 = low[0], u1 = high[0], v0 = low[1], v1 = high[1];
        if (!((u0 > -STEEPEST) & (u1 < STEEPEST) & (v0 > -STEEPEST) & (v1 < STEEPEST))) return kept;
        int stays[W];
        WRT_FOR_LANES(i) {
            float m[3], u[3], v[3];
            for (int k = 0; k < 3; ++k) {
                m[k] = sign * (r[(3 * k + main) * W + i] - o_m);
                u[k] = r[(3 * k + next) * W + i] - o_u; v[k] = r[(3 * k + other) * W + i] - o_v;
            }
            const float cap = 4.0f * bounds.slack;
            float beyond_u0 = -INF, beyond_u1 = INF, beyond_v0 = -INF, beyond_v1 = INF, front = -INF;
            for (int k = 0; k < 3; ++k) {
                const float a = u[k] - u0 * m[k], b = u[k] - u1 * m[k], c = v[k] - v0 * m[k], d = v[k] - v1 * m[k];
                beyond_u0 = a > beyond_u0 ? a : beyond_u0; beyond_u1 = b < beyond_u1 ? b : beyond_u1;
                beyond_v0 = c > beyond_v0 ? c : beyond_v0; beyond_v1 = d < beyond_v1 ? d : beyond_v1;
                front = m[k] > front ? m[k] : front;
            }
            const float steep_u = 1.0f + (WRT_ABS(u0) > WRT_ABS(u1) ? WRT_ABS(u0) : WRT_ABS(u1));
            const float steep_v = 1.0f + (WRT_ABS(v0) > WRT_ABS(v1) ? WRT_ABS(v0) : WRT_ABS(v1));
            const bool outside = (beyond_u0 < -cap * steep_u) | (beyond_u1 > cap * steep_u) | (beyond_v0 < -cap * steep_v)
                | (beyond_v1 > cap * steep_v) | (front < -cap);
            stays[i] = outside ? 0 : -1;
        }
        return wrt::bits<W>(stays) & kept;
    };
"""
"""C++: the side planes of a frustum against the triangles of a block."""

_NO_CORNERS = "    auto cull_corners = [](const Frustum&, int, unsigned kept) { return kept; };"

_WALK = """
    struct Waiting { int node; unsigned mask; int order; };
    Waiting stack[LEVELS * (W - 1) + 1];
    int waiting = 0;
    stack[waiting++] = {0, alive, 0};
    while (waiting && alive) {
        const Waiting top = stack[--waiting];
        const unsigned mask = top.mask & alive;
        if (!mask) continue;
        alignas(64) int met[W], first[W], key[W];
        WRT_FOR_LANES(i) { met[i] = 0; first[i] = NO_CHILD; }
        for (unsigned left = mask; left; left &= left - 1u) {
            const int f = wrt::lowest_bit(left), bit = 1 << f;
            const Frustum& b = frusta[f];
            cull_boxes(b, top.node, key);
            if (b.mixed_axes) {
                const float* box = &boxes.data[(size_t)top.node * (6 * W)];
                WRT_FOR_LANES(i) {
                    bool in = key[i] != NO_CHILD;
                    for (int a = 0; a < 3; ++a) {
                        in = in & (box[a * W + i] <= b.box_high[a]) & (box[(3 + a) * W + i] >= b.box_low[a]);
                    }
                    key[i] = in ? key[i] : NO_CHILD;
                }
            }
            WRT_FOR_LANES(i) {
                met[i] |= key[i] != NO_CHILD ? bit : 0;
                first[i] = key[i] < first[i] ? key[i] : first[i];
            }
        }
        const int* child = tree.child.data + (size_t)top.node * W;
        alignas(64) int some[W];
        WRT_FOR_LANES(i) some[i] = met[i] ? -1 : 0;
        int begin_inner = waiting;
        for (unsigned lanes = wrt::bits<W>(some); lanes; lanes &= lanes - 1u) {
            const int i = wrt::lowest_bit(lanes), word = child[i];
            if (word >= 0) {  // the nearest on top
                int at = waiting++;
                for (; at > begin_inner && stack[at - 1].order < first[i]; --at) stack[at] = stack[at - 1];
                stack[at] = {word, (unsigned)met[i], first[i]};
                continue;
            }
            const int triangles_left = ~word & 63;
            int block = ~word >> 6;
            for (int left = triangles_left; left > 0; left -= W, ++block) {
                for (unsigned here = (unsigned)met[i] & alive; here; here &= here - 1u) {
                    const int f = wrt::lowest_bit(here);
                    unsigned kept = cull_triangles(frusta[f], block);
                    if (CORNERS && kept) kept = cull_corners(frusta[f], block, kept);
                    if (!kept) continue;
                    if (!(made >> f & 1u)) { made |= 1u << f; make_rays(f); }
                    if (!meets_box(f, &boxes.data[(size_t)top.node * (6 * W) + i])) continue;
                    test_rays(f, block, kept);
                    alive &= frusta[f].t_max < 0.0f ? ~(1u << f) : ~0u;
                }
            }
        }
    }
"""
"""C++: the way of the frusta through the tree."""

_STORE = """
    for (int f = 0; f < count; ++f) {
        const Frustum& b = frusta[f];
        const int rest = light.samples - b.group * P, here = rest < P ? rest : P;
        const int* found = (const int*)(rows_of[f] + FOUND * P);
        const bool any = made >> f & 1u;
        if (EACH) {
            unsigned char* to = occluded.data + (size_t)b.point * light.samples + b.group * P;
            for (int k = 0; k < here; ++k) to[k] = any && found[k] >= 0 ? 1 : 0;
        } else {
            int dark = 0;
            if (any) for (int k = 0; k < here; ++k) dark += found[k] >= 0 ? 1 : 0;
            counts.data[b.point] = (b.group ? counts.data[b.point] : 0) + dark;
        }
    }
"""
"""C++: answers of each ray, or their number for each point."""


@cache
def make_trace(config: TraversalConfig, each: bool) -> wp.Function:
    """`wp.func(tree, boxes, records, ids, rays, light, begin, count, occluded, counts)`: traces frusta begin .. begin + count -
    1."""
    test = TRIANGLE_TESTS[config.triangle_test]
    layout = PacketLayout(GROUP, config.width, True, config.triangle_test)
    pointers = "".join(f"float* {name} = rows + {k} * P;\n" for k, name in enumerate(layout.components))
    pointers += "float *origin_x = nullptr, *origin_y = nullptr, *origin_z = nullptr, *slack = nullptr;\n"
    constants = f"""{layout.constants}{DIRECTION_LANES}{PATTERN_OF}
    constexpr int FRUSTA = {FRUSTA}, COMPONENTS = {len(layout.components)}, FOUND = {layout.components.index("primitive")};
    constexpr int NO_CHILD = {NO_CHILD_CONSTANT}, LEVELS = {config.stack.levels};
    constexpr bool EACH = {str(each).lower()}, CORNERS = {str(test.accurate).lower()};
    constexpr float STEEPEST = 1e6f, SLACK = {SLACK!r}f, FLUSHED = {FLUSHED!r}f;
    """
    constants += block_constants(layout, any_hit=True)
    make = _MAKE.replace("WRT_PREPARE", test.packet_form.prepare).replace("WRT_TEST", block_code(layout))
    make = make.replace("WRT_BOXES", BOXES).replace("WRT_TRIANGLES", TRIANGLES).replace("POINTERS", pointers)
    corners = _CORNERS if test.accurate else _NO_CORNERS

    @native.func_native("lanes.h", constants + _FRUSTA + make + corners + _WALK + _STORE)
    def trace_native(
        tree: WideNodes,
        boxes: wp.array(dtype=float),
        records: wp.array(dtype=float),
        ids: wp.array(dtype=int),
        rays: RayBatch,
        light: LightSamples,
        begin: int,
        count: int,
        occluded: wp.array(dtype=wp.uint8),
        counts: wp.array(dtype=int),
    ): ...

    return trace_native


@cache
def make_kernel(config: TraversalConfig, each: bool) -> wp.Kernel:
    """The kernel for one specialisation; each: whether it answers each ray, or counts those that are occluded.

    Points are the origins of `rays`, whose directions are not read. The frusta of a point are in one item.
    """
    trace = make_trace(config, each)

    def multi_frusta(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        light: LightSamples,
        occluded: wp.array(dtype=wp.uint8),
        counts: wp.array(dtype=int),
    ):
        """Item: as many points as have 16 frusta, at least one."""
        points = wp.max(wp.static(FRUSTA) / light.groups, 1)
        begin = (first + wp.tid()) * points
        frustum = begin * light.groups
        end = wp.min(begin + points, rays.count) * light.groups
        while frustum < end:
            count = wp.min(wp.static(FRUSTA), end - frustum)
            trace(tree, tree.bounds, triangles.records, triangles.primitive, rays, light, frustum, count, occluded, counts)
            frustum += count

    return specialised_kernel(multi_frusta)
