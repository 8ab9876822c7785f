"""Streams of a wide BVH, loaded with the list of its root.

**Problem.** In open scenes, many rays from anywhere and many short rays meet no child of the root. They would be prepared,
stored and listed to find the same. The others would be read again for the first node that they visit.

**Idea.** While 16 rays are in lanes to be loaded (`wrt.kernels.traversal.stream.stream_load`), they are tested against the
children of the root, one child after the other. Rays that meet none are not stored. For the others the result is what the
filter of a node writes (`wrt.kernels.traversal.stream.stream_lanes`): their words, and keys. The arithmetic is that of
`wrt.kernels.simd.boxes.slab_interval`, to the bit.

Short rays are first tested by the boxes around them (`wrt.kernels.traversal.stream.stream_boxes`).

Nodes below the root are filtered ray by ray: with their rays in lanes, reading and transposing these takes as long as it saves.
Figures: notebooks/records/2026-11-24-streams.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, WideNodes
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.simd.lanes import count_bits
from wrt.kernels.traversal.stream.stream_boxes import ERROR, box_memory
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, RAY_BITS, stream_ray
from wrt.kernels.traversal.stream.stream_lanes import FAR, NEAR, NONE
from wrt.kernels.traversal.stream.stream_load import GUARDS, KEPT_SIZE, native_form, prepare_one_by_one
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

ORDERS = f"""
    static_assert(wrt::Order::NONE == wrt::Order({NONE}));
    static_assert(wrt::Order::NEAR == wrt::Order({NEAR}) && wrt::Order::FAR == wrt::Order({FAR}));
    static_assert(wrt::NO_CHILD == {NO_CHILD_CONSTANT} && wrt::RAY_BITS == {RAY_BITS});
"""
"""C++: constants that kernels/native has too."""


def root_test(width: int, order: int) -> str:
    """C++ struct of the test of rays against the boxes of the root."""
    return f"wrt::RootTest<{width}, wrt::Order({order}), {LIST_LANES}>"


@cache
def begin_root(width: int, order: int, boxes: bool) -> wp.Function:
    """`func(children, bounds, low, high, center, lanes) -> used`: before the first rays of a stream; returns the bits of the
    root's children."""
    code = f"const unsigned used = {root_test(width, order)}::begin(children.data, {int(EMPTY_LANE)}, lanes.data);\n"
    grid = f"wrt::RootGrid<{width}, {LIST_LANES}>"
    if boxes:
        code += f"static_assert({grid}::FLOATS == {box_memory(width)} && {grid}::ERROR == {ERROR!r}f);\n"
        code += f"{grid}(lanes.data).begin(bounds.data, used, low, high, center);\n"

    @native.func_native("stream_root.h", f"{ORDERS}{code}return used;")
    def begin_native(
        children: wp.array(dtype=int),
        bounds: wp.array(dtype=float),
        low: wp.vec3,
        high: wp.vec3,
        center: wp.vec3d,
        lanes: wp.array(dtype=float),
    ) -> wp.uint32: ...

    return begin_native


@cache
def end_root(width: int, order: int) -> wp.Function:
    """`func(children, lanes, keys) -> leaves`: after the last rays of a stream; writes the keys of the root's children, and
    returns the bits of the leaves that a ray meets."""
    call = f"{root_test(width, order)}::end(children.data, lanes.data, keys.data)"

    @native.func_native("stream_root.h", f"return {call};")
    def end_native(children: wp.array(dtype=int), lanes: wp.array(dtype=float), keys: wp.array(dtype=int)) -> wp.uint32: ...

    return end_native


@wp.struct
class RootLoad:
    """A stream while it is loaded with the list of its root."""

    used: wp.uint32
    """Bits of the root's children."""
    loaded: int
    """Rays that were loaded."""
    kept: int
    """Those of them that are in the stream."""
    waiting: int
    """Those that wait to be tested."""
    unboxed: int
    """How many groups of rays are still tested without boxes around rays."""


