"""References: what builders that scan triangles move about, 8 floats a triangle, (low, id, -high, 0).

Two fit a cache line, and a reference is moved as a whole, so that every range is read in order. -high makes minima of both
corners of a box: one comparison of 8 lanes (an old trick).
"""

import warp as wp

from wrt.builders.triangle_boxes import Boxes

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

ID_OFFSET = 0x00800000
"""Added to a triangle's id, so that its bits are those of a normal float: arithmetic on lanes nobody needs stays fast."""


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
    """The references of triangles begin .. end - 1."""
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
    """The triangle ids of a range."""
    ...
