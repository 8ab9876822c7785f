"""The watertight test (`wrt.kernels.triangle.watertight.woop`) for packets: W rays x one triangle, with the same results bit
for bit."""

from wrt.kernels.triangle.support.lane_form import PacketForm
from wrt.kernels.triangle.watertight.woop_areas import AREAS_SIZE, IS_THIN, PRECISE_AREAS
from wrt.kernels.triangle.watertight.woop_pairs import PAIRS

PACKET = PacketForm(
    state=("shear_z",),
    passes=3,
    prepare="shear_z[k] = main_x ? ix : main_y ? iy : iz;",
    triangle=PRECISE_AREAS
    + """
            const int z = pass, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
            const float ax = corner[x * W], ay = corner[y * W], az = corner[z * W];
            const float bx = corner[(3 + x) * W], by = corner[(3 + y) * W], bz = corner[(3 + z) * W];
            const float cx = corner[(6 + x) * W], cy = corner[(6 + y) * W], cz = corner[(6 + z) * W];
            const float *from_x = x == 0 ? origin_x : x == 1 ? origin_y : origin_z;
            const float *from_y = y == 0 ? origin_x : y == 1 ? origin_y : origin_z;
            const float *from_z = z == 0 ? origin_x : z == 1 ? origin_y : origin_z;
            const float from_x0 = origin0[x], from_y0 = origin0[y], from_z0 = origin0[z];
            const int* axis = (const int*)main_axis;
    """,
    inside="""
                alignas(4 * W) int inside[W];
                alignas(4 * W) float area_a[W], area_b[W], area_c[W], sizes[W];
                int some = 0, edges = 0;
                auto shear = [&](int i, float& px, float& py, float& qx, float& qy, float& rx, float& ry) {
                    const int k = f + i;
                    const float ox = SHARED ? from_x0 : from_x[k], oy = SHARED ? from_y0 : from_y[k],
                                oz = SHARED ? from_z0 : from_z[k];
                    const float pz = az - oz, qz = bz - oz, rz = cz - oz, sx = slope_x[k], sy = slope_y[k];
                    px = (ax - ox) - sx * pz, qx = (bx - ox) - sx * qz, rx = (cx - ox) - sx * rz;
                    py = (ay - oy) - sy * pz, qy = (by - oy) - sy * qz, ry = (cy - oy) - sy * rz;
                };
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    float px, py, qx, qy, rx, ry;
                    shear(i, px, py, qx, qy, rx, ry);
                    const float a = rx * qy - ry * qx, b = px * ry - py * rx, c = qx * py - qy * px;
                    area_a[i] = a; area_b[i] = b; area_c[i] = c; sizes[i] = AREAS_SIZE;
                    const bool in = ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f));
                    const bool on_edge = (a == 0.0f) | (b == 0.0f) | (c == 0.0f);
                    inside[i] = (in & (axis[k] == z)) ? 1 : 0;
                    some |= inside[i];
                    edges |= on_edge ? 1 : 0;
                }
                if (edges) {
                    some = 0;
                    for (int i = 0; i < W; ++i) {
                        const int k = f + i;
                        if (area_a[i] == 0.0f || area_b[i] == 0.0f || area_c[i] == 0.0f) {
                            float px, py, qx, qy, rx, ry;
                            shear(i, px, py, qx, qy, rx, ry);
                            const float a = (float)((double)rx * qy - (double)ry * qx);
                            const float b = (float)((double)px * ry - (double)py * rx);
                            const float c = (float)((double)qx * py - (double)qy * px);
                            area_a[i] = a; area_b[i] = b; area_c[i] = c;
                            const bool in = ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f))
                                | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f));
                            inside[i] = (in & ((a + b) + c != 0.0f) & (axis[k] == z)) ? 1 : 0;
                        }
                        some |= inside[i];
                    }
                }
                if (!some) continue;
                alignas(4 * W) int thin[W];
                int some_thin = 0;
                WRT_FOR_LANES(i) {
                    const float a = area_a[i], b = area_b[i], c = area_c[i], size = sizes[i];
                    thin[i] = (IS_THIN) ? inside[i] : 0;
                    some_thin |= thin[i];
                }
                if (some_thin) for (int i = 0; i < W; ++i) {
                    if (!thin[i]) continue;
                    float px, py, qx, qy, rx, ry;
                    shear(i, px, py, qx, qy, rx, ry);
                    wrt_precise_areas(px, py, qx, qy, rx, ry, area_a[i], area_b[i], area_c[i]);
                }
    """.replace("AREAS_SIZE", AREAS_SIZE).replace("IS_THIN", IS_THIN),
    hit="""
                    const float from = SHARED ? from_z0 : from_z[k], sz = shear_z[k];
                    const float scale = 1.0f / ((area_a[i] + area_b[i]) + area_c[i]);
                    at = sz * (((area_a[i] * (az - from) + area_b[i] * (bz - from)) + area_c[i] * (cz - from)) * scale);
                    hit_u = area_b[i] * scale;
                    hit_v = area_c[i] * scale;
    """,
    ray="""
    const float* origins[3] = {origin_x, origin_y, origin_z};
    ray.z = ((const int*)main_axis)[k]; ray.x = ray.z == 2 ? 0 : ray.z + 1; ray.y = ray.x == 2 ? 0 : ray.x + 1;
    const int axes[3] = {ray.x, ray.y, ray.z};
    for (int a = 0; a < 3; ++a) ray.origin.c[a] = SHARED ? origin0[axes[a]] : origins[axes[a]][k];
    ray.shear = wp::vec3(slope_x[k], slope_y[k], shear_z[k]);
    """,
    pairs=PAIRS,
    certain=True,
)
"""W rays x one triangle: the same arithmetic, with one pass for each main axis that occurs among the rays."""
