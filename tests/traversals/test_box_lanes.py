"""The lane loops over child boxes against their twin in plain Warp, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.engine.rays.device_rays import to_device
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT, intersected_boxes, nearest_child, ray_boxes
from wrt.kernels.simd.boxes import ray_slabs, slab_interval
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.traversal.packet.core.packet_cells import enter_box
from wrt.kernels.traversal.packet.culling.interval_culling import cull_boxes
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import load_packet

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


PACKET = 32


def make_packet_kernel(width: int, shared_origin: bool) -> wp.Kernel:
    layout = PacketLayout(PACKET, width, shared_origin, "woop")
    load, keys_of, size = load_packet(layout), cull_boxes(layout), layout.size

    def compare(
        rays: RayBatch,
        bounds: wp.array(dtype=float),
        nodes: int,
        twin: wp.array2d(dtype=wp.vec2),
        keys: wp.array2d(dtype=int),
        mixed: wp.array(dtype=int),
    ):
        i = wp.tid()
        packet = wp.zeros(shape=(size,), dtype=float)
        row = wp.zeros(shape=(wp.static(width),), dtype=int)
        around = PacketBounds()
        load(rays, i * PACKET, wp.vec3(-1.0, -1.0, -1.0), wp.vec3(1.0, 1.0, 1.0), packet, around)
        mixed[i] = around.mixed_axes
        for node in range(nodes):
            keys_of(bounds, node, packet, around, row, 0)
            for lane in range(wp.static(width)):
                first = node * 6 * wp.static(width) + lane
                low = wp.vec3(bounds[first], bounds[first + wp.static(width)], bounds[first + 2 * wp.static(width)])
                high = wp.vec3(
                    bounds[first + 3 * wp.static(width)],
                    bounds[first + 4 * wp.static(width)],
                    bounds[first + 5 * wp.static(width)],
                )
                twin[i, node * wp.static(width) + lane] = enter_box(around, low, high)
                keys[i, node * wp.static(width) + lane] = row[lane]

    return wp.kernel(compare, module="unique", enable_backward=False, module_options={"fuse_fp": False})


@pytest.mark.parametrize("shared_origin", [False, True])
@pytest.mark.parametrize("width", [4, 16])
def test_packet_lanes_equal_the_twin(width, shared_origin, device):
    """Interval culling of W boxes against one box in plain Warp: beams of one sign, of both, along axes, in planes of faces."""
    rng = np.random.default_rng(width)
    packets = 200
    bounds = random_nodes(rng, width)
    eyes = (rng.integers(-12, 13, (packets, 1, 3)) / 8.0).repeat(PACKET, axis=1)
    if shared_origin:
        eyes[:] = eyes[0, 0]
    else:
        eyes += rng.normal(size=eyes.shape) * rng.choice([0.0, 0.01, 0.2], (packets, 1, 1))
    directions = rng.normal(size=(packets, 1, 3)) + rng.normal(size=(packets, PACKET, 3)) * rng.choice(
        [0.05, 0.5], (packets, 1, 1)
    )
    directions[rng.random(packets) < 0.2, :, 0] = 0.0
    origins = eyes[0, 0] if shared_origin else eyes.reshape(-1, 3)
    rays = wrt.Rays(origins.astype(np.float32), directions.reshape(-1, 3).astype(np.float32), 0.25, 3.0)
    batch = to_device(rays, wp.get_device(device), np.zeros(3)).batch
    twin = wp.zeros((packets, NODES * width), dtype=wp.vec2, device=device)
    keys = wp.zeros((packets, NODES * width), dtype=int, device=device)
    mixed = wp.zeros(packets, dtype=int, device=device)
    inputs = [batch, wp.array(bounds, dtype=float, device=device), NODES, twin, keys, mixed]
    wp.launch(make_packet_kernel(width, shared_origin), packets, inputs, device=device)
    enter, leave = np.moveaxis(twin.numpy(), -1, 0)
    met = enter <= leave
    expected = np.where(met, (enter.copy().view(np.int32) & -width) | np.arange(NODES * width) % width, NO_CHILD_CONSTANT)
    np.testing.assert_array_equal(keys.numpy(), expected)
    assert 0.005 < met.mean() < 0.95
    assert (mixed.numpy() == 0).any()
    assert (mixed.numpy() > 0).any()
