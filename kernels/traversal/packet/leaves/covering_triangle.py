"""A triangle that all rays of several packets hit, told from their bounds alone.

**Problem.** In scenes of large triangles, most packets of shadow rays are occluded by the triangle that occluded the packet
before. To find that again, the packet is loaded, bounded, prepared and tested, ray by ray.

**Idea.** Take the intervals of origins and directions of some packets together, as they lie in memory
(`wrt.kernels.traversal.packet.rays.joint_bounds`). A ray with origin o and direction d passes edge e of a triangle, which
begins at vertex p, on the side that the sign of (p - o) x e . d tells. If for each of the three edges the sign is the same
whatever o and d are taken from the intervals, all rays pass inside: the triangle covers the shaft of the rays. Dmitriev et al.
(2004) ask this of the corner rays of a packet; here W triangles are tested at a time, as in Komatsu et al.'s test of a frustum
of rays against a triangle.

**Arithmetic.** With the middle and the half extent of each interval, each quantity is its value in the middle plus or minus a
radius, a sum of half extents times absolute values. Directions are divided by their largest component.

**Exactness.** The answer must be that of the test of each ray, which rounds. Its areas have errors of less than 2^-19 S^2,
where S is the sum of a triangle's largest coordinates relative to the origins. So rays count as inside only by a margin of
`INSIDE` S^2, triangles count only if they span at least `LEAST_AREA` S^2 as seen along the rays, and then t has an error of
less than S / 512: the plane of the triangle must be `CLOSEST` S within the rays' range. Nothing else can make such a test miss,
if it promises that (`PacketForm.certain`). NaN and infinite numbers are found on the way, and no triangle covers a zero
direction.

References:
    K. Dmitriev, V. Havran, H.-P. Seidel: Faster ray tracing with SIMD shaft culling. Research report MPI-I-2004-4-006,
        Max-Planck-Institut für Informatik, 2004.
    K. Komatsu, Y. Kaeriyama, K. Suzuki, H. Takizawa, H. Kobayashi: A fast ray frustum-triangle intersection algorithm with
        precomputation and early termination. IPSJ Transactions on Advanced Computing Systems 1(1), 2008.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.lane_vectors import vector_words
from wrt.kernels.simd.triples import triple_extremes
from wrt.kernels.traversal.packet.rays.joint_bounds import EXTREMES
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_numbers import ROWS

exact_module(__name__)

INSIDE = 2.0**-14
"""Least signed area by which rays must pass inside of an edge, as a fraction of S^2: 32 times the error of a test's area."""

LEAST_AREA = 2.0**-9
"""Least area of a triangle as seen along the rays, likewise."""

CLOSEST = 2.0**-8
"""Least distance from the ends of the rays' range to the triangle's plane, as a fraction of S, twice the error."""

SMALLEST, LARGEST = 1e-10, 1e12
"""Of S, so that no product of three lengths underflows or overflows."""

_SHAFT = """
    if (bits_of(odd != 0.0f)) return 0;
    float middle[3], around[3], along[3], spread[3], longest = 0.0f;
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        const float least_size = WRT_ABS(low_of[1][a]), most_size = WRT_ABS(high_of[1][a]);
        longest = least_size > longest ? least_size : longest; longest = most_size > longest ? most_size : longest;
        middle[a] = 0.5f * lows[a] + 0.5f * highs[a];
        const float above = highs[a] - middle[a], below = middle[a] - lows[a];
        around[a] = above > below ? above : below;
    }
    const float scale = 1.0f / longest, first_t = rays.t_min.data[0] * longest, last_t = last * longest;
    WRT_UNROLLED for (int a = 0; a < 3; ++a) {
        const float from = low_of[1][a] * scale, to = high_of[1][a] * scale;
        along[a] = 0.5f * (from + to);
        spread[a] = 0.5f * (to - from) + ROUNDING;
    }
    if (!(rays.t_min.data[0] >= 0.0f)) return 0;
    const float all_around = (around[0] + around[1]) + around[2];
    float widest = spread[0] > spread[1] ? spread[0] : spread[1]; widest = spread[2] > widest ? spread[2] : widest;
    const float second = all_around * widest;
"""

