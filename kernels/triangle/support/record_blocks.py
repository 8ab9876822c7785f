"""Per-triangle data in blocks of W triangles, structure of arrays: component by component, W lanes each.

A block is `components * W` floats: `records[(block * components + component) * W + lane]`. Unused lanes of a last
block hold NaN, which every test turns into a miss, and primitive -1.

The first nine components are the vertices, relative to the scene's centre: ax ay az bx by bz cx cy cz. Every test has them,
because the consistency rule (`wrt.kernels.simd.boxes`) needs the triangle's box, and packets read them before they test. The
values that a test precomputes follow them.
"""

from dataclasses import dataclass
from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import max_of, min_of
from wrt.kernels.simd.lanes import lanes

VERTEX_COMPONENTS = 9


@wp.struct
class TriangleBlocks:
    """Triangles in the order in which the leaves of a tree, or brute force, test them."""

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
    """Per-triangle data of a triangle test.

    Attributes:
        own: number of floats that the test precomputes; 0 for a test that reads the vertices.
        derive: `wp.func(corners, origin) -> vector of own floats` that computes them.
        per_origin: whether they depend on `origin`, the common origin of all rays; otherwise `origin` is ignored.
    """

    own: int = 0
    derive: wp.Function | None = None
    per_origin: bool = False

    @property
    def components(self) -> int:
        """Floats per triangle in a block."""
        return VERTEX_COMPONENTS + self.own

    @property
    def test_bytes(self) -> int:
        """Bytes per triangle that the test itself reads."""
        return 4 * (self.own or VERTEX_COMPONENTS)

    @property
    def load(self) -> wp.Function:
        """`wp.func(records, slot, width)` that returns the triangle's data: `Corners`, or a vector of `own` floats."""
        return load_own(self.own) if self.own else load_corners(self.components)


VERTICES = Record()
"""The three vertices: 36 bytes per triangle, nothing precomputed."""


@cache
def load_corners(components: int) -> wp.Function:
    """`wp.func(records, slot, width) -> Corners`, without the index checks of `records[...]`, for innermost loops."""

    @wp.func_native(f"""
        const float* r = &records.data[(size_t)(slot / width) * {components} * width + slot % width];
        float* to = (float*)&corners;
        for (int c = 0; c < {VERTEX_COMPONENTS}; ++c) to[c] = r[c * width];
    """)
    def load_vertices(records: wp.array(dtype=float), slot: int, width: int, corners: wp.ref[Corners]): ...

    @wp.func
    def load(records: wp.array(dtype=float), slot: int, width: int):
        corners = Corners()
        load_vertices(records, slot, width, corners)
        return corners

    return load


@cache
def load_own(own: int) -> wp.Function:
    """`wp.func(records, slot, width) -> vector`: the precomputed values, also without index checks."""
    Own = wp.types.vector(length=own, dtype=wp.float32)

    @wp.func_native(f"""
        constexpr int components = {VERTEX_COMPONENTS + own};
        const float* r = &records.data[(size_t)(slot / width) * components * width + slot % width];
        for (int c = 0; c < {own}; ++c) values.c[c] = r[({VERTEX_COMPONENTS} + c) * width];
    """)
    def load_values(records: wp.array(dtype=float), slot: int, width: int, values: wp.ref[Own]): ...

    @wp.func
    def load(records: wp.array(dtype=float), slot: int, width: int):
        values = Own()
        load_values(records, slot, width, values)
        return values

    return load


@wp.func
def corners_low(corners: Corners):
    """Lower corner of a triangle's exact box."""
    return min_of(corners.a, min_of(corners.b, corners.c))


@wp.func
def corners_high(corners: Corners):
    """Upper corner of a triangle's exact box."""
    return max_of(corners.a, max_of(corners.b, corners.c))


def native_block_test(ray_state: type, width: int, code: str) -> wp.Function:
    """`wp.func(records, block, ray, t, u, v) -> mask` of C++ that uses `triangle.h`."""
    Lanes, RayState = lanes(width), ray_state

    @native.func_native("triangle.h", code)
    def block_test(
        records: wp.array(dtype=float),
        block: int,
        ray: RayState,
        t: wp.ref[Lanes],
        u: wp.ref[Lanes],
        v: wp.ref[Lanes],
    ) -> wp.uint32: ...

    return block_test
