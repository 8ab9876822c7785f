"""Wide bounding volume hierarchy as traversals read it: W children a node, boxes as structure of arrays.

A node is 6 W floats of `bounds`: low x, low y, low z, high x, high y, high z of its children, W lanes each, so that one
lane loop tests a ray against all of them:

    bounds[(node * 6 + component) * W + lane]

and W words of `child`:

    word >= 0   index of an inner node, greater than that of its parent; siblings follow one another (breadth-first order)
    word < 0    ~(first_block << 6 | triangles): a leaf of 1 to 63 triangles, which owns ceil(triangles / W) consecutive
                blocks of W lanes, or an unused lane (0 triangles), whose box is empty: low = inf, high = -inf

Node 0 is the root; its box is `low`, `high`. A child's box is the exact union of its triangles' boxes, so that by the
consistency rule (`wrt.kernels.simd.boxes`) no ray reaches a triangle before it reaches the boxes around it.

The order in memory does not matter to rays: nodes and their blocks depth first, or in van Emde Boas's order, took 0.95 to 1.06
of the time (random and ambient rays in streams, 0.2 to 3.2 million triangles): within a level they lie
like that anyway. Why boxes are not stored in fewer bytes is told in `wrt.kernels.simd.box_lanes`.

References:
    I. Wald, C. Benthin, S. Boulos: Getting rid of packets: efficient SIMD single-ray traversal using multi-branching BVHs.
        IEEE Symposium on Interactive Ray Tracing 2008.
    H. Dammertz, J. Hanika, A. Keller: Shallow bounding volume hierarchies for fast SIMD ray tracing of incoherent rays.
        Eurographics Symposium on Rendering 2008.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

MAX_WIDE_DEPTH = 64
"""Most inner nodes on a path from the root: bounds every traversal's stack."""

MAX_LEAF_TRIANGLES = 63
"""Triangles that a leaf can hold."""

MAX_BLOCKS = 1 << 25
"""Blocks that a tree can hold."""

EMPTY_LANE = wp.constant(~0)


@wp.struct
class WideNodes:
    """The nodes of a tree and the box around it."""

    bounds: wp.array(dtype=float)
    """(nodes * 6 * W,)"""
    child: wp.array(dtype=int)
    """(nodes * W,)"""
    low: wp.vec3
    high: wp.vec3


@wp.func
def leaf_child(first_block: int, triangles: int):
    """Packs a leaf."""
    return ~((first_block << 6) | triangles)


@wp.func
def first_block(child: int):
    """Index of a leaf's first triangle block."""
    return (~child) >> 6


@wp.func
def leaf_triangles(child: int):
    """Number of triangles in a leaf; 0 for an unused lane."""
    return (~child) & 63