_COVER = """
    auto size_of = [](vf value) { return __builtin_elementwise_abs(value); };
    auto cross = [](const vf* p, const auto* q, vf* to) {
        WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            const int b = a == 2 ? 0 : a + 1, c = b == 2 ? 0 : b + 1;
            to[a] = p[b] * q[c] - p[c] * q[b];
        }
    };
    // of a vector whose intervals are `at` +- `radius`: adds its product with `by`, and the radius of that
    auto add_product = [&](const vf* by, const float* at, const float* radius, vf& value, vf& value_radius) {
        WRT_UNROLLED for (int a = 0; a < 3; ++a) { value += by[a] * at[a]; value_radius += size_of(by[a]) * radius[a]; }
    };
    for (int piece = 0; piece < blocks; ++piece) {
        const float* const record = &records.data[(size_t)(block + piece) * (RECORD * W)];
        vf vertex[3][3], edge[3][3], reach = (vf)0.0f;
        WRT_UNROLLED for (int v = 0; v < 3; ++v) {
            vf own = (vf)all_around;
            WRT_UNROLLED for (int a = 0; a < 3; ++a) {
                vertex[v][a] = load(record + (3 * v + a) * W) - middle[a];
                own += size_of(vertex[v][a]);
            }
            reach = own > reach ? own : reach;
        }
        WRT_UNROLLED for (int v = 0; v < 3; ++v) WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            edge[v][a] = vertex[v == 2 ? 0 : v + 1][a] - vertex[v][a];
        }
        const vf unit = reach * reach;
        vf normal[3], facing = (vf)0.0f, facing_radius = facing, distance = facing, distance_radius = facing;
        cross(edge[0], edge[1], normal);
        add_product(normal, along, spread, facing, facing_radius);
        WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            distance += normal[a] * vertex[0][a]; distance_radius += size_of(normal[a]) * around[a];
        }
        const vf side = facing < 0.0f ? (vf)-1.0f : (vf)1.0f;
        const vf slowest = side * facing - MORE * facing_radius, fastest = side * facing + MORE * facing_radius;
        const vf nearest = side * distance - MORE * distance_radius, farthest = side * distance + MORE * distance_radius;
        const vf margin = CLOSEST * reach * fastest;
        vi covered = (slowest > LEAST_AREA * unit) & (reach > SMALLEST) & (reach < LARGEST)
            & (nearest > first_t * fastest + margin) & (farthest < last_t * slowest - margin);
        if (!bits_of(covered)) continue;
        WRT_UNROLLED for (int v = 0; v < 3; ++v) {
            vf moment[3], across[3], length = (vf)0.0f, inside = length, radius = length;
            cross(vertex[v], edge[v], moment);
            cross(edge[v], along, across);
            add_product(moment, along, spread, inside, radius);
            WRT_UNROLLED for (int a = 0; a < 3; ++a) {
                radius += size_of(across[a]) * around[a]; length += size_of(edge[v][a]);
            }
            radius += length * second;  // of both intervals at once
            covered = covered & (side * inside - MORE * radius > INSIDE * unit);
        }
        if (bits_of(covered)) return packets;
    }
    return 0;
"""


@cache
def covered_packets(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, limit, records, block, blocks) -> int`: the number of packets from ray `first` on, at most `limit`,
    all of whose rays hit one triangle of the `blocks` blocks from `block` on; 0 if that is not known.

    Only for tests whose `PacketForm.certain` is true. The packets are whole and lie side by side in the batch
    (`wrt.kernels.traversal.packet.rays.ray_numbers.ROWS`). 0 on CUDA.
    """
    constants = f"""
    constexpr bool ENDS = false, ODD = true;
    constexpr float INSIDE = {INSIDE!r}f, LEAST_AREA = {LEAST_AREA!r}f, CLOSEST = {CLOSEST!r}f, ROUNDING = {2.0**-22!r}f;
    constexpr float SMALLEST = {SMALLEST!r}f, LARGEST = {LARGEST!r}f, MORE = 1.001f;
{DIRECTION_LANES}"""
    body = vector_words(layout.width) + triple_extremes(layout.width) + EXTREMES + _SHAFT + _COVER
    body = f"{ROWS}    if (packets < 2 || rays.t_min_stride || rays.t_max_stride) return 0;\n{body}"
    body = f"#if defined(__clang__) && !defined(__CUDA_ARCH__)\n{body}#else\n    return 0;\n#endif\n"

    @native.func_native("lanes.h", layout.constants + constants + body)
    def covered_native(
        rays: RayBatch, first: int, limit: int, records: wp.array(dtype=float), block: int, blocks: int
    ) -> int: ...

    return covered_native
