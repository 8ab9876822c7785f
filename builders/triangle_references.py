"""References: the records that triangle-scanning builders move, 8 floats per triangle, (low, id, -high, size).

The size is 0 unless a builder asks for it (`write_sizes`).

Two references fit a cache line. A reference is moved as a whole, so every range is read sequentially. Storing -high turns the
union of boxes into one minimum over 8 lanes.
"""

import warp as wp

from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.runtime import native

ID_OFFSET = 0x00800000
"""Added to a triangle's id so that its bits are those of a normal float. Denormals would slow down arithmetic on unused
lanes."""

SAME_ID = f"static_assert(wrt::ID_OFFSET == {ID_OFFSET});\n"


@native.func_native("reference.h", f"{SAME_ID}wrt::write_references(boxes, begin, end, references.data);")
def write_references(boxes: Boxes, begin: int, end: int, references: wp.array(dtype=float)):
    """Writes the references of triangles begin .. end - 1."""


@native.func_native("reference.h", "wrt::write_sizes(references.data, begin, end);")
def write_sizes(references: wp.array(dtype=float), begin: int, end: int):
    """Writes the sizes of references begin .. end - 1: 127 plus the binary logarithm of half the surface area of a triangle's
    box, linear between powers of two, as the bits of a float give it; 0 to 255."""


@wp.func_native("memcpy(target.data + (size_t)to * 8, references.data + (size_t)begin * 8, (size_t)count * 32);")
def copy_references(references: wp.array(dtype=float), begin: int, count: int, target: wp.array(dtype=float), to: int):
    """Copies a range of references."""


@native.func_native("reference.h", "wrt::write_ids(references.data + (size_t)begin * 8, count, order.data + first);")
def write_order(references: wp.array(dtype=float), begin: int, count: int, order: wp.array(dtype=int), first: int):
    """Writes the triangle ids of a range."""
