"""Packs a mesh's triangles, given as a list of ids, into the blocks that a triangle test reads."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.launch import kept, launch, load, specialise
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.runtime.workspace import give_back, host_view, set_flat, take
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS, Record, TriangleBlocks, load_corners

CHUNK = 2048
"""Records that are worth a chunk of their own."""


@native.func_native(
    "leaf.h",
    f"""static_assert(wrt::VERTEX_COMPONENTS == {VERTEX_COMPONENTS});
    const float* const points = (const float*)vertices.data;
    float* const to = records.data + (size_t)(slot / width) * components * width + slot % width;
    wrt::copy_corners(points, (const int*)faces.data, primitive.data[slot], width, none, to);""",
)
def copy_corners(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    primitive: wp.array(dtype=int),
    slot: int,
    width: int,
    components: int,
    none: float,
    records: wp.array(dtype=float),
):
    """Writes the vertices of a record; `none` for those of an unused lane. Native, because Warp's
    indexing computes the address of each element anew."""


@wp.func_native("records.data[(size_t)(slot / width) * components * width + component * width + slot % width] = value;")
def store_component(records: wp.array(dtype=float), slot: int, width: int, components: int, component: int, value: float):
    """Writes a component of a record."""


@cache
def make_packing_kernel(record: Record) -> wp.Kernel:
    """The kernel that writes records of one kind."""
    derive, own, components = record.derive, record.own, record.components
    corners_of = load_corners(components)

    def pack_records(
        first: int,
        vertices: wp.array(dtype=wp.vec3),
        faces: wp.array(dtype=wp.vec3i),
        primitive: wp.array(dtype=int),
        width: int,
        origin: wp.vec3,
        records: wp.array(dtype=float),
    ):
        slot = first + wp.tid()
        copy_corners(vertices, faces, primitive, slot, width, wp.static(components), wp.nan, records)
        if wp.static(own > 0):
            values = derive(corners_of(records, slot, width), origin)
            for c in range(wp.static(own)):
                store_component(records, slot, width, wp.static(components), wp.static(VERTEX_COMPONENTS) + c, values[c])

    return specialised_kernel(pack_records)


def pack_blocks(
    record: Record,
    vertices: wp.array,
    faces: wp.array,
    primitive: wp.array,
    width: int,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    earlier: "TriangleBlocks | None" = None,
    allocate: Callable[..., wp.array] = wp.empty,
) -> TriangleBlocks:
    """Packs triangles into blocks.

    Args:
        record: the kind of record.
        vertices: (V,) vec3, relative to the scene's centre.
        faces: (F,) vec3i.
        primitive: (blocks * width,) int32 triangle ids, -1 in unused lanes.
        width: triangles per block.
        origin: the common origin of all rays, relative to the scene's centre, for a record that depends on it.
        earlier: blocks of the same kind for the first of these ids; they are copied instead of recomputed.
        allocate: allocates the array of records; same signature as `wp.empty`.

    Raises:
        RuntimeError: a graph is being captured on the device.
    """
    device = vertices.device
    if earlier is None and 0 < len(primitive) <= CHUNK and device.is_cpu and not device.is_capturing:
        return pack_few(record, vertices, faces, primitive, width, origin)
    blocks = TriangleBlocks()
    blocks.primitive = primitive
    done = 0 if earlier is None else len(earlier.primitive)
    with kept(device):
        blocks.records = allocate(len(primitive) * record.components, dtype=float, device=device)
        if done:
            wp.copy(blocks.records, earlier.records)
        if done < len(primitive):
            ids, records = primitive, blocks.records
            if done:  # views take as long to make as small arrays to fill
                ids, records = ids[done:], records[done * record.components :]
            inputs = [vertices, faces, ids, width, wp.vec3(*origin), records]
            launch(specialise(make_packing_kernel, record), len(primitive) - done, inputs, device=device, chunk=CHUNK)
    return blocks


def pack_few(
    record: Record, vertices: wp.array, faces: wp.array, primitive: wp.array, width: int, origin: tuple[float, float, float]
) -> TriangleBlocks:
    """`pack_blocks` of new blocks on the CPU, by the calling thread: for few triangles, every allocation and check counts.

    The arguments of the kernel are kept from scene to scene, and refer to other arrays each time.
    """
    slots, blocks = len(primitive), TriangleBlocks()
    records = host_view(np.empty(slots * record.components, dtype=np.float32), wp.float32)
    set_flat(blocks, "primitive", primitive)
    set_flat(blocks, "records", records)
    few = take((pack_few, record)) or FewRecords(record, [vertices, faces, primitive, width, wp.vec3(*origin), records])
    arguments = few.packed.arguments
    for field, array in zip(few.fields, (vertices, faces, primitive, records), strict=True):
        field.data, field.shape[0] = array.ptr, array.size
    arguments.p4, arguments.p5 = width, wp.vec3(*origin)
    few.packed.call_own_range(0, slots)
    give_back((pack_few, record), few)
    return blocks


class FewRecords:
    """The kernel that packs records of a kind, for one caller at a time; `fields` are the packed forms of its arrays."""

    def __init__(self, record: Record, inputs: list[Any]) -> None:
        kernel, device = specialise(make_packing_kernel, record), inputs[0].device
        load([kernel], device)
        self.packed = PackedKernel(kernel, [0, *inputs], device)
        self.packed.forget(())
        self.fields = [self.packed.argument(index) for index in (1, 2, 3, 6)]