@cache
def load_lanes(triangle_test: str, width: int, order: int, boxes: bool) -> wp.Function:
    """`func(batch, wanted, tree, stream, list, lanes, own, state) -> bits`: loads the next rays, from `wanted[0]` on, at most
    `wanted[1]`, and stores and lists those that meet a child of the root.

    Returns the bits of the rays that were stored, of those in the lanes: rays may wait until others fill the lanes
    (`wrt.kernels.traversal.stream.stream_boxes`), or until there are no more (`wanted[1]` 0).

    list: words of the rays of the stream. lanes: see
    `kernels/native/stream_root.h`. own: see `wrt.kernels.traversal.stream.stream_load.KEPT_SIZE`.
    """
    form = f"{native_form(triangle_test)}, {width}, wrt::Order({order}), {int(boxes)}, {LIST_LANES}"
    arguments = "stream.data, tree.bounds.data, list.data, lanes.data, own.data, state"

    rays = "batch, wanted[0], wanted[1], tree.low, tree.high"

    @native.func_native("stream_root.h", f"{GUARDS}{ORDERS}return wrt::load_root<{form}>({rays}, {arguments});")
    def load_native(
        batch: RayBatch,
        wanted: wp.vec2i,
        tree: wp.ref[WideNodes],
        stream: wp.array(dtype=stream_ray(triangle_test)),
        list: wp.array(dtype=int),
        lanes: wp.array(dtype=float),
        own: wp.array(dtype=float),
        state: wp.ref[RootLoad],
    ) -> wp.uint32: ...

    return load_native


@cache
def load_root(triangle_test: str, room: int, width: int, order: int, boxes: bool = False) -> wp.Function:
    """`wp.func(rays, left, tree, stream, list, keys, leaves, size) -> count`: loads rays from `left[0]` on, until the stream
    is full or ray `left[1]` is reached.

    Returns how many rays were loaded; `size` becomes the number of those that are in the stream. The others miss.

    Args:
        triangle_test: name of the triangle test.
        room: of a stream, in rays.
        width: children of a node.
        order: of the children of a node: `NONE`, `NEAR` or `FAR`.
        boxes: whether short rays are first tested by the boxes around them; then the rays of a stream are not in the order of
            the batch.

    Args (of the function): list: becomes the list of the root, a word for each ray of the stream, in order; `LIST_LANES` words
        beyond it are written, too. keys: of the root's children, W ints. leaves: becomes the bits of the root's leaves that a
        ray meets.
    """
    StreamRay, load = stream_ray(triangle_test), load_lanes(triangle_test, width, order, boxes)
    prepared = bool(TRIANGLE_TESTS[triangle_test].native)
    lanes_size = (width + 1) * LIST_LANES + (box_memory(width) if boxes else 0)
    prepare_kept, group = prepare_one_by_one(triangle_test), min(room, LIST_LANES)
    begin_list, end_list = begin_root(width, order, boxes), end_root(width, order)

    @wp.func
    def load_rays(
        rays: RayBatch,
        left: wp.vec2i,
        tree: WideNodes,
        stream: wp.array(dtype=StreamRay),
        list: wp.array(dtype=int),
        keys: wp.array(dtype=int),
        leaves: wp.ref[wp.uint32],
        size: wp.ref[int],
    ):
        lanes = wp.zeros(shape=(lanes_size,), dtype=float)
        own = wp.zeros(shape=(KEPT_SIZE,), dtype=float)
        state = RootLoad()
        state.used = begin_list(tree.child, tree.bounds, tree.low, tree.high, rays.center, lanes)
        more = bool(True)
        while more:
            first = left[0] + state.loaded
            more = first < left[1] and state.kept + state.waiting <= wp.static(room - group)
            count = wp.where(more, wp.min(left[1] - first, wp.static(group)), 0)
            bits = load(rays, wp.vec2i(first, count), tree, stream, list, lanes, own, state)
            if wp.static(not prepared):
                prepare_kept(stream, state.kept, bits, own)
            state.loaded += count
            state.kept += count_bits(bits)
        leaves = end_list(tree.child, lanes, keys)  # noqa: F841 (a reference)
        size = state.kept  # noqa: F841 (a reference)
        return state.loaded

    return load_rays
