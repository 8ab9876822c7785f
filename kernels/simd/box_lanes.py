"""One ray against the W child boxes of a wide node: the lane loop of every BVH traversal, and the sort keys of the children.

A traversal keeps one row of W keys per level of its current path: the children that remain to be visited. A key is the bit
pattern of the t at which the ray enters the child's box, which is not negative, with the lane of the child in the lowest
log2(W) bits. The smallest key, compared as an integer, is the nearest child, so children are never sorted. Replacing the low
bits only makes the entry earlier, which is conservative. `NO_CHILD` is greater than every key; read as a float it is a NaN, so
`NaN <= t` is false.

`wrt.kernels.simd.boxes.slab_interval` is the scalar form of the loop; tests compare the two bit for bit.

**Limits.** Boxes are stored as float32. Quantised boxes (Mahovsky and Wyvill 2006; Ylitie et al. 2017) and compressed leaves
(Benthin et al. 2018) were tried and are not faster here (notebooks/records/2026-11-22-box-formats.md).

References:
    J. Mahovsky, B. Wyvill: Memory-conserving bounding volume hierarchies with coherent raytracing. Computer Graphics Forum
        25(2), 2006.
    H. Ylitie, T. Karras, S. Laine: Efficient incoherent ray traversal on GPUs through compressed wide BVHs. High Performance
        Graphics 2017.
    C. Benthin, I. Wald, S. Woop, A. T. Áfra: Compressed-leaf bounding volume hierarchies. High Performance Graphics 2018.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import FOR_LANES, lanes

exact_module(__name__)

NO_CHILD_CONSTANT = 0x7FFFFFFF
NO_CHILD = wp.constant(NO_CHILD_CONSTANT)
"""Key of a child that the ray misses, that has been visited, or that does not exist."""

_RAY = """
    const float* box = &bounds.data[(size_t)node * (6 * W)];
    const float ix = slabs.inverse.c[0], iy = slabs.inverse.c[1], iz = slabs.inverse.c[2];
#if defined(__CUDA_ARCH__)
    // a node is loaded four floats at a time, then sorted into near and far
    float near_x[W], near_y[W], near_z[W], far_x[W], far_y[W], far_z[W], all[6 * W];
    if (W % 2 == 0) for (int j = 0; j < 6 * W / 4; ++j) {
        const float4 v = ((const float4*)box)[j];
        all[4 * j] = v.x; all[4 * j + 1] = v.y; all[4 * j + 2] = v.z; all[4 * j + 3] = v.w;
    } else for (int j = 0; j < 6 * W; ++j) all[j] = box[j];
    for (int i = 0; i < W; ++i) {
        near_x[i] = ix < 0.0f ? all[3 * W + i] : all[i]; far_x[i] = ix < 0.0f ? all[i] : all[3 * W + i];
        near_y[i] = iy < 0.0f ? all[4 * W + i] : all[W + i]; far_y[i] = iy < 0.0f ? all[W + i] : all[4 * W + i];
        near_z[i] = iz < 0.0f ? all[5 * W + i] : all[2 * W + i]; far_z[i] = iz < 0.0f ? all[2 * W + i] : all[5 * W + i];
    }
#else
    const int sx = ix < 0.0f ? 3 * W : 0, sy = iy < 0.0f ? 3 * W : 0, sz = iz < 0.0f ? 3 * W : 0;
    const float *near_x = box + sx, *near_y = box + W + sy, *near_z = box + 2 * W + sz;
    const float *far_x = box + 3 * W - sx, *far_y = box + 4 * W - sy, *far_z = box + 5 * W - sz;
#endif
    const float in_x = slabs.origin_in.c[0], in_y = slabs.origin_in.c[1], in_z = slabs.origin_in.c[2];
    const float out_x = slabs.origin_out.c[0], out_y = slabs.origin_out.c[1], out_z = slabs.origin_out.c[2];
"""

_MEET = """
        float enter = t_min, leave = t_max, t;
        t = (near_x[i] - in_x) * ix; enter = t > enter ? t : enter;
        t = (near_y[i] - in_y) * iy; enter = t > enter ? t : enter;
        t = (near_z[i] - in_z) * iz; enter = t > enter ? t : enter;
        t = (far_x[i] - out_x) * ix; leave = t < leave ? t : leave;
        t = (far_y[i] - out_y) * iy; leave = t < leave ? t : leave;
        t = (far_z[i] - out_z) * iz; leave = t < leave ? t : leave;
"""

_KEYS = f"""{_RAY}
    int* key = &keys.data[first];
    int least = NO_CHILD;
    WRT_FOR_LANES(i) {{{_MEET}
        int k = (__builtin_bit_cast(int, enter) & -W) | i;
        k = enter <= leave ? k : NO_CHILD;
        key[i] = k;
        least = k < least ? k : least;
    }}
    return least;
"""

_MASK = f"""{_RAY}
    unsigned mask = 0;
    WRT_FOR_LANES(i) {{{_MEET}
        entry.c[i] = enter;
        mask |= enter <= leave ? 1u << i : 0u;
    }}
    return mask;
"""

_NEAREST = """
    const int* key = &keys.data[first];
    int least = NO_CHILD;
    WRT_FOR_LANES(i) { least = key[i] < least ? key[i] : least; }
    return least;
"""


def _head(width: int) -> str:
    return f"{FOR_LANES}    constexpr int W = {width}, NO_CHILD = {NO_CHILD_CONSTANT};"


@cache
def ray_boxes(width: int) -> wp.Function:
    """`wp.func(bounds, node, slabs, t_min, t_max, keys, first) -> smallest key`: one ray x W boxes.

    Writes W keys to keys[first .. first + W - 1]: those of the children whose widened box the ray meets within [t_min, t_max],
    and `NO_CHILD` for the others.
    """

    @wp.func_native(_head(width) + _KEYS)
    def ray_boxes_native(
        bounds: wp.array(dtype=float),
        node: int,
        slabs: wp.ref[RaySlabs],
        t_min: float,
        t_max: float,
        keys: wp.array(dtype=int),
        first: int,
    ) -> int: ...

    return ray_boxes_native


@cache
def nearest_child(width: int) -> wp.Function:
    """`wp.func(keys, first) -> smallest of W keys`."""

    @wp.func_native(_head(width) + _NEAREST)
    def nearest_child_native(keys: wp.array(dtype=int), first: int) -> int: ...

    return nearest_child_native


@cache
def intersected_boxes(width: int) -> wp.Function:
    """`wp.func(bounds, node, slabs, t_min, t_max, entry) -> mask` of the boxes that the ray meets; `entry` gets the t of entry
    of every lane."""
    Lanes = lanes(width)

    @wp.func_native(_head(width) + _MASK)
    def intersected_boxes_native(
        bounds: wp.array(dtype=float),
        node: int,
        slabs: wp.ref[RaySlabs],
        t_min: float,
        t_max: float,
        entry: wp.ref[Lanes],
    ) -> wp.uint32: ...

    return intersected_boxes_native


@wp.func
def entry_of(key: int, width: int):
    """The t at which the child of a key is entered, rounded down by at most the lane bits; NaN for `NO_CHILD`."""
    return wp.cast(key & -width, wp.float32)
