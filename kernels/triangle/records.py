"""Per-triangle data in blocks of W triangles, structure of arrays: component by component, W lanes each.

A block is `components * W` floats: `records[(block * components + component) * W + lane]`. Unused lanes of a last
block hold NaN, which every test turns into a miss, and primitive -1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from wrt.kernels.boxes import greatest, least

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class TriangleBlocks:
    """Triangles in the order in which a tree's leaves, or brute force, test them."""

    records: wp.array(dtype=float)
    """(blocks * components * W,) the test's records."""
    primitive: wp.array(dtype=int)
    """(blocks * W,) primitive ids; -1 in unused lanes."""


@wp.struct
class Corners:
    """A triangle's vertices, relative to the scene's centre."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3


@dataclass(frozen=True)
class Record:
    """How a triangle test stores a triangle.

    Attributes:
        components: floats a triangle.
        pack: `wp.func(records, slot, width, corners, origin)` that writes the record of one triangle; slot = block * W + lane.
        load: `wp.func(records, slot, width)` that reads one record back, as the struct that the test's scalar form takes.
        box_low, box_high: `wp.func(loaded)`: the corners of the triangle's exact bounding box.
        lane_box: C++ that sets `low[3]`, `high[3]` to that box for lane i of the block that begins at `r`.
        per_origin: whether a record depends on `origin`, the point at which all rays start; if not, it is ignored.

    The first nine components are the vertices, ax ay az bx by bz cx cy cz, which packets read for their cullings.
    """

    components: int
    pack: wp.Function
    load: wp.Function
    box_low: wp.Function
    box_high: wp.Function
    lane_box: str
    per_origin: bool = False


@wp.func
def pack_corners(records: wp.array(dtype=float), slot: int, width: int, corners: Corners, origin: wp.vec3):
    """Layout: ax ay az bx by bz cx cy cz."""
    first = (slot / width) * 9 * width + slot % width
    for axis in range(3):
        records[first + axis * width] = corners.a[axis]
        records[first + (3 + axis) * width] = corners.b[axis]
        records[first + (6 + axis) * width] = corners.c[axis]


@wp.func_native("""
    const float* r = &records.data[(size_t)(slot / width) * 9 * width + slot % width];
    return wp::vec3(r[3 * vertex * width], r[(3 * vertex + 1) * width], r[(3 * vertex + 2) * width]);
""")
def load_vertex(records: wp.array(dtype=float), slot: int, width: int, vertex: int) -> wp.vec3:
    """One vertex of a triangle, without the index checks of `records[...]`: this is in the innermost loop."""
    ...


@wp.func
def load_corners(records: wp.array(dtype=float), slot: int, width: int):
    """The vertices as `pack_corners` stored them."""
    corners = Corners()
    corners.a = load_vertex(records, slot, width, 0)
    corners.b = load_vertex(records, slot, width, 1)
    corners.c = load_vertex(records, slot, width, 2)
    return corners


@wp.func
def corners_low(corners: Corners):
    return least(corners.a, least(corners.b, corners.c))


@wp.func
def corners_high(corners: Corners):
    return greatest(corners.a, greatest(corners.b, corners.c))


CORNER_BOX = """
        for (int a = 0; a < 3; ++a) {
            const float p = r[a * W + i], q = r[(3 + a) * W + i], s = r[(6 + a) * W + i];
            const float least = q < s ? q : s, most = q > s ? q : s;
            low[a] = p < least ? p : least; high[a] = p > most ? p : most;
        }
"""

CORNERS = Record(9, pack_corners, load_corners, corners_low, corners_high, CORNER_BOX)
"""The three vertices as they are: 36 bytes a triangle, nothing precomputed."""


@dataclass(frozen=True)
class CrossingForms:
    """The forms of a test by which a ray crosses a surface once at an edge or a vertex: it hits one of the triangles there.

    Attributes:
        intersect: as `TriangleTest.intersect`.
        block_test: as `TriangleTest.block_test`.
    """

    intersect: wp.Function
    block_test: Callable[[int], wp.Function]


@dataclass(frozen=True)
class PacketForm:
    """W rays x one triangle: pieces of C++ that `wrt.kernels.packet` puts into its lane loops.

    Free variables: `k` is the ray's number in the packet, `i` = k - f its lane, `corner` points at the record of the
    triangle, whose component c is `corner[c * W]`; `SHARED`, `origin0`, `origin_x` .. `origin_z` and the test's own
    components as in `wrt.kernels.packet.layout`; `bounds` are the packet's.

    Attributes:
        state: names of the components that the test keeps per ray.
        passes: 1, or 3 for one pass over the rays of each main axis (bit `pass` of `bounds.passes` tells which occur).
        prepare: per ray, from direction x, y, z, inverse ix, iy, iz, slopes sx, sy and `main_x`, `main_y`: the state.
        triangle: once a triangle and pass.
        inside: for the W rays from f on: declares `int inside[W]`, nonzero where the ray's line meets the triangle, and
            goes on with `continue` if it meets none.
        hit: per ray, sets `at`, `hit_u`, `hit_v`.
    """

    state: tuple[str, ...]
    passes: int
    prepare: str
    triangle: str
    inside: str
    hit: str
