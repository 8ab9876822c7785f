"""Conservative rasterisation of triangles onto the cube of directions around a point light, in float64.

**What must be listed.** A shadow ray starts at o and has the direction d = fl(light - o). A triangle test finds a hit at t in
[0, 1]. The list of the cell that contains -d must have the triangle.

**Proof.** The ray ends at o + d = light + e, where e comes from rounding o and d: |e| <= 2^-23 (|o| + |d|), all norms here are
the largest component. So o + t d = light + e + (1 - t)(-d): seen from light + e, the hit lies *exactly* in the direction -d. A
hit of an accurate test lies within 2^-20 reach of the triangle (`TriangleTest.accurate`). Hence there is a point p of the
triangle and an error h with

    (1 - t)(-d) = p - light + h,  |h| <= slack,

where slack is at least |e| plus twice the distance of a hit (`slack_of`). Let c be -d scaled to depth 1 and s = (1 - t)|d| the
depth of the hit: s c = p - light + h. The following tests accept a cell if any c in it satisfies this for any p and h; the cell
is widened by `CELL_SLACK`, more than the rounding of u and v (three operations on numbers up to 2). Errors of float64 are ten
thousand times smaller than slack.

* **Rectangle.** The projections of the vertices, each anywhere in a box of radius slack, bound u and v; if the triangle reaches
  behind the light, the projection of its box in front of depth rho does, where rho is a lower bound of s: the distance of the
  triangle from the light minus slack.
* **Edges.** For vertices A, B, C around the light, n = A x B has the sign of the volume (A, B, C) on C. n . s c = n . p + n . h
  >= -|n|_1 slack, so n . c >= -|n|_1 slack / rho.
* **Plane.** With the normal N towards which the volume V = N . A is positive, s N . c lies in V -+ |N|_1 slack. This bounds s
  too: the least depth in the cell.

For tests that are not accurate, all that is known is that a hit lies in the widened box of its triangle (the consistency rule
of `wrt.kernels.simd.boxes`). Their triangles are listed wherever the box is seen.

**Back faces.** If shadow rays hit only fronts, a triangle that turns its front to the light is left out: its volume V is below
-2 |N|_1 slack with N from its winding, so N . s c = V + N . h is negative, N . d positive, and no ray comes from its front.

**Covered cells.** Behind a triangle that covers a cell, every ray of the cell is occluded. A watertight test finds the hit for
certain if the line passes inside the triangle by more than its rounding: the signs of its areas are those of the sheared
vertices, which are the vertices, each moved by at most slack. An edge's volume c . (A + a) x (B + b) with |a|, |b| <= slack
differs from c . A x B by at most 2 slack (|A|_1 + |B|_1 + 2 slack), as no component of c is above 1. If c . n is larger at all
four corners of the cell, for all edges, there is a hit. Its depth lies in the interval of the plane, V -+ |N|_1 slack over N .
c. The cell keeps the least far end of such intervals.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.light_cells import CELL_SLACK, DEPTH_SLACK
from wrt.kernels.runtime.options import exact_module, specialised_kernel

exact_module(__name__)

COVER, COUNT, FILL = "cover", "count", "fill"
"""The three rasterisations of a build: the depths behind which cells are covered; the lengths of the lists; the lists."""

INFINITY_BITS = 0x7F800000
"""Bits of the float32 infinity."""

ATOMICS = """
    auto wrt_fetch_add = [](int* at, int value) {
#if defined(__CUDA_ARCH__)
        return atomicAdd(at, value);
#else
        return __atomic_fetch_add(at, value, __ATOMIC_RELAXED);
#endif
    };
    auto wrt_lower = [](int* at, int value) {
#if defined(__CUDA_ARCH__)
        atomicMin(at, value);
#else
        int known = __atomic_load_n(at, __ATOMIC_RELAXED);
        while (value < known && !__atomic_compare_exchange_n(at, &known, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
#endif
    };
    auto wrt_bits_of = [](double depth) { return __builtin_bit_cast(int, (float)depth); };
"""

_DISTANCE = """
    auto dot3 = [](const double* p, const double* q) { return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]; };
    auto most = [](double p, double q) { return p > q ? p : q; };
    auto least = [](double p, double q) { return p < q ? p : q; };
    auto size = [](double p) { return p < 0.0 ? -p : p; };
    // squared distance of the light from an edge
    auto from_edge = [&](const double* p, const double* q) {
        const double e[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]}, length = dot3(e, e);
        double at = length > 0.0 ? -dot3(p, e) / length : 0.0;
        at = at < 0.0 ? 0.0 : at > 1.0 ? 1.0 : at;
        const double r[3] = {p[0] + at * e[0], p[1] + at * e[1], p[2] + at * e[2]};
        return dot3(r, r);
    };
    auto crossed = [](const double* p, const double* q, double* r) {
        r[0] = p[1] * q[2] - p[2] * q[1]; r[1] = p[2] * q[0] - p[0] * q[2]; r[2] = p[0] * q[1] - p[1] * q[0];
    };
    double normal[3], edge[3][3];
    {
        const double e[3] = {P[1][0] - P[0][0], P[1][1] - P[0][1], P[1][2] - P[0][2]};
        const double f[3] = {P[2][0] - P[0][0], P[2][1] - P[0][1], P[2][2] - P[0][2]};
        crossed(e, f, normal);
    }
    for (int k = 0; k < 3; ++k) crossed(P[k], P[(k + 1) % 3], edge[k]);
    double volume = dot3(normal, P[0]);
    if (BACKS_ONLY && volume < -2.0 * (size(normal[0]) + size(normal[1]) + size(normal[2])) * slack) return;
    const bool turn = volume < 0.0;
    volume = turn ? -volume : volume;
    for (int k = 0; k < 3; ++k) {
        normal[k] = turn ? -normal[k] : normal[k];
        for (int a = 0; a < 3; ++a) edge[k][a] = turn ? -edge[k][a] : edge[k][a];
    }
    // lower bound of the largest component of any point of the triangle, or of its box
    double rho = 0.0, box_low[3], box_high[3];
    for (int a = 0; a < 3; ++a) {
        box_low[a] = least(P[0][a], least(P[1][a], P[2][a]));
        box_high[a] = most(P[0][a], most(P[1][a], P[2][a]));
        rho = most(rho, most(box_low[a], -box_high[a]));
    }
    if (!BY_BOX) {
        double far = least(from_edge(P[0], P[1]), least(from_edge(P[1], P[2]), from_edge(P[2], P[0])));
        // the foot of the perpendicular from the light is inside: it sees all edges from within
        const double steep = dot3(normal, normal);
        bool inside = steep > 0.0;
        for (int k = 0; k < 3; ++k) inside = inside & (dot3(edge[k], normal) > 0.0);
        if (inside) far = least(far, volume * volume / steep);
        rho = most(rho, sqrt(far) * 0.57735);
    }
    rho = rho * (1.0 - 1e-9) - slack;
    const double normal_size = size(normal[0]) + size(normal[1]) + size(normal[2]);
    const double volume_low = volume - normal_size * slack, volume_high = volume + normal_size * slack;
