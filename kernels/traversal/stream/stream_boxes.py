"""Boxes around the rays of a stream, from origin to end, which tell that most short rays meet nothing.

**Problem.** Most of the short rays in an open scene, such as those of ambient occlusion, meet no child of the root. Before that
is known, each of them is prepared, with three divisions, and tested against all children. The few rays of a group that stay
then leave most lanes idle.

**Idea.** Compare the box around each ray with the boxes of the children: six comparisons for 16 rays and a child. Rays whose
box meets none are done. The others wait until there are 16 of them, which are then prepared, tested and stored together.

Long rays meet most boxes. If more than `MANY` rays of a group of 16 stay, the next `PAUSE` groups are not compared, nor do they
wait.

**Exactness.** A hit is a point origin + t direction within the slack of its triangle's box. The rays' boxes are widened by that
and by the rounding of their ends, as in `wrt.kernels.traversal.packet.rays.reversed_bounds`. NaN meets every box.

Figures: notebooks/records/2026-11-26-joined-packets.md.
"""

from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.reversed_bounds import ENDS_ERROR
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES
from wrt.kernels.traversal.stream.stream_lanes import NONE

MANY = 12
"""Rays of a group of 16 whose box meets a child, so that the next boxes will not pay."""

PAUSE = 15
"""Groups for which they are left out."""

ROWS = 9
"""Numbers of a waiting ray: origin, direction, number, t_min, t."""

ROOM = 2 * LIST_LANES
"""Waiting rays: less than a group, and the next group."""

BOX_MEMORY = ROWS * ROOM
"""Floats of memory for them."""


def has_boxes(width: int, order: int) -> bool:
    """Whether boxes are compared: where a comparison of 16 lanes is one instruction with a mask, for queries that need no order
    of children. With eight lanes it costs as much as it saves."""
    return width == LIST_LANES and order == NONE


BOX_CONSTANTS = f"""
    constexpr int ROWS = {ROWS}, ROOM = {ROOM}, MANY = {MANY}, PAUSE = {PAUSE};
    constexpr float ERROR = {3.0 * SLACK + ENDS_ERROR!r}f;
"""

BOXES = """
    int own_number[L];
    WRT_FOR(L, k) own_number[k] = place + k;
    float* const lanes_of[ROWS] = {ox, oy, oz, dx, dy, dz, (float*)own_number, t_min, t};
    float* const waiting = lanes.data + (W + 1) * L;
    bool waits = count == 0;
    if (count > 0 && state.unboxed > 0) --state.unboxed;
    else if (count > 0) {
        float from_x[L], from_y[L], from_z[L], to_x[L], to_y[L], to_z[L];
        int reaches[L];
        float scene = 0.0f;
        WRT_UNROLLED for (int a = 0; a < 3; ++a) {
            scene = WRT_ABS(low.c[a]) > scene ? WRT_ABS(low.c[a]) : scene;
            scene = WRT_ABS(high.c[a]) > scene ? WRT_ABS(high.c[a]) : scene;
        }
        WRT_FOR(L, k) {
            const float ax = ox[k], ay = oy[k], az = oz[k];
            const float bx = ax + t[k] * dx[k], by = ay + t[k] * dy[k], bz = az + t[k] * dz[k];
            float size = WRT_ABS(ax), f;
            f = WRT_ABS(ay); size = f > size ? f : size; f = WRT_ABS(az); size = f > size ? f : size;
            f = WRT_ABS(bx); size = f > size ? f : size; f = WRT_ABS(by); size = f > size ? f : size;
            f = WRT_ABS(bz); size = f > size ? f : size;
            const float wide = ERROR * (size + scene);
            from_x[k] = (ax < bx ? ax : bx) - wide; to_x[k] = (ax > bx ? ax : bx) + wide;
            from_y[k] = (ay < by ? ay : by) - wide; to_y[k] = (ay > by ? ay : by) + wide;
            from_z[k] = (az < bz ? az : bz) - wide; to_z[k] = (az > bz ? az : bz) + wide;
            reaches[k] = 0;
        }
        for (unsigned left = state.used; left; left &= left - 1u) {
            const int c = wrt_lowest_bit(left);
            const float low_x = bounds.data[c], low_y = bounds.data[W + c], low_z = bounds.data[2 * W + c];
            const float high_x = bounds.data[3 * W + c], high_y = bounds.data[4 * W + c], high_z = bounds.data[5 * W + c];
            WRT_FOR(L, k) {
                reaches[k] |= (!(from_x[k] > high_x) & !(to_x[k] < low_x) & !(from_y[k] > high_y) & !(to_y[k] < low_y)
                    & !(from_z[k] > high_z) & !(to_z[k] < low_z)) ? -1 : 0;
            }
        }
        if (wrt_count_bits(wrt_bits(reaches)) > MANY) state.unboxed = PAUSE;
        WRT_FOR(L, k) stored[k] &= reaches[k];
        const unsigned bits = wrt_bits(stored) & ((1u << here) - 1u);
        int* const to = (int*)waiting + state.waiting;
        WRT_UNROLLED for (int row = 0; row < ROWS; ++row) wrt_append(to + row * ROOM, (const int*)lanes_of[row], bits);
        state.waiting += wrt_count_bits(bits);
        waits = true;
    }
    if (waits) {
        if (state.waiting < L && count > 0) return 0;
        here = state.waiting < L ? state.waiting : L;
        state.waiting -= here;
        WRT_UNROLLED for (int row = 0; row < ROWS; ++row) {
            float* const from = waiting + row * ROOM;
            WRT_FOR(L, k) lanes_of[row][k] = from[k];
            WRT_FOR(L, k) from[k] = from[L + k];
        }
        WRT_FOR(L, k) stored[k] = k < here ? -1 : 0;
    }
"""
"""C++ after `BOX_CONSTANTS` and `wrt.kernels.traversal.stream.stream_load.FETCH`: compares the rays in lanes and lets them
wait; then the lanes hold rays that have waited, and `own_number` their numbers. Returns 0 while these are not enough.
state: see `wrt.kernels.traversal.stream.stream_root.RootLoad`."""
