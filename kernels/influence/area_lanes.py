"""Lane loops that assign rays to influence areas, 16 rays at a time.

A block of 16 rays is two local arrays. `lanes` has rows of floats (origin, direction, t_min, t_max, leave) and the six bounds
of the box around the origins. `marks` has rows of ints: the area found (-1 for none), the list of the octree leaf that contains
the origin (-1 for rays that belong to no area), and four sums over all blocks. Lanes are float32; a scalar float64 loop takes
as long as tracing the rays (notebooks/records/2026-11-21-single-rays.md).

**Precision.** The faces of a region are moved outward by the rounding error of an origin. The t at which a ray leaves has an
error of a few roundings of the distance. Both errors are far smaller than the margin of the areas' trees
(`wrt.kernels.influence.area_assignment`).
"""

import warp as wp

from wrt.kernels.influence.region_tests import Region
from wrt.kernels.influence.view import AreaView
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES
from wrt.kernels.traversal.stream.stream_load import RAYS_TO_LANES, VALID_LANE

exact_module(__name__)

LANE_WORDS = wp.constant(9 * LIST_LANES + 6)
"""Number of elements of `lanes`."""

MARK_WORDS = wp.constant(6 * LIST_LANES)
"""Number of elements of `marks`."""

_BLOCK = f"""
    constexpr int L = {LIST_LANES};
    const float INF = __builtin_bit_cast(float, 0x7f800000);
    float *ox = lanes.data, *oy = ox + L, *oz = oy + L, *dx = oz + L, *dy = dx + L, *dz = dy + L;
    float *t_min = dz + L, *t = t_min + L, *leave = t + L;
    int *found = marks.data, *list = found + L, *left = list + L, *most = left + L, *fewest = most + L;
    int* alone = fewest + L;
    (void)ox; (void)oy; (void)oz; (void)dx; (void)dy; (void)dz; (void)t_min; (void)t; (void)leave; (void)list; (void)INF;
    (void)found; (void)left; (void)most; (void)fewest; (void)alone;
"""


@native.func_native(
    "ray.h",
    f"""{_BLOCK}
    const int here = count < L ? count : L;
    {RAYS_TO_LANES}
    float low_x[L], low_y[L], low_z[L], high_x[L], high_y[L], high_z[L];
    WRT_FOR(L, k) {{ {VALID_LANE}
        found[k] = -1; leave[k] = INF; list[k] = valid ? 0 : -1;
        low_x[k] = valid ? px : INF; low_y[k] = valid ? py : INF; low_z[k] = valid ? pz : INF;
        high_x[k] = valid ? px : -INF; high_y[k] = valid ? py : -INF; high_z[k] = valid ? pz : -INF;
    }}
    for (int half = L / 2; half > 0; half /= 2) for (int k = 0; k < half; ++k) {{
        low_x[k] = low_x[k] < low_x[k + half] ? low_x[k] : low_x[k + half];
        low_y[k] = low_y[k] < low_y[k + half] ? low_y[k] : low_y[k + half];
        low_z[k] = low_z[k] < low_z[k + half] ? low_z[k] : low_z[k + half];
        high_x[k] = high_x[k] > high_x[k + half] ? high_x[k] : high_x[k + half];
        high_y[k] = high_y[k] > high_y[k + half] ? high_y[k] : high_y[k + half];
        high_z[k] = high_z[k] > high_z[k + half] ? high_z[k] : high_z[k + half];
    }}
    float* box = lanes.data + 9 * L;
    box[0] = low_x[0]; box[1] = low_y[0]; box[2] = low_z[0]; box[3] = high_x[0]; box[4] = high_y[0]; box[5] = high_z[0];
    return here;
""",
)
def load_block(batch: RayBatch, first: int, count: int, lanes: wp.array(dtype=float), marks: wp.array(dtype=int)) -> int:
    """Loads up to `count` rays from `first` on, with list 0, and bounds their origins; returns the number of rays."""
    ...


