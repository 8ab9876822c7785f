"""The watertight test (`wrt.kernels.triangle.watertight.woop`) for packets: W rays, each with a triangle of its own, in vectors
(`wrt.kernels.simd.lane_vectors`), with the same results bit for bit.

Areas of 0 are recomputed only for rays that the signs leave inside: the sign of an area that is not 0 is exact, so that a ray
with areas of both signs is outside whatever a third area is.
"""

from wrt.kernels.triangle.support.lane_form import PairForm
from wrt.kernels.triangle.watertight.woop_areas import PRECISE_AREAS, THIN

_SHEARED = """
                vf ox, oy, oz;
                if (!SHARED) { ox = load(from_x + f); oy = load(from_y + f); oz = load(from_z + f); }
                auto corner = [&](int c, vf o) { const vf at = chosen(corners + c, which); return SHARED ? at : at - o; };
                const vf sx = load(slope_x + f), sy = load(slope_y + f);
                const vf pz = corner(z, oz), qz = corner(3 + z, oz), rz = corner(6 + z, oz);
                const vf px = corner(x, ox) - sx * pz, qx = corner(3 + x, ox) - sx * qz, rx = corner(6 + x, ox) - sx * rz;
                const vf py = corner(y, oy) - sy * pz, qy = corner(3 + y, oy) - sy * qz, ry = corner(6 + y, oy) - sy * rz;
"""

_EXACT = """
                if (bits_of(on_edge)) {
                    for (unsigned bits = bits_of(on_edge); bits; bits &= bits - 1u) {
                        const int i = wrt::lowest_bit(bits);
                        const float exact_a = (float)((double)rx[i] * qy[i] - (double)ry[i] * qx[i]);
                        const float exact_b = (float)((double)px[i] * ry[i] - (double)py[i] * rx[i]);
                        const float exact_c = (float)((double)qx[i] * py[i] - (double)qy[i] * px[i]);
                        const bool in = ((exact_a >= 0.0f) & (exact_b >= 0.0f) & (exact_c >= 0.0f))
                            | ((exact_a <= 0.0f) & (exact_b <= 0.0f) & (exact_c <= 0.0f));
                        a[i] = exact_a; b[i] = exact_b; c[i] = exact_c;
                        inside[i] = (in & ((exact_a + exact_b) + exact_c != 0.0f)) ? -1 : 0;
                    }
                }
"""

_THIN = f"""
                const vf size = (wrt_abs(rx * qy) + wrt_abs(px * ry)) + wrt_abs(qx * py);
                const vi thin = inside & (wrt_abs((a + b) + c) < {float(THIN)!r}f * size);
                for (unsigned bits = bits_of(thin); bits; bits &= bits - 1u) {{
                    const int i = wrt::lowest_bit(bits);
                    float fine_a = a[i], fine_b = b[i], fine_c = c[i];
                    wrt_precise_areas(px[i], py[i], qx[i], qy[i], rx[i], ry[i], fine_a, fine_b, fine_c);
                    a[i] = fine_a; b[i] = fine_b; c[i] = fine_c;
                }}
"""

PAIRS = PairForm(
    rays=PRECISE_AREAS
    + """
    auto wrt_abs = [](vf v) { return __builtin_elementwise_abs(v); };
    const float* const origins[3] = {origin_x, origin_y, origin_z};
    const int* axis = (const int*)main_axis;
""",
    axes="""
                const int z = pass, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
                const float *from_x = origins[x], *from_y = origins[y], *from_z = origins[z];
    """,
    may_meet="""
                    const vf ox = SHARED ? (vf)origin0[x] : load(from_x + f), oy = SHARED ? (vf)origin0[y] : load(from_y + f);
                    const vf oz = SHARED ? (vf)origin0[z] : load(from_z + f), sx = load(slope_x + f), sy = load(slope_y + f);
                    const vf pz = corner[z * W] - oz, qz = corner[(3 + z) * W] - oz, rz = corner[(6 + z) * W] - oz;
                    const vf px = (corner[x * W] - ox) - sx * pz, py = (corner[y * W] - oy) - sy * pz;
                    const vf qx = (corner[(3 + x) * W] - ox) - sx * qz, qy = (corner[(3 + y) * W] - oy) - sy * qz;
                    const vf rx = (corner[(6 + x) * W] - ox) - sx * rz, ry = (corner[(6 + y) * W] - oy) - sy * rz;
                    const vf a = rx * qy - ry * qx, b = px * ry - py * rx, c = qx * py - qy * px;
                    const vi outside = ((a < 0.0f) | (b < 0.0f) | (c < 0.0f)) & ((a > 0.0f) | (b > 0.0f) | (c > 0.0f));
                    const vi may_meet = ~outside & (load_ints(axis + f) == z);
    """,
    test=f"""{_SHEARED}
                vf a = rx * qy - ry * qx, b = px * ry - py * rx, c = qx * py - qy * px;
                vi inside = ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f));
                inside = inside & paired & (load_ints(axis + f) == z);
                const vi on_edge = inside & ((a == 0.0f) | (b == 0.0f) | (c == 0.0f));{_EXACT}
                if (!bits_of(inside)) continue;{_THIN}
                const vf scale = 1.0f / ((a + b) + c);
                vf at = load(shear_z + f) * (((a * pz + b * qz) + c * rz) * scale);
                const vf hit_u = b * scale, hit_v = c * scale;
    """,
)
"""W rays x a triangle for each."""
