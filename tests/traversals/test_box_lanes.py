"""The lane loop of one ray over child boxes against its twin in plain Warp, bit for bit; packets: test_packet_cullings.py."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT, intersected_boxes, nearest_child, ray_boxes
from wrt.kernels.simd.boxes import ray_slabs, slab_interval
from wrt.kernels.simd.lanes import lanes

pytestmark = pytest.mark.width

WIDTHS = (2, 4, 8, 16)
RAYS, NODES = 400, 6


def make_kernel(width: int) -> wp.Kernel:
    keys_of, boxes_met, nearest, Lanes = ray_boxes(width), intersected_boxes(width), nearest_child(width), lanes(width)

    def compare(
        bounds: wp.array(dtype=float),
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        nodes: int,
        twin: wp.array2d(dtype=wp.vec2),
        entry: wp.array2d(dtype=float),
        met: wp.array2d(dtype=int),
        keys: wp.array2d(dtype=int),
        least: wp.array2d(dtype=int),
    ):
        i = wp.tid()
        slabs = ray_slabs(origins[i], directions[i], 4.0)
        for node in range(nodes):
            at = Lanes()
            mask = boxes_met(bounds, node, slabs, 0.25, 3.0, at)
            row = wp.zeros(shape=(wp.static(width),), dtype=int)
            least[i, node] = keys_of(bounds, node, slabs, 0.25, 3.0, row, 0)
            if nearest(row, 0) != least[i, node]:
                least[i, node] = -1
            for lane in range(wp.static(width)):
                first = node * 6 * wp.static(width) + lane
                low = wp.vec3(bounds[first], bounds[first + wp.static(width)], bounds[first + 2 * wp.static(width)])
                high = wp.vec3(
                    bounds[first + 3 * wp.static(width)],
                    bounds[first + 4 * wp.static(width)],
                    bounds[first + 5 * wp.static(width)],
                )
                place = node * wp.static(width) + lane
                twin[i, place] = slab_interval(slabs, low, high)
                entry[i, place] = at[lane]
                met[i, place] = int((mask >> wp.uint32(lane)) & wp.uint32(1))
                keys[i, place] = row[lane]

    return wp.kernel(compare, module="unique", enable_backward=False, module_options={"fuse_fp": False})


def random_nodes(rng: np.random.Generator, width: int) -> np.ndarray:
    """Bounds of NODES nodes: boxes of all sizes, flat ones, and an unused lane each."""
    corners = rng.integers(-8, 9, (2, NODES, 3, width)) / 8.0
    low, high = corners.min(axis=0), corners.max(axis=0)
    low[:, :, -1], high[:, :, -1] = np.inf, -np.inf
    return np.concatenate([low, high], axis=1).astype(np.float32).ravel()


@pytest.mark.parametrize("width", WIDTHS)
def test_lanes_equal_the_twin(width, device):
    """Boxes of all sizes, flat and empty ones; origins in planes of faces; directions with components of 0."""
    rng = np.random.default_rng(width)
    bounds = random_nodes(rng, width)
    origins = (rng.integers(-12, 13, (RAYS, 3)) / 8.0).astype(np.float32)
    directions = rng.normal(size=(RAYS, 3)).astype(np.float32)
    directions[rng.random((RAYS, 3)) < 0.2] = 0.0
    directions[rng.random((RAYS, 3)) < 0.05] = -0.0
    out = [wp.zeros((RAYS, NODES * width), dtype=kind, device=device) for kind in (wp.vec2, float, int, int)]
    least = wp.zeros((RAYS, NODES), dtype=int, device=device)
    arrays = [wp.array(bounds, dtype=float, device=device)]
    arrays += [wp.array(values, dtype=wp.vec3, device=device) for values in (origins, directions)]
    wp.launch(make_kernel(width), RAYS, [*arrays, NODES, *out, least], device=device)
    twin, entry, met, keys = (array.numpy() for array in out)
    enter, leave = np.maximum(twin[..., 0], np.float32(0.25)), np.minimum(twin[..., 1], np.float32(3.0))
    np.testing.assert_array_equal(entry.view(np.int32), enter.astype(np.float32).view(np.int32))
    np.testing.assert_array_equal(met, enter <= leave)
    assert 0.005 < met.mean() < 0.8
    assert not met.reshape(RAYS, NODES, width)[:, :, -1].any()
    lane = np.arange(NODES * width) % width
    expected = np.where(met, (entry.view(np.int32) & -width) | lane, NO_CHILD_CONSTANT)
    np.testing.assert_array_equal(keys, expected)
    np.testing.assert_array_equal(least.numpy(), expected.reshape(RAYS, NODES, width).min(axis=2))
