"""Loads rays of a batch into a stream, 16 at a time.

The rays of a stream are stored one after the other, each with all its numbers, because filters and tests read them like that.
Here they are computed component by component, 16 rays to a vector, and then transposed (`kernels/native/stream_load.h`), so
that a ray is written by one or two vector stores. The per-ray data of the triangle test is included if the test supplies
`TestForm.native`; other tests prepare one ray after the other. The arithmetic is that of `load_ray`, `ray_slabs` and
`prepare`, to the bit. Figures: notebooks/records/2026-11-21-streams.md.

Invalid rays are not stored, so a stream is loaded from as many rays as fill it. For a wide BVH, neither are rays that meet no
child of the root, which is found while they are loaded (`load_root`).

## The list of the root

**Problem.** In open scenes, many rays from anywhere and many short rays meet no child of the root. They would be prepared,
stored and listed to find the same. The others would be read again for the first node that they visit.

**Idea.** While 16 rays are in lanes to be loaded, they are tested against the children of the root, one child after the other.
Rays that meet none are not stored. For the others the result is what the filter of a node writes
(`wrt.kernels.traversal.stream.stream_lanes`): their words, and keys. The arithmetic is that of
`wrt.kernels.simd.boxes.slab_interval`, to the bit.

Short rays are first tested by the boxes around them.

Nodes below the root are filtered ray by ray: with their rays in lanes, reading and transposing these takes as long as it saves.
Figures: notebooks/records/2026-11-24-streams.md.

## Boxes around short rays

The box around a ray, from origin to end, tells that most short rays meet nothing.

**Problem.** Most of the short rays in an open scene, such as those of ambient occlusion, meet no child of the root. Before that
is known, each of them is prepared, with three divisions, and tested against all children. The few rays of a group that stay
then leave most lanes idle.

**Idea.** Compare the box around each ray with the boxes of the children. Both are rounded to the cells of a grid, so that 16
rays are compared at a time as 16-bit numbers: a saturated difference for each of six planes, whose sign is that of a gap. Rays
whose box meets no child are done. The others wait until there are 16 of them, which are then made relative to the scene's
centre, checked, prepared, tested and stored together.

Long rays meet most boxes. If more than `MANY` rays of a group of 16 stay, the next `PAUSE` groups are not compared, nor do they
wait (`RootGrid` of kernels/native/stream_root.h).

**Exactness.** A hit is a point origin + t direction within the slack of its triangle's box. The children's boxes are widened
for that, for the rounding of the rays' ends (as in `wrt.kernels.traversal.packet.rays.reversed_bounds`), and for rounding to
cells. Rays that end so far away that this does not suffice meet every box. On CUDA boxes are not compared.

Figures: notebooks/records/2026-11-26-joined-packets.md, notebooks/records/2026-11-26-masked-stores.md.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, WideNodes
from wrt.kernels.layout.ray_batch import FARTHEST, NEGLIGIBLE, SHORTEST, RayBatch
from wrt.kernels.layout.unchecked import load_float
from wrt.kernels.runtime import native
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.simd.lanes import count_bits, lowest_bit
from wrt.kernels.traversal.packet.rays.reversed_bounds import ENDS_ERROR
from wrt.kernels.traversal.stream.stream_kernel import FAR, LIST_LANES, NEAR, NONE, RAY_BITS, stream_ray
from wrt.kernels.triangle import TRIANGLE_TESTS

WAITING_ROWS = 9
"""Numbers of a waiting ray: origin, direction, number, t_min, t."""

WAITING_ROOM = 2 * LIST_LANES
"""Waiting rays: less than a group, and the next group."""

BOX_ERROR = 3.0 * SLACK + ENDS_ERROR
"""By which the box around a ray must be widened, as a fraction of the sum of the largest coordinates of ray and scene."""

GRID_FLOATS = 8
"""Floats that describe the grid: cells per unit of length; what is added to x, y and z in cells; the largest coordinate of a
box around a ray for which `MARGIN` suffices; the scene's centre, from which coordinates count, as floats."""


def box_memory(width: int) -> int:
    """Floats of memory: waiting rays, the grid, and six planes of each child, in cells, once for each lane."""
    return WAITING_ROWS * WAITING_ROOM + GRID_FLOATS + 3 * width * LIST_LANES


KEPT_SIZE = 7 * LIST_LANES
"""Floats of `own`: what `prepare_one_by_one` reads, origins, directions and numbers of the rays in lanes, component by
component."""

GUARDS = f"""
    static_assert(wrt::SLACK == {SLACK!r}f && wrt::SHORTEST == {SHORTEST!r}f && wrt::FARTHEST == {FARTHEST!r}f);
    static_assert(wrt::NEGLIGIBLE == {NEGLIGIBLE!r}f && wrt::MIN_SIZE == {SHORTEST / NEGLIGIBLE!r}f);
"""
"""C++: constants that kernels/native has too."""


def native_form(triangle_test: str) -> str:
    """C++ struct that prepares the rays of a triangle test."""
    return TRIANGLE_TESTS[triangle_test].native or "wrt::OneByOne"


