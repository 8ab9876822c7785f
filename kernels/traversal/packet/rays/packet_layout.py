"""Where a packet's numbers are: P floats a component, one component after another from a cache line on, in one local array.

inverse_x, _y, _z    1 / direction
t_min                where the ray starts
t                    its best hit so far; before the first its t_max; -inf for a ray that needs no more tests
primitive            bits of an int: the best hit's triangle, -1 before the first
u, v                 the best hit's weights
slope_x, _y          direction along the next two axes after the main one, in cyclic order, / direction along that
main_axis            bits of an int: the axis along which the direction is largest
origin_x, _y, _z     relative to the scene's centre; left out where all rays share one (`PacketBounds.origin_low`)
slack                widening of boxes (`wrt.kernels.simd.boxes`); left out likewise (`PacketBounds.slack`)
part                 bits of an int: which part of a packet that parted the ray is in (`parting`); left out likewise
kept                 its t while the rays of another part are active; left out likewise
...                  what the triangle test prepares per ray (`PacketForm.state`)
"""

from dataclasses import dataclass

import warp as wp

from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.simd.lanes import FOR_LANES, lane_bits
from wrt.kernels.triangle import TRIANGLE_TESTS

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

COMMON = ("inverse_x", "inverse_y", "inverse_z", "t_min", "t", "primitive", "u", "v", "slope_x", "slope_y", "main_axis")
OWN_ORIGIN = ("origin_x", "origin_y", "origin_z", "slack", "part", "kept")

_FIRST_ROW = f"(-((size_t)packet.data / 4) & {CACHE_LINE - 1})"


@wp.func_native(f"return (int){_FIRST_ROW};")
def first_row(packet: wp.array(dtype=float)) -> int:
    """Floats of a packet's memory before its first component."""
    ...


@dataclass(frozen=True)
class PacketLayout:
    """The layout of packets of one kind.

    Attributes:
        rays: P, a multiple of the width.
        width: W, lanes of a loop over rays, and triangles a block.
        shared_origin: whether all rays start at one point.
        triangle_test: key in `TRIANGLE_TESTS`.
    """

    rays: int
    width: int
    shared_origin: bool
    triangle_test: str

    @property
    def components(self) -> tuple[str, ...]:
        """Names, in order."""
        own = () if self.shared_origin else OWN_ORIGIN
        return COMMON + own + TRIANGLE_TESTS[self.triangle_test].packet_form.state

    @property
    def size(self) -> int:
        """Floats of a packet, and a cache line to begin at one."""
        return len(self.components) * self.rays + CACHE_LINE

    @property
    def occluder(self) -> int:
        """Index of the last of these floats, before which the components end:
        `wrt.kernels.traversal.packet.core.occluder_cache` has it."""
        return self.size - 1

    @property
    def constants(self) -> str:
        """C++ that opens a native function: the lane loop, `wrt_bits`, W, P, floats a triangle's record has, SHARED, INF."""
        record = TRIANGLE_TESTS[self.triangle_test].record.components
        sizes = f"    constexpr int W = {self.width}, P = {self.rays}, RECORD = {record};\n"
        shared = f"    constexpr bool SHARED = {str(self.shared_origin).lower()};\n"
        return FOR_LANES + sizes + lane_bits() + shared + "    const float INF = __builtin_bit_cast(float, 0x7f800000);\n"

    @property
    def head(self) -> str:
        """The same for a function with a parameter `packet`: a pointer for each component follows."""
        pointers = f"    float* rows = packet.data + {_FIRST_ROW};\n"
        pointers += "".join(f"    float* {name} = rows + {k} * P;\n" for k, name in enumerate(self.components))
        if self.shared_origin:
            pointers += "    float *origin_x = nullptr, *origin_y = nullptr, *origin_z = nullptr, *slack = nullptr;\n"
        return self.constants + pointers
