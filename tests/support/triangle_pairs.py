"""All rays against all triangles by one test."""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import launch
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import pack_blocks


@cache
def scalar_kernel(name: str):
    """The test's scalar form, on its own: item r * triangles + k is ray r against triangle k."""
    test = TRIANGLE_TESTS[name]
    prepare, intersect, load = test.prepare, test.intersect, test.record.load

    def run(
        first: int,
        records: wp.array(dtype=float),
        width: int,
        triangles: int,
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.vec3),
    ):
        i = first + wp.tid()
        ray = i / triangles
        out[i] = intersect(prepare(origins[ray], directions[ray]), load(records, i % triangles, width))

    return wp.kernel(run, module="unique", enable_backward=False, module_options={"fuse_fp": False})


@cache
def lane_kernel(name: str, width: int):
    """The test's lane form, on its own, with the same output."""
    test = TRIANGLE_TESTS[name]
    prepare, block_test = test.prepare, test.block_test(width)
    Lanes = lanes(width)

    def run(
        first: int,
        records: wp.array(dtype=float),
        blocks: int,
        triangles: int,
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.vec3),
    ):
        ray = first + wp.tid()
        state = prepare(origins[ray], directions[ray])
        for block in range(blocks):
            t = Lanes()
            u = Lanes()
            v = Lanes()
            mask = block_test(records, block, state, t, u, v)
            for lane in range(wp.static(width)):
                k = block * wp.static(width) + lane
                if k < triangles:
                    hit = wp.vec3(wp.nan, 0.0, 0.0)
                    if ((mask >> wp.uint32(lane)) & wp.uint32(1)) != wp.uint32(0):
                        hit = wp.vec3(t[lane], u[lane], v[lane])
                    out[ray * triangles + k] = hit

    return wp.kernel(run, module="unique", enable_backward=False, module_options={"fuse_fp": False})


def all_pairs(name: str, corners: np.ndarray, origins: np.ndarray, directions: np.ndarray, width: int, form: str, device: str):
    """(t, u, v) of all rays against all triangles: (rays, triangles, 3) float32, t NaN for a miss."""
    place = wp.get_device(device)
    count, rays = len(corners), len(origins)
    vertices = wp.array(corners.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=place)
    faces = wp.array(np.arange(3 * count, dtype=np.int32).reshape(-1, 3), dtype=wp.vec3i, device=place)
    ids = np.full(-(-count // width) * width, -1, dtype=np.int32)
    ids[:count] = np.arange(count)
    origin = origins[0].astype(np.float32).tolist()
    shared = np.array_equal(origins, np.broadcast_to(origins[0], origins.shape), equal_nan=True)
    assert shared or not TRIANGLE_TESTS[name].needs_shared_origin
    primitive = wp.array(ids, dtype=int, device=place)
    blocks = pack_blocks(TRIANGLE_TESTS[name].record, vertices, faces, primitive, width, origin)
    o = wp.array(origins.astype(np.float32), dtype=wp.vec3, device=place)
    d = wp.array(directions.astype(np.float32), dtype=wp.vec3, device=place)
    out = wp.zeros(rays * count, dtype=wp.vec3, device=place)
    if form == "scalar":
        launch(scalar_kernel(name), rays * count, [blocks.records, width, count, o, d, out], device=place)
    else:
        launch(lane_kernel(name, width), rays, [blocks.records, len(ids) // width, count, o, d, out], device=place)
    return out.numpy().reshape(rays, count, 3)