@cache
def load_lanes(triangle_test: str) -> wp.Function:
    """`func(batch, wanted, low, high, stream, size, place, own) -> bits`: loads the next rays, from `wanted[0]` on, at most
    `wanted[1]` and at most 16 of them, and `place` after the first ray of the stream.

    Those that are valid are appended to the `size` rays of the stream; their bits are returned. low, high: bounds of the scene.
    own: receives what `prepare_one_by_one` reads (`KEPT_SIZE`), if it is needed.
    """
    form = f"{native_form(triangle_test)}, {LIST_LANES}"
    arguments = "batch, wanted[0], wanted[1], low, high, stream.data + size, place, own.data"

    @native.func_native("stream_load.h", f"{GUARDS}return wrt::load_rays<{form}>({arguments});")
    def load_lanes_native(
        batch: RayBatch,
        wanted: wp.vec2i,
        low: wp.vec3,
        high: wp.vec3,
        stream: wp.array(dtype=stream_ray(triangle_test)),
        size: int,
        place: int,
        own: wp.array(dtype=float),
    ) -> wp.uint32: ...

    return load_lanes_native


@cache
def prepare_one_by_one(triangle_test: str) -> wp.Function:
    """`wp.func(stream, size, bits, own)`: stores what a triangle test without a `native` form needs, and the numbers of the
    rays, after the rest has been stored. own: see `KEPT_SIZE`."""
    test = TRIANGLE_TESTS[triangle_test]
    StreamRay, RayState, prepare = stream_ray(triangle_test), test.ray_state, test.prepare

    @wp.func_native("stream.data[k].state = state; stream.data[k].number = number;")
    def put_state(stream: wp.array(dtype=StreamRay), k: int, state: RayState, number: int): ...

    @native.func_native("lanes.h", f"return ((const int*)own.data)[{6 * LIST_LANES} + k];")
    def number_of(own: wp.array(dtype=float), k: int) -> int: ...

    @wp.func
    def vector(own: wp.array(dtype=float), k: int, component: int):
        x = load_float(own, component * wp.static(LIST_LANES) + k)
        y = load_float(own, (component + 1) * wp.static(LIST_LANES) + k)
        return wp.vec3(x, y, load_float(own, (component + 2) * wp.static(LIST_LANES) + k))

    @wp.func
    def prepare_kept(stream: wp.array(dtype=StreamRay), size: int, bits: wp.uint32, own: wp.array(dtype=float)):
        left = wp.uint32(bits)
        k = int(size)
        while left != wp.uint32(0):
            lane = lowest_bit(left)
            put_state(stream, k, prepare(vector(own, lane, 0), vector(own, lane, 3)), number_of(own, lane))
            left = left & (left - wp.uint32(1))
            k += 1

    return prepare_kept


@cache
def load_stream(triangle_test: str, room: int) -> wp.Function:
    """`wp.func(rays, begin, end, low, high, stream, size) -> count`: loads rays from `begin` on, until the stream is full or
    ray `end` is reached.

    Returns how many rays were loaded; `size` becomes the number of those that are in the stream. The others miss.

    Args:
        triangle_test: name of the triangle test.
        room: of a stream, in rays.

    Args (of the function): low, high: bounds of the scene.
    """
    StreamRay, load = stream_ray(triangle_test), load_lanes(triangle_test)
    prepared = bool(TRIANGLE_TESTS[triangle_test].native)
    prepare_kept, group = None if prepared else prepare_one_by_one(triangle_test), min(room, LIST_LANES)

    @wp.func
    def load_rays(
        rays: RayBatch,
        begin: int,
        end: int,
        low: wp.vec3,
        high: wp.vec3,
        stream: wp.array(dtype=StreamRay),
        size: wp.ref[int],
    ):
        own = wp.zeros(shape=(KEPT_SIZE,), dtype=float)
        place = int(0)
        kept = int(0)
        while begin + place < end and kept <= wp.static(room - group):
            count = wp.min(end - begin - place, wp.static(group))
            bits = load(rays, wp.vec2i(begin + place, count), low, high, stream, kept, place, own)
            if wp.static(not prepared):
                prepare_kept(stream, kept, bits, own)
            place += count
            kept += count_bits(bits)
        size = kept  # noqa: F841 (a reference)
        return place

    return load_rays


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
        code += f"static_assert({grid}::FLOATS == {box_memory(width)} && {grid}::ERROR == {BOX_ERROR!r}f);\n"
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
def load_root_lanes(triangle_test: str, width: int, order: int, boxes: bool) -> wp.Function:
    """`func(batch, wanted, tree, stream, list, lanes, own, state) -> bits`: loads the next rays, from `wanted[0]` on, at most
    `wanted[1]`, and stores and lists those that meet a child of the root.

    Returns the bits of the rays that were stored, of those in the lanes: rays may wait until others fill the lanes, or until
    there are no more (`wanted[1]` 0).

    list: words of the rays of the stream. lanes: see `kernels/native/stream_root.h`. own: see `KEPT_SIZE`.
    """
    form = f"{native_form(triangle_test)}, {width}, wrt::Order({order}), {int(boxes)}, {LIST_LANES}"
    rays = "batch, wanted[0], wanted[1], tree.low, tree.high"
    arguments = "stream.data, tree.bounds.data, list.data, lanes.data, own.data, state"

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
    StreamRay, load = stream_ray(triangle_test), load_root_lanes(triangle_test, width, order, boxes)
    prepared = bool(TRIANGLE_TESTS[triangle_test].native)
    lanes_size = (width + 1) * LIST_LANES + (box_memory(width) if boxes else 0)
    prepare_kept, group = None if prepared else prepare_one_by_one(triangle_test), min(room, LIST_LANES)
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
