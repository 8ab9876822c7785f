"""Which triangles of a block the rays of a packet may meet, by linear edge functions: for rays through one point.

**Idea.** Let rays along (sx, sy, 1), in the order of axes that their main axis gives, start at a common point, and let p, q, r
be the vertices of a triangle relative to it. The three areas of Woop's test, such as a = (r - s r_z) x (q - s q_z), are linear
in the slopes: the product sx sy has the factor q_z r_z - r_z q_z = 0. So a = a0 + a1 sx + a2 sy, where (a1, a2, a0) is the
normal r x q of the plane through the point and an edge (Komatsu et al. 2008 precompute the same planes for frusta). The nine
coefficients are computed for W triangles at a time, and a pair of a ray and a triangle takes six fused multiply-adds.

**Which packets.** All lines pass through the box of `PacketBounds.origin_in` and `origin_out`: rays from one point, and shadow
rays to a point light, whose bounds are seen from their ends (`wrt.kernels.traversal.packet.rays.reversed_bounds`). It must not
be larger than rounding makes it (`WIDEST`). The rays need one main axis in common. Others are tested by `PairForm.may_meet`.

**Exactness.** A pair is left out only if one area is below -e and another above e, where e bounds the difference to the areas
that the test computes. Let u = 2^-24; M the largest distance along an axis of a vertex from the point or an origin; h the
largest component of an edge; S the packet's slack, at least 16 u M; d >= S half the size of the box of the lines. To first
order in u:
* edges r - q are rounded by u h, vertices relative to the point by u M; so each coefficient, two products of an edge and a
  vertex, is off by 8 u h M, and the sum of three, with |s| <= 1, by 34 u h M in all, at most 2.2 S h;
* a line passes the point at a distance of at most 2 d, in the plane of the areas, whose edges are at most 2 h: 8 d h;
* a hit is accepted only if the ray meets the triangle's box, widened by its slack (`wrt.kernels.simd.boxes`). So its sheared
  vertices are at most D = 2 h + 3 S. Each is computed with an error of at most 3.1 u M + u D, and an area with one of
  12.4 u M D + 8 u D^2, at most 3.6 S h + 5.4 S^2.
The sum is less than e = 16 d (h + d). `TINY` is for products that underflow; packets whose coordinates are so large that
products might overflow are not tested this way (`LARGEST`).

References:
    K. Komatsu, Y. Kaeriyama, K. Suzuki, H. Takizawa, H. Kobayashi: A fast ray frustum-triangle intersection algorithm with
        precomputation and early termination. IPSJ Online Transactions 1, 2008.
    S. Woop, C. Benthin, I. Wald: Watertight ray/triangle intersection. Journal of Computer Graphics Techniques 2(1), 2013.
"""

WIDEST = 4.0
"""Greatest half size of the box through which all lines pass, as a multiple of the packet's slack."""

ERROR = 16.0
"""Factor of the bound e; see the module docstring."""

TINY = 1e-36
"""Added to e: much more than products lose that underflow."""

LARGEST = 1e12
"""Half sizes of the box above which products might overflow: those of a scene of 10^18 units."""

CONVERGING = f"""
    float edge_point[3], edge_half = 0.0f;  // all lines pass within edge_half of this point
    for (int a = 0; a < 3; ++a) {{
        const float in = bounds.origin_in.c[a], out = bounds.origin_out.c[a], half = 0.5f * WRT_ABS(in - out);
        edge_point[a] = 0.5f * (in + out);
        edge_half = half > edge_half ? half : edge_half;
    }}
    const bool converging = (bounds.passes & (bounds.passes - 1)) == 0 && edge_half <= {WIDEST!r}f * bounds.slack
        && edge_half < {LARGEST!r}f;
"""
"""C++: sets `converging`, whether the lines of the packet may be tested this way."""

EDGES = f"""
        const int z = bounds.passes == 1 ? 0 : bounds.passes == 2 ? 1 : 2, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
        const float from_x = edge_point[x], from_y = edge_point[y], from_z = edge_point[z];
        const float* first = &records.data[(size_t)block * (RECORD * W)];
        const float *first_x = first + x * W, *first_y = first + y * W, *first_z = first + z * W;
        alignas(4 * W) float edges[9][W], errors[W];
        WRT_FOR_LANES(i) {{
            const float px = first_x[i], qx = first_x[3 * W + i], rx = first_x[6 * W + i];
            const float py = first_y[i], qy = first_y[3 * W + i], ry = first_y[6 * W + i];
            const float pz = first_z[i], qz = first_z[3 * W + i], rz = first_z[6 * W + i];
            float size = 0.0f, ex, ey, ez, vx, vy, vz;
            WRT_EDGE(0, r, q, q) WRT_EDGE(3, p, r, r) WRT_EDGE(6, q, p, p)
            errors[i] = {ERROR!r}f * edge_half * (size + edge_half) + {TINY!r}f;
        }}
"""
"""C++: the coefficients of the W triangles of a block and their bounds e."""

MEETS = """
                    const vf sx = load(slope_x + f), sy = load(slope_y + f);
                    const vf a = sum_of_product(sx, (vf)a1, sum_of_product(sy, (vf)a2, (vf)a0));
                    const vf b = sum_of_product(sx, (vf)b1, sum_of_product(sy, (vf)b2, (vf)b0));
                    const vf c = sum_of_product(sx, (vf)c1, sum_of_product(sy, (vf)c2, (vf)c0));
                    const vf less = a < b ? a : b, more = a < b ? b : a;
                    const vf least = less < c ? less : c, most = more > c ? more : c;
                    const vi may_meet = ~((least < -error) & (most > error));
"""
"""C++: which of the rays from f on may meet the triangle of coefficients a0 .. c2."""

MACROS = """
#define WRT_WIDER(value) size = WRT_ABS(value) > size ? WRT_ABS(value) : size;
#define WRT_EDGE(n, to, from, at) \\
    ex = to##x - from##x; ey = to##y - from##y; ez = to##z - from##z; \\
    WRT_WIDER(ex) WRT_WIDER(ey) WRT_WIDER(ez) \\
    vx = at##x - from_x; vy = at##y - from_y; vz = at##z - from_z; \\
    edges[n][i] = ex * vy - ey * vx; edges[n + 1][i] = ey * vz - ez * vy; edges[n + 2][i] = ez * vx - ex * vz;
"""
"""C++ of `WRT_EDGE(n, to, from, at)`: the normal of the plane through the point and the edge, whose vertex is `at`."""

COEFFICIENTS = """
                const float a0 = edges[0][lane], a1 = edges[1][lane], a2 = edges[2][lane], b0 = edges[3][lane];
                const float b1 = edges[4][lane], b2 = edges[5][lane], c0 = edges[6][lane], c1 = edges[7][lane];
                const float c2 = edges[8][lane], error = errors[lane];
"""
"""C++: the coefficients of the triangle in a lane."""
