"""Compact subtrees of a kd-tree: within a subtree, places are those of a heap, and no node has an index.

**Layout.** A subtree has `height` levels of planes. It is 2^(height + 1) words of 32 bits: 32, 64 or 128 bytes for 2, 3 or 4
levels, so that a subtree of three levels is a cache line:

    word 0                  the axes of the planes, 2 bits each: those of plane k are bits 2 k and 2 k + 1. 3: a leaf
    words 1 .. half - 1     the positions of the planes, bits of a float32; half = 2^height. The root is 1, and the children of
                            k are 2 k and 2 k + 1
    words half .. end       the exits, children of the last planes:
                            word >= 0   number of the subtree that begins there
                            word < 0    ~(first_block << 6 | triangles): a leaf. If `triangles` is LONG, `first_block` is the
                                        place of an ordinary leaf node (`wrt.kernels.layout.kdtree_nodes`) in the same array

A leaf above the exits has its word at the first exit below it. Planes and exits below such a leaf are unused.

A walk names a node by the number of its word, subtree * 2^(height + 1) + k. The tree's root is 1.

References: havran-2001; rahikainen-2013 (section 2.2).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native

HEIGHTS = (2, 3, 4)
"""Levels of planes of a subtree; the axes of more would not fit into a word."""

ROOT = 1

LONG = 63
"""Number of triangles that stands for this many or more."""


@cache
def load_compact(height: int) -> wp.Function:
    """`wp.func(nodes, index) -> node`: a node as in `wrt.kernels.layout.kdtree_nodes`, without the index of its children.
    `index` is moved from an exit to the subtree that begins there."""

    @native.func_native("compact_nodes.h", f"return wrt::load_compact<{height}, {LONG}>(nodes.data, index);")
    def load(nodes: wp.array(dtype=wp.vec2i), index: wp.ref[int]) -> wp.vec2i: ...

    return load


@cache
def compact_children(height: int) -> wp.Function:
    """`wp.func(index, node) -> (lower, upper)`: the words of a plane's children, or of the exits to them."""
    mask = (2 << height) - 1

    @wp.func
    def children(index: int, node: wp.vec2i):
        lower = index + (index & wp.static(mask))
        return wp.vec2i(lower, lower + 1)

    return children
