"""Memory layout of the wide bounding volume hierarchy: W children per node, boxes as structure of arrays.

A node is 6 W floats of `bounds`: low x, low y, low z, high x, high y, high z of its children, W lanes each, so that one lane
loop tests a ray against all of them:

    bounds[(node * 6 + component) * W + lane]

and W words of `child`:

    word >= 0   index of an inner node, greater than that of its parent; siblings are consecutive (breadth-first order)
    word < 0    ~(first_block << 6 | triangles): a leaf of 1 to 63 triangles, which owns ceil(triangles / W) consecutive
                blocks of W lanes, or an unused lane (0 triangles), whose box is empty: low = inf, high = -inf

Node 0 is the root; its box is `low`, `high`. The box of a child is the exact union of the boxes of its triangles. By the
consistency rule (`wrt.kernels.simd.boxes`) a ray therefore enters every box around a triangle no later than it reaches the
triangle. In a tree with spatial splits, leaves list the triangles that are partly in them, and boxes are those of the parts,
enlarged as `wrt.builders.core.clip` explains.

Depth-first and van Emde Boas orders of nodes and blocks do not change the speed of traversal
(notebooks/records/2026-11-22-box-formats.md).

References: wald-2008; dammertz-2008.
"""

import warp as wp

MAX_WIDE_DEPTH = 64
"""Greatest number of inner nodes on a path from the root; bounds the stack of every traversal."""

MAX_LEAF_TRIANGLES = 63
"""Greatest number of triangles in a leaf."""

MAX_BLOCKS = 1 << 25
"""Greatest number of blocks in a tree."""


def check_blocks(blocks: int, width: int) -> None:
    """Refuses a tree whose leaves need more blocks than child words can name.

    Raises:
        ValueError: there are more than `MAX_BLOCKS`.
    """
    if blocks > MAX_BLOCKS:
        raise ValueError(
            f"the tree needs {blocks:,} blocks of {width} triangles, and its layout has places for {MAX_BLOCKS:,}; cut the "
            "mesh into several, and make a scene of a wrt.Instance of each"
        )


EMPTY_LANE = wp.constant(~0)
"""Child word of an unused lane."""


@wp.struct
class WideNodes:
    """The nodes of a tree and its bounding box."""

    bounds: wp.array(dtype=float)
    """(nodes * 6 * W,) boxes of the children."""
    child: wp.array(dtype=int)
    """(nodes * W,) child words."""
    low: wp.vec3
    high: wp.vec3


@wp.func
def leaf_child(first_block: int, triangles: int):
    """Packs a leaf into a child word."""
    return ~((first_block << 6) | triangles)


@wp.func
def first_block(child: int):
    """Index of a leaf's first triangle block."""
    return (~child) >> 6


@wp.func
def leaf_triangles(child: int):
    """Number of triangles in a leaf; 0 for an unused lane."""
    return (~child) & 63
