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
from wrt.kernels.triangle import TRIANGLE_TESTS

COMMON = ("inverse_x", "inverse_y", "inverse_z", "t_min", "t", "primitive", "u", "v", "slope_x", "slope_y", "main_axis")
"""Components of every packet."""

OWN_ORIGIN = ("origin_x", "origin_y", "origin_z", "slack", "part", "kept")
"""Further components of packets without a shared origin."""


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
        """Index of the second last float; used by `wrt.kernels.traversal.packet.core.packet_splitting`."""
        return self.size - 2

    @property
    def record(self) -> int:
        """Floats of a triangle in a block."""
        return TRIANGLE_TESTS[self.triangle_test].record.components

    @property
    def passes(self) -> int:
        """Passes over the rays that the triangle test needs."""
        return TRIANGLE_TESTS[self.triangle_test].packet_form.passes

    @property
    def sizes(self) -> str:
        """The arguments of templates in C++: P, W, and whether the origin is shared."""
        return f"{self.rays}, {self.width}, {cpp(self.shared_origin)}"

    @property
    def headers(self) -> str:
        """Headers that the pieces of the triangle test use."""
        return TRIANGLE_TESTS[self.triangle_test].packet_form.headers

    @property
    def type(self) -> str:
        """The type of the packet in C++ (kernels/native/packet.h), which has all components but those of the triangle test."""
        return f"wrt::Packet<{self.sizes}>"

    @property
    def own(self) -> str:
        """C++: the packet `own` in the array of a parameter `packet`."""
        return f"const {self.type} own(packet.data);"

    @property
    def packet(self) -> str:
        """C++ expression for the packet in the array of a parameter `packet`."""
        return f"{self.type}(packet.data)"

    @property
    def block(self) -> str:
        """C++ expression for block number `block` of a parameter `records`."""
        return f"records.data + (size_t)block * {self.record * self.width}"

    @property
    def box(self) -> str:
        """C++ expression for the boxes of node number `node` of a parameter `boxes`."""
        return f"boxes.data + (size_t)node * {6 * self.width}"

    @property
    def state(self) -> str:
        """C++: a pointer to each component of the triangle test, of a packet `own`."""
        names = TRIANGLE_TESTS[self.triangle_test].packet_form.state
        return " ".join(f"float* const {name} = own.state + {k * self.rays};" for k, name in enumerate(names))

    @property
    def names(self) -> str:
        """C++: the names that the pieces of triangle tests read (`PacketForm`), for a packet `own` and its `bounds`."""
        of_rays = ("origin_x", "origin_y", "origin_z", "slope_x", "slope_y", "t")
        rays = ", ".join(f"*const {name} = own.{name}" for name in of_rays)
        return f"""
        constexpr int W = {self.width}; constexpr bool SHARED = {cpp(self.shared_origin)};
        {self.state} const float {rays}; const int* const main_axis = own.main_axis;
        const wrt::SharedOrigin shared = wrt::shared_origin(bounds); const float* const origin0 = shared.origin;"""

    @property
    def prepare(self) -> str:
        """C++ expression for what computes these components of ray k; after `state`."""
        return TRIANGLE_TESTS[self.triangle_test].packet_form.preparation


def cpp(value: bool) -> str:
    """A constant in C++."""
    return str(value).lower()
