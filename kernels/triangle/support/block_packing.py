"""Packs a mesh's triangles, given as a list of ids, into the blocks that a triangle test reads."""

from collections.abc import Callable
from functools import cache

import warp as wp

from wrt.kernels.runtime.launch import kept, launch, specialise
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS, Corners, Record, TriangleBlocks

exact_module(__name__)

CHUNK = 2048
"""Records that are worth a chunk of their own."""


@cache
def make_kernel(record: Record) -> wp.Kernel:
    """The kernel that writes records of one kind."""
    derive, own, components = record.derive, record.own, record.components

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
        triangle = primitive[slot]
        corners = Corners()
        corners.a = wp.vec3(wp.nan, wp.nan, wp.nan)
        corners.b = corners.a
        corners.c = corners.a
        if triangle >= 0:
            face = faces[triangle]
            corners.a = vertices[face[0]]
            corners.b = vertices[face[1]]
            corners.c = vertices[face[2]]
        at = (slot / width) * wp.static(components) * width + slot % width
        for axis in range(3):
            records[at + axis * width] = corners.a[axis]
            records[at + (3 + axis) * width] = corners.b[axis]
            records[at + (6 + axis) * width] = corners.c[axis]
        if wp.static(own > 0):
            values = derive(corners, origin)
            for c in range(wp.static(own)):
                records[at + (wp.static(VERTEX_COMPONENTS) + c) * width] = values[c]

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
    blocks, device = TriangleBlocks(), vertices.device
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
            launch(specialise(make_kernel, record), len(primitive) - done, inputs, device=device, chunk=CHUNK)
    return blocks