"""
"""C++: edges and normal of the triangle with the vertices P[3][3], relative to the light, and its distance."""

_FACE = """
    const double half = 1.0 / R + CELL_SLACK;
    for (int face = 0; face < 6; ++face) {
        const int ax = face / 2, ay = (ax + 1) % 3, az = (ax + 2) % 3;
        const double sign = face % 2 ? -1.0 : 1.0;
        const double front = most(sign * box_low[ax], sign * box_high[ax]) + slack;
        const double back = least(sign * box_low[ax], sign * box_high[ax]) - slack;
        if (!(front > 0.0)) continue;
        double u_low = -1.0, u_high = 1.0, v_low = -1.0, v_high = 1.0;
        const double closest = most(back, rho);
        if (closest > front) continue;  // nearer to another face
        if (back > 0.0 && !BY_BOX) {
            u_low = v_low = 1e300; u_high = v_high = -1e300;
            for (int k = 0; k < 3; ++k) {
                const double x = sign * P[k][ax], y = P[k][ay], z = P[k][az];
                const double y0 = y - slack, y1 = y + slack, z0 = z - slack, z1 = z + slack, x0 = x - slack, x1 = x + slack;
                u_low = least(u_low, y0 / (y0 >= 0.0 ? x1 : x0)); u_high = most(u_high, y1 / (y1 >= 0.0 ? x0 : x1));
                v_low = least(v_low, z0 / (z0 >= 0.0 ? x1 : x0)); v_high = most(v_high, z1 / (z1 >= 0.0 ? x0 : x1));
            }
        } else if (closest > 0.0) {
            const double y0 = box_low[ay] - slack, y1 = box_high[ay] + slack;
            const double z0 = box_low[az] - slack, z1 = box_high[az] + slack;
            u_low = y0 / (y0 >= 0.0 ? front : closest); u_high = y1 / (y1 >= 0.0 ? closest : front);
            v_low = z0 / (z0 >= 0.0 ? front : closest); v_high = z1 / (z1 >= 0.0 ? closest : front);
        }
        if (!(u_low <= 1.0 + CELL_SLACK && u_high >= -1.0 - CELL_SLACK)) continue;
        if (!(v_low <= 1.0 + CELL_SLACK && v_high >= -1.0 - CELL_SLACK)) continue;
        auto cell_at = [&](double w) {
            const double place = (w + 1.0) * (0.5 * R);
            return place <= 0.0 ? 0 : place >= R - 1 ? R - 1 : (int)place;
        };
        const int i0 = cell_at(u_low - 2.0 * CELL_SLACK), i1 = cell_at(u_high + 2.0 * CELL_SLACK);
        const int j0 = cell_at(v_low - 2.0 * CELL_SLACK), j1 = cell_at(v_high + 2.0 * CELL_SLACK);
        // value at u, v: c + cu u + cv v; over a cell it varies by -+ span
        double c[4], cu[4], cv[4], span[4], margin[3], inner[3];
        for (int k = 0; k < 4; ++k) {
            const double* n = k < 3 ? edge[k] : normal;
            c[k] = sign * n[ax]; cu[k] = n[ay]; cv[k] = n[az];
            span[k] = (size(cu[k]) + size(cv[k])) * half;
        }
        for (int k = 0; k < 3; ++k) {
            const double* p = P[k];
            const double* q = P[(k + 1) % 3];
            const double sizes = size(p[0]) + size(p[1]) + size(p[2]) + size(q[0]) + size(q[1]) + size(q[2]);
            margin[k] = rho > 0.0 ? (size(c[k]) + size(cu[k]) + size(cv[k])) * slack / rho : 1e300;
            inner[k] = 2.0 * slack * (sizes + 2.0 * slack);
        }
        const double steepest = rho > 0.0 ? volume_high / rho : 1e300;
        for (int j = j0; j <= j1; ++j) for (int i = i0; i <= i1; ++i) {
            const double u = (2 * i + 1) * (1.0 / R) - 1.0, v = (2 * j + 1) * (1.0 / R) - 1.0;
            double depth = most(closest, 0.0), value[4];
            bool covers = COVERING;
            if (!BY_BOX) {
                bool seen = true;
                for (int k = 0; k < 4; ++k) value[k] = c[k] + cu[k] * u + cv[k] * v;
                for (int k = 0; k < 3; ++k) {
                    seen = seen & (value[k] + span[k] >= -margin[k]);
                    covers = covers & (value[k] - span[k] >= inner[k]);
                }
                seen = seen & (value[3] - span[3] <= steepest);
                if (volume_low > 0.0) seen = seen & (value[3] + span[3] > 0.0);
                if (!seen) continue;
                if (volume_low > 0.0) depth = most(depth, volume_low / (value[3] + span[3]));
                covers = covers & (volume_low > 0.0) & (value[3] - span[3] > 0.0);
            }
            const int cell = (face * R + j) * R + i;
            const int near = wrt_bits_of(depth * (1.0 - DEPTH_SLACK));
            int far = INFINITE;
            if (covers) far = wrt_bits_of(volume_high / (value[3] - span[3]) * (1.0 + DEPTH_SLACK));
            EMIT
        }
    }
