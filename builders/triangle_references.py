"""References: the records that triangle-scanning builders move, 8 floats per triangle, (low, id, -high, size).

The size is 0 unless a builder asks for it (`write_sizes`).

Two references fit a cache line. A reference is moved as a whole, so every range is read sequentially. Storing -high turns the
union of boxes into one minimum over 8 lanes.
"""

import warp as wp

from wrt.builders.triangle_boxes import Boxes
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

ID_OFFSET = 0x00800000
"""Added to a triangle's id so that its bits are those of a normal float. Denormals would slow down arithmetic on unused
lanes."""


@wp.func_native(
    f"""
    const size_t n = boxes.low.shape[1];
    for (size_t i = begin; i < (size_t)end; ++i) {{
        float* to = references.data + i * 8;
        const int bits = (int)i + {ID_OFFSET};
        for (size_t axis = 0; axis < 3; ++axis) {{
            to[axis] = boxes.low.data[axis * n + i];
            to[4 + axis] = -boxes.high.data[axis * n + i];
        }}
        memcpy(to + 3, &bits, 4);
        to[7] = 0.0f;
    }}
"""
)
def write_references(boxes: Boxes, begin: int, end: int, references: wp.array(dtype=float)):
    """Writes the references of triangles begin .. end - 1."""
    ...


@wp.func_native("""
    for (size_t i = begin; i < (size_t)end; ++i) {
        float* to = references.data + i * 8;
        const float x = -(to[0] + to[4]), y = -(to[1] + to[5]), z = -(to[2] + to[6]);
        const float area = x * y + y * z + z * x;
        int bits;
        memcpy(&bits, &area, 4);
        to[7] = area > 0.0f ? (float)bits * 0x1p-23f : 0.0f;
    }
""")
def write_sizes(references: wp.array(dtype=float), begin: int, end: int):
    """Writes the sizes of references begin .. end - 1: 127 plus the binary logarithm of half the surface area of a triangle's
    box, linear between powers of two, as the bits of a float give it; 0 to 255."""
    ...


@wp.func_native("memcpy(target.data + (size_t)to * 8, references.data + (size_t)begin * 8, (size_t)count * 32);")
def copy_references(references: wp.array(dtype=float), begin: int, count: int, target: wp.array(dtype=float), to: int):
    """Copies a range of references."""
    ...


@wp.func_native(
    f"""
    for (int i = 0; i < count; ++i) {{
        int bits;
        memcpy(&bits, references.data + (size_t)(begin + i) * 8 + 3, 4);
        order.data[first + i] = bits - {ID_OFFSET};
    }}
"""
)
def write_order(references: wp.array(dtype=float), begin: int, count: int, order: wp.array(dtype=int), first: int):
    """Writes the triangle ids of a range."""
    ...
