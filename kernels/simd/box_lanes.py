"""A ray against the W child boxes of a wide node: the lane loop of every BVH traversal, and the keys that it leaves behind.

A traversal keeps one row of W keys for each level of the tree that it is in: what is left to visit there. A key is the
bits of the t at which the child's box is entered, which is not negative, with the child's lane in the lowest log2(W) bits:
the least key, as an integer, is the nearest child, and no list of children is ever sorted. Cutting off the low bits only
makes the entry earlier, which is safe. `NO_CHILD` is above all keys, and a NaN as a number: `NaN <= t` is false.

The loop's twin in plain Warp is `wrt.kernels.simd.boxes.slab_interval`, to which the tests compare it bit for bit.

**Tried: boxes in bytes.** Eight bits a plane on a grid of the node, whose origin and three powers of two stand before them,
rounded outward by the arithmetic that reads them (Mahovsky and Wyvill 2006; Ylitie, Karras, Laine 2017): two lines of the cache
a node instead of six, and the same hits to the bit. (Measured on one thread of a Zen 4, 16 children a node, random and ambient
rays, `single` and `stream`, meshes of 0.07 to 3.2 million triangles.) Nothing gets faster:
* bytes have to become floats, and these positions: a node in the cache takes 10 ns instead of 5, and one that comes from memory
  1.1 times as long, for its six lines come at the same time. With the ray's origin folded into the grid's, which would need a
  slack of its own, it is no better;
* looser boxes: 3 in 100 more nodes and 4 in 100 more leaves; 1.8 times the leaves for ambient rays of the atrium's walls;
* together, 0.99 to 1.06 of the time for meshes of 0.8 and 3.2 million triangles, 1.04 to 1.19 for smaller ones, 1.04 to 1.42 in
  the atrium. All nodes take a twentieth of what the records take, so few of them are ever out of the cache.

The same for triangles (after Benthin et al. 2018), their boxes in two lines before the nine of a block: 37 to 47 in 100 blocks
need not be read. Streams took 1.0 to 1.27 of the time, single rays 0.96 to 1.14, and 0.90 only if random in the largest mesh.

References:
    J. Mahovsky, B. Wyvill: Memory-conserving bounding volume hierarchies with coherent raytracing.
        Computer Graphics Forum 25(2), 2006.
    H. Ylitie, T. Karras, S. Laine: Efficient incoherent ray traversal on GPUs through compressed wide BVHs.
        High Performance Graphics 2017.
    C. Benthin, I. Wald, S. Woop, A. T. Áfra: Compressed-leaf bounding volume hierarchies. High Performance Graphics 2018.
"""

from functools import cache

import warp as wp

from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import FOR_LANES, lanes

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NO_CHILD_CONSTANT = 0x7FFFFFFF
NO_CHILD = wp.constant(NO_CHILD_CONSTANT)
"""Key of a child that is missed, done, or not there."""

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
    """`wp.func(bounds, node, slabs, t_min, t_max, keys, first) -> least key`: one ray x W boxes.

    Writes the keys of the children whose widened box the ray meets within [t_min, t_max] to keys[first .. first + W - 1].
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
    """`wp.func(keys, first) -> least of W keys`."""

    @wp.func_native(_head(width) + _NEAREST)
    def nearest_child_native(keys: wp.array(dtype=int), first: int) -> int: ...

    return nearest_child_native


@cache
def met_boxes(width: int) -> wp.Function:
    """`wp.func(bounds, node, slabs, t_min, t_max, entry) -> mask` of the boxes met; `entry` is where, in all lanes."""
    Lanes = lanes(width)

    @wp.func_native(_head(width) + _MASK)
    def met_boxes_native(
        bounds: wp.array(dtype=float),
        node: int,
        slabs: wp.ref[RaySlabs],
        t_min: float,
        t_max: float,
        entry: wp.ref[Lanes],
    ) -> wp.uint32: ...

    return met_boxes_native


@wp.func
def entry_of(key: int, width: int):
    """The t at which a key's child is entered, or a hair before; NaN for `NO_CHILD`."""
    return wp.cast(key & -width, wp.float32)