@native.func_native(
    "lanes.h",
    f"""{_BLOCK}
    const float rx = region.right.c[0], ry = region.right.c[1], rz = region.right.c[2];
    const float ux = region.up.c[0], uy = region.up.c[1], uz = region.up.c[2];
    const float fx = region.forward.c[0], fy = region.forward.c[1], fz = region.forward.c[2];
    const float qx = region.origin.c[0], qy = region.origin.c[1], qz = region.origin.c[2];
    const float near = region.near, far = region.far, width = region.width, height = region.height;
    const float widening = region.widening, heightening = region.heightening;
    const float ex = view.eye.c[0], ey = view.eye.c[1], ez = view.eye.c[2];
    const float ax = view.forward.c[0], ay = view.forward.c[1], az = view.forward.c[2];
    const float bound = sine * sine, at_eye = touch * touch;
    const bool radial = view.radial;
    WRT_FOR(L, k) {{
        const float px = ox[k] - qx, py = oy[k] - qy, pz = oz[k] - qz, vx = dx[k], vy = dy[k], vz = dz[k];
        const float x = rx * px + ry * py + rz * pz, y = ux * px + uy * py + uz * pz, z = fx * px + fy * py + fz * pz;
        const float wide = width + z * widening, tall = height + z * heightening;
        const bool inside = (z >= near) & (z <= far) & (WRT_ABS(x) <= wide) & (WRT_ABS(y) <= tall);
        const float sx = ox[k] - ex, sy = oy[k] - ey, sz = oz[k] - ez, start = sx * sx + sy * sy + sz * sz;
        const float lx = radial ? sx : ax, ly = radial ? sy : ay, lz = radial ? sz : az;
        const float cx = ly * vz - lz * vy, cy = lz * vx - lx * vz, cz = lx * vy - ly * vx;
        const float lengths = (lx * lx + ly * ly + lz * lz) * (vx * vx + vy * vy + vz * vz);
        const bool along = (lengths > 0.0f) & (lengths < INF) & (cx * cx + cy * cy + cz * cz <= bound * lengths);
        const float right = rx * vx + ry * vy + rz * vz, up = ux * vx + uy * vy + uz * vz, ahead = fx * vx + fy * vy + fz * vz;
        const float spread = ahead * widening, rise = ahead * heightening;
        float until = INF, rate, s;
        rate = ahead; s = (far - z) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        rate = -ahead; s = (z - near) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        rate = right - spread; s = (wide - x) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        rate = -right - spread; s = (wide + x) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        rate = up - rise; s = (tall - y) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        rate = -up - rise; s = (tall + y) / rate; until = ((rate > 0.0f) & (s < until)) ? s : until;
        const bool belongs = inside & (along | (radial & (start <= at_eye))) & (until > t_min[k])
            & (list[k] == which) & (found[k] < 0);
        found[k] = belongs ? number : found[k];
        leave[k] = belongs ? until : leave[k];
    }}
""",
)
def try_area(
    number: int,
    region: Region,
    view: AreaView,
    sine: float,
    touch: float,
    which: int,
    lanes: wp.array(dtype=float),
    marks: wp.array(dtype=int),
):
    """Assigns area `number` to the rays of list `which` that have no area yet and are affine to it.

    A ray is affine if it starts in the region, if its direction agrees with the area's distribution (forward or backward; in
    radial areas a ray that starts at the common point always agrees), and if part of its range lies in the region.
    """
    ...


@native.func_native(
    "lanes.h",
    f"""{_BLOCK}
    WRT_FOR(L, k) {{
        // in a plane of the box, 0 * inf is NaN: such a ray has no hits, as the corners are beyond them
        const float ix = 1.0f / dx[k], iy = 1.0f / dy[k], iz = 1.0f / dz[k];
        float a = (high.c[0] - ox[k]) * ix, b = (low.c[0] - ox[k]) * ix, until = a > b ? a : b, s;
        a = (high.c[1] - oy[k]) * iy; b = (low.c[1] - oy[k]) * iy; s = a > b ? a : b; until = s < until ? s : until;
        a = (high.c[2] - oz[k]) * iz; b = (low.c[2] - oz[k]) * iz; s = a > b ? a : b; until = s < until ? s : until;
        const bool done = (leave[k] >= t[k]) | (leave[k] >= until);
        leave[k] = (done & (found[k] >= 0)) ? INF : leave[k];
        found[k] = found[k] < 0 ? areas : found[k];
        alone[k] += ((found[k] == areas) & (k < count)) ? 1 : 0;
        left[k] += ((found[k] < areas) & !done & (k < count)) ? 1 : 0;
        most[k] = found[k] > most[k] ? found[k] : most[k];
        fewest[k] = areas - found[k] > fewest[k] ? areas - found[k] : fewest[k];
    }}
    if (count == L) {{
        WRT_FOR(L, k) area.data[first + k] = (unsigned short)found[k];
        WRT_FOR(L, k) cut.data[first + k] = found[k] == areas ? -1.0f : leave[k] < t[k] ? leave[k] : t[k];
        WRT_FOR(L, k) rest.data[first + k] = found[k] == areas ? t_min[k] : leave[k];
    }} else WRT_SCALAR for (int k = 0; k < count; ++k) {{
        area.data[first + k] = (unsigned short)found[k];
        cut.data[first + k] = found[k] == areas ? -1.0f : leave[k] < t[k] ? leave[k] : t[k];
        rest.data[first + k] = found[k] == areas ? t_min[k] : leave[k];
    }}
""",
)
def store_block(
    first: int,
    count: int,
    areas: int,
    low: wp.vec3,
    high: wp.vec3,
    lanes: wp.array(dtype=float),
    marks: wp.array(dtype=int),
    area: wp.array(dtype=wp.uint16),
    cut: wp.array(dtype=float),
    rest: wp.array(dtype=float),
):
    """Writes where the rays are split (`wrt.kernels.influence.area_assignment.assign_rays`) and adds them to the sums of the
    lanes."""
    ...


@native.func_native(
    "lanes.h",
    f"""{_BLOCK}
    int sums[4] = {{}};
    for (int k = 0; k < L; ++k) {{
        sums[0] += left[k];
        sums[1] = most[k] > sums[1] ? most[k] : sums[1];
        sums[2] = fewest[k] > sums[2] ? fewest[k] : sums[2];
        sums[3] += alone[k];
    }}
    return wp::vec4i(sums[0], sums[1], sums[2], sums[3]);
""",
)
def sum_blocks(lanes: wp.array(dtype=float), marks: wp.array(dtype=int)) -> wp.vec4i:
    """Sums over all stored rays.

    Returns (rays that leave their area before they end, greatest area, `areas` less the least area, rays without an area).
    """
    ...