"""

_EMIT = {
    COVER: "if (covers) wrt_lower(words.data + 4 * (size_t)cell + 2, far);",
    COUNT: """
            if (near <= words.data[4 * (size_t)cell + 2]) wrt_fetch_add(words.data + 4 * (size_t)cell + 1, 1);
    """,
    FILL: """
            if (near > words.data[4 * (size_t)cell + 2]) continue;
            const int place = wrt_fetch_add(words.data + 4 * (size_t)cell, 1);
            entries.data[place] = (unsigned long long)(unsigned)near << 32 | (unsigned)triangle;
    """,
}


@cache
def rasterise(stage: str, by_box: bool, covering: bool, backs_only: bool) -> wp.Function:
    """`wp.func(a, b, c, triangle, resolution, slack, words, entries)`: one stage of the build for one triangle.

    a, b, c: vertices relative to the light. words: of the cells; `FILL` advances `begin` of a cell by the entries that it
    writes.

    Args:
        stage: `COVER`, `COUNT` or `FILL`.
        by_box: whether the box of the triangle is rasterised in its place, for tests that are not accurate.
        covering: whether triangles may cover cells, for watertight tests.
        backs_only: whether triangles that turn their front to the light are left out.
    """
    constants = f"""
    constexpr bool BY_BOX = {str(by_box).lower()}, COVERING = {str(covering).lower()};
    constexpr bool BACKS_ONLY = {str(backs_only).lower()};
    constexpr int INFINITE = {INFINITY_BITS};
    constexpr double CELL_SLACK = {CELL_SLACK!r}, DEPTH_SLACK = {DEPTH_SLACK!r};
    const int R = resolution;
    double P[3][3];
    for (int k = 0; k < 3; ++k) {{ P[0][k] = a.c[k]; P[1][k] = b.c[k]; P[2][k] = c_.c[k]; }}
    """

    @wp.func_native(constants + ATOMICS + _DISTANCE + _FACE.replace("EMIT", _EMIT[stage]))
    def rasterise_native(
        a: wp.vec3d,
        b: wp.vec3d,
        c_: wp.vec3d,
        triangle: int,
        resolution: int,
        slack: wp.float64,
        words: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
    ): ...

    return rasterise_native


@cache
def make_rasteriser(stage: str, by_box: bool, covering: bool, backs_only: bool) -> wp.Kernel:
    """The kernel of one stage. Triangles with a NaN or an infinity, which no ray hits, are left out.

    Arguments as of `rasterise`.
    """
    draw = rasterise(stage, by_box, covering, backs_only)

    def rasterise_triangles(
        first: int,
        vertices: wp.array(dtype=wp.vec3),
        faces: wp.array(dtype=wp.vec3i),
        light: wp.vec3d,
        resolution: int,
        slack: wp.float64,
        words: wp.array(dtype=int),
        entries: wp.array(dtype=wp.uint64),
    ):
        """Item: a triangle."""
        triangle = first + wp.tid()
        face = faces[triangle]
        a = wp.vec3d(vertices[face[0]]) - light
        b = wp.vec3d(vertices[face[1]]) - light
        c = wp.vec3d(vertices[face[2]]) - light
        total = a + b + c
        rest = total - total
        if rest[0] == wp.float64(0.0) and rest[1] == wp.float64(0.0) and rest[2] == wp.float64(0.0):
            draw(a, b, c, triangle, resolution, slack, words, entries)

    return specialised_kernel(rasterise_triangles)
