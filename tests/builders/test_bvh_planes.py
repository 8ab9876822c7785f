"""The plane of a node: bins and costs against NumPy, whatever the number of bins, and ties."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.builders.bvh.bvh_config import MAX_BINS, BvhConfig
from wrt.builders.bvh.phases.bvh_bins import (
    Plane,
    Scratch,
    best_plane,
    bin_range,
    centroid_domain,
    make_binning,
    make_scratch,
)
from wrt.builders.cost import SplitCost, SurfaceAreaCost
from wrt.builders.triangle_boxes import Boxes, boxes_of
from wrt.builders.triangle_references import write_references, write_sizes
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

CPU = wp.get_device("cpu")


@exact_kernel
def find_plane(
    first: int,
    boxes: Boxes,
    count: int,
    bins: int,
    cost: SplitCost,
    references: wp.array(dtype=float),
    domain: wp.array(dtype=float),
    scratch: Scratch,
    planes: wp.array(dtype=Plane),
):
    write_references(boxes, 0, count, references)
    write_sizes(references, 0, count)
    centroid_domain(references, 0, count, domain, 0)
    binning = make_binning(domain, 0, bins)
    bin_range(references, 0, count, binning, scratch, 0)
    planes[0] = best_plane(cost, scratch, 0, bins, binning.axes, count)


def plane_of(low: np.ndarray, high: np.ndarray, bins: int, config: BvhConfig) -> tuple[float, int, int, int]:
    """Cost, axis, bin and triangles on the left, by the kernels' functions."""
    boxes, count = boxes_of(low, high).boxes, len(low)
    references, domain = wp.empty(8 * count, dtype=float, device=CPU), wp.empty(8, dtype=float, device=CPU)
    planes = wp.empty(1, dtype=Plane, device=CPU)
    inputs = [boxes, count, bins, config.cost.struct(), references, domain, make_scratch(1, CPU), planes]
    launch(find_plane, 1, inputs, device=CPU)
    return tuple(planes.numpy()[0].tolist())


def area(low: np.ndarray, high: np.ndarray) -> np.float32:
    x, y, z = high - low
    return x * y + y * z + z * x


def sizes_of(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """127 plus the binary logarithm of the areas, linear between powers of two; 0 for none."""
    areas = area(low.T, high.T)
    mantissa, exponent = np.frexp(areas)
    return np.where(areas > 0, exponent + 126 + (2 * mantissa - 1), 0).astype(np.float32)


def plane_by_numpy(low: np.ndarray, high: np.ndarray, bins: int, config: BvhConfig) -> tuple[float, int, int, int]:
    """The same, plane by plane: the first of the least cost."""
    one, width = np.float32(1.0), config.cost.width
    block = np.float32(config.cost.block)
    sizes = sizes_of(low, high)
    doubled = np.concatenate([low + high, -sizes[:, None]], axis=1)
    axes = 4 if np.ptp(sizes) > 8 else 3
    first, extent = doubled.min(axis=0), doubled.max(axis=0) - doubled.min(axis=0)
    with np.errstate(all="ignore"):
        scale = np.where(extent > 0, np.float32(bins) / extent, np.float32(0)).astype(np.float32)
    found = np.clip((doubled - first) * scale, 0, bins - one).astype(int)
    best = (np.float32(np.inf), 0, 0, 0)
    for axis in range(axes):
        for b in range(1, bins):
            left = found[:, axis] < b
            if left.any() and not left.all():
                sides = [(low[side].min(axis=0), high[side].max(axis=0), int(side.sum())) for side in (left, ~left)]
                costs = [area(*box) * (block * np.float32(-(-count // width))) for *box, count in sides]
                if costs[0] + costs[1] < best[0]:
                    best = costs[0] + costs[1], axis, b, sides[0][2]
    return tuple(map(float, best[:1])) + best[1:]


@pytest.mark.parametrize("bins", [2, 7, 8, 16, MAX_BINS])
def test_the_plane_is_the_first_of_the_least_cost(bins):
    """In order, so that neighbours share bins, and not; with few triangles, and with an odd number above those of one grid."""
    rng = np.random.default_rng(bins)
    config = BvhConfig(SurfaceAreaCost(width=8))
    for count in (2, 3, 17, 64, 65, 128, 301):
        center = rng.uniform(-1, 1, (count, 3)).astype(np.float32)
        center = center if count % 2 else center[np.argsort(center[:, 0])]
        half = rng.uniform(0, 0.1, (count, 3)).astype(np.float32)
        low, high = center - half, center + half
        assert plane_of(low, high, bins, config) == plane_by_numpy(low, high, bins, config), count


@pytest.mark.parametrize("bins", [7, 16, MAX_BINS])
def test_size_is_an_axis_where_it_varies(bins):
    """Boxes of very different sizes: planes as NumPy finds them, and some of them by size."""
    rng = np.random.default_rng(bins)
    config = BvhConfig(SurfaceAreaCost(width=8))
    axes = set()
    for count in (17, 64, 128, 301):
        center = rng.uniform(-1, 1, (count, 3)).astype(np.float32)
        half = (rng.uniform(0, 1, (count, 3)) * 10.0 ** rng.uniform(-4, 0, (count, 1))).astype(np.float32)
        low, high = center - half, center + half
        found = plane_of(low, high, bins, config)
        assert found == plane_by_numpy(low, high, bins, config), count
        axes.add(found[1])
    assert 3 in axes


def test_a_floor_is_separated_from_what_stands_on_it():
    """No plane in space has a floor's two triangles on one side and the pebbles on the other; their sizes do."""
    rng = np.random.default_rng(0)
    center = rng.uniform([-1, -1, 0], [1, 1, 0.01], (100, 3)).astype(np.float32)
    low, high = center - np.float32(0.001), center + np.float32(0.001)
    low[[10, 60]], high[[10, 60]] = (-20, -20, 0), (20, 20, 0)
    assert plane_of(low, high, 16, BvhConfig(SurfaceAreaCost(width=8)))[1:] == (3, 1, 2)


def test_ties_go_to_the_smaller_axis_and_bin():
    """Eight cubes in the corners of a cube: planes along all axes, and those in the gap between, cost the same."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
    config = BvhConfig(SurfaceAreaCost(width=4))
    assert plane_of(corners, corners + np.float32(0.25), 16, config)[1:] == (0, 1, 4)
    turned = corners * np.array([0, 1, 1], dtype=np.float32)
    assert plane_of(turned, turned + np.float32(0.25), 16, config)[1:] == (1, 1, 4)


def test_no_plane_divides_equal_boxes():
    low = np.zeros((100, 3), dtype=np.float32)
    assert plane_of(low, low + np.float32(1), 16, BvhConfig())[0] == np.inf
