"""The watertight test (`wrt.kernels.triangle.watertight.woop`) for the lanes of a stream: its rays, and 16 pairs of a ray and a
triangle.

The arithmetic is that of the test, bit for bit. Each lane has its own axis order, which is applied by selects.
"""

from wrt.kernels.triangle.watertight.woop_areas import IS_THIN, PRECISE_AREAS

INCLUSIVE_SIDE = """
            float a = (float)exact_a, b = (float)exact_b, c = (float)exact_c;
            bool inside = ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f));
            bool hit = inside & ((a + b) + c != 0.0f);
"""
"""C++: whether a triangle is hit, from its areas in float64, by the inclusive rule: a triangle contains its edges."""

PREPARE_LANES = """
    WRT_FOR(L, k) {
        const float x = dx[k], y = dy[k], z = dz[k], size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        const float px = ox[k], py = oy[k], pz = oz[k], jx = ix[k], jy = iy[k], jz = iz[k];
        const bool xy = size_x >= size_y, main_x = xy & (size_x >= size_z), main_y = !xy & (size_y >= size_z);
        const float major = main_x ? x : main_y ? y : z;
        words[14][k] = main_x ? py : main_y ? pz : px;
        words[15][k] = main_x ? pz : main_y ? px : py;
        words[16][k] = main_x ? px : main_y ? py : pz;
        ((int*)words[17])[k] = main_x ? 1 : main_y ? 2 : 0;
        ((int*)words[18])[k] = main_x ? 2 : main_y ? 0 : 1;
        ((int*)words[19])[k] = main_x ? 0 : main_y ? 1 : 2;
        words[20][k] = (main_x ? y : main_y ? z : x) / major;
        words[21][k] = (main_x ? z : main_y ? x : y) / major;
        words[22][k] = main_x ? jx : main_y ? jy : jz;
    }
"""
"""`prepare` for the rays of a stream."""


_SHEAR = "".join(
    f"""
            const float z{v} = along(i, {v}, 2) - oz;
            const float x{v} = (along(i, {v}, 0) - ox) - sx * z{v}, y{v} = (along(i, {v}, 1) - oy) - sy * z{v};
            x[{v}][i] = x{v}; y[{v}][i] = y{v}; depth[{v}][i] = z{v};"""
    for v in range(3)
)

CANDIDATE_LANES = f"""{PRECISE_AREAS}
        float x[3][L], y[3][L], depth[3][L], area[3][L];
        int hits[L], edges[L];
        const int* main_axis = (const int*)words[19];
        // selected bit by bit: of selects between loads, the compiler makes gathers from selected addresses
        auto along = [&](int i, int vertex, int turn) {{
            const int x_first = main_axis[i] == 0 ? -1 : 0, y_first = main_axis[i] == 1 ? -1 : 0;
            const int same = __builtin_bit_cast(int, corner[3 * vertex + turn][i]) & ~(x_first | y_first);
            const int next = __builtin_bit_cast(int, corner[3 * vertex + (turn + 1) % 3][i]) & x_first;
            const int last = __builtin_bit_cast(int, corner[3 * vertex + (turn + 2) % 3][i]) & y_first;
            return __builtin_bit_cast(float, same | next | last);
        }};
        WRT_FOR_LANES(i) {{
            const float ox = words[14][i], oy = words[15][i], oz = words[16][i];
            const float sx = words[20][i], sy = words[21][i];{_SHEAR}
            const float a = x2 * y1 - y2 * x1, b = x0 * y2 - y0 * x2, c = x1 * y0 - y1 * x0;
            area[0][i] = a; area[1][i] = b; area[2][i] = c;
            hits[i] = (((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f))) ? -1 : 0;
            const float size = (WRT_ABS(x2 * y1) + WRT_ABS(x0 * y2)) + WRT_ABS(x1 * y0);
            edges[i] = ((a == 0.0f) | (b == 0.0f) | (c == 0.0f) | ((hits[i] != 0) & ({IS_THIN}))) ? -1 : 0;
        }}
        for (unsigned left = wrt::bits<L>(edges); left; left &= left - 1u) {{
            const int i = wrt::lowest_bit(left);
            if (area[0][i] != 0.0f && area[1][i] != 0.0f && area[2][i] != 0.0f) {{
                wrt_precise_areas(x[0][i], y[0][i], x[1][i], y[1][i], x[2][i], y[2][i], area[0][i], area[1][i], area[2][i]);
                continue;
            }}
            const double px = x[0][i], qx = x[1][i], rx = x[2][i], py = y[0][i], qy = y[1][i], ry = y[2][i];
            const double exact_a = rx * qy - ry * qx, exact_b = px * ry - py * rx, exact_c = qx * py - qy * px;
            {INCLUSIVE_SIDE}
            area[0][i] = a; area[1][i] = b; area[2][i] = c;
            hits[i] = hit ? -1 : 0;
        }}
        WRT_FOR_LANES(i) {{
            const float a = area[0][i], b = area[1][i], c = area[2][i], scale = 1.0f / ((a + b) + c);
            const float at = words[22][i] * (((a * depth[0][i] + b * depth[1][i]) + c * depth[2][i]) * scale);
            t[i] = hits[i] ? at : WRT_NAN;
            u[i] = b * scale;
            v[i] = c * scale;
        }}
"""
"""`intersect` for the candidates of a stream."""
