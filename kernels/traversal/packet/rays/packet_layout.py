"""Memory layout of a packet: one local array of components with P floats each, aligned to cache lines.

inverse_x, _y, _z    1 / direction
t_min                start of the ray's range
t                    best hit so far; before the first hit t_max; -inf for a ray that needs no more tests
primitive            bits of an int: triangle of the best hit, -1 before the first hit
u, v                 weights of the best hit
slope_x, _y          direction along the next two axes after the main one, in cyclic order, / direction along the main axis
main_axis            bits of an int: axis of the largest component of the direction
origin_x, _y, _z     relative to the scene's centre; absent if all rays share an origin (`PacketBounds.origin_low`)
slack                widening of boxes (`wrt.kernels.simd.boxes`); absent if all rays share an origin (`PacketBounds.slack`)
part                 bits of an int: part of a split packet that contains the ray (`packet_splitting`); absent likewise
kept                 the ray's t while the rays of another part are active; absent likewise
...                  per-ray data of the triangle test (`PacketForm.state`)
"""

from dataclasses import dataclass

from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

COMMON = ("inverse_x", "inverse_y", "inverse_z", "t_min", "t", "primitive", "u", "v", "slope_x", "slope_y", "main_axis")
"""Components of every packet."""

OWN_ORIGIN = ("origin_x", "origin_y", "origin_z", "slack", "part", "kept")
"""Further components of packets without a shared origin."""

_FIRST_ROW = f"(-((size_t)packet.data / 4) & {CACHE_LINE - 1})"


@dataclass(frozen=True)
class PacketLayout:
    """The layout of one kind of packet.

    Attributes:
        rays: P, a multiple of the width.
        width: W, lanes of a loop over rays, and triangles per block.
        shared_origin: whether all rays start at one point.
        triangle_test: key in `TRIANGLE_TESTS`.
    """

    rays: int
    width: int
    shared_origin: bool
    triangle_test: str

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the components, in order."""
        own = () if self.shared_origin else OWN_ORIGIN
        return COMMON + own + TRIANGLE_TESTS[self.triangle_test].packet_form.state

    @property
    def size(self) -> int:
        """Floats of a packet, including a cache line for alignment and what packets leave to the next."""
        return len(self.components) * self.rays + CACHE_LINE + 2

    @property
    def occluder(self) -> int:
        """Index of the last float, behind the components; used by `wrt.kernels.traversal.packet.leaves.occluder_cache`."""
        return self.size - 1

    @property
    def at_once(self) -> int:
        """Index of the third last float; used likewise."""
        return self.size - 3

    @property
    def usual_extent(self) -> int:
        """Index of the float before it; used by `wrt.kernels.traversal.packet.core.packet_splitting`."""
        return self.size - 2

    @property
    def constants(self) -> str:
        """C++ head of a native function: lane loop, `wrt_bits`, W, P, floats per triangle record, SHARED, INF."""
        record = TRIANGLE_TESTS[self.triangle_test].record.components
        sizes = f"    constexpr int W = {self.width}, P = {self.rays}, RECORD = {record};\n"
        shared = f"    constexpr bool SHARED = {str(self.shared_origin).lower()};\n"
        return sizes + shared + "    const float INF = __builtin_bit_cast(float, 0x7f800000);\n"

    @property
    def head(self) -> str:
        """`constants` for a function with a parameter `packet`, followed by a pointer to each component."""
        pointers = f"    float* rows = packet.data + {_FIRST_ROW};\n"
        pointers += "".join(f"    float* {name} = rows + {k} * P;\n" for k, name in enumerate(self.components))
        if self.shared_origin:
            pointers += "    float *origin_x = nullptr, *origin_y = nullptr, *origin_z = nullptr, *slack = nullptr;\n"
        return self.constants + pointers
