"""The box test of interleaved walks, by multiply-adds: what the test of `wrt.kernels.simd.boxes` meets, it meets, no later."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wrt.kernels.layout.ray_batch import FARTHEST, usable_direction
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, reach, slab_interval
from wrt.kernels.simd.lanes import FOR_LANES
from wrt.kernels.traversal.interleaved.slot_boxes import MEET, SET_SLOT, SLOT

pytestmark = pytest.mark.width

WIDTH = 8
exact_module(__name__)


@wp.func_native(f"""{FOR_LANES}
    enum {{ W = {WIDTH} }};
{SLOT}{SET_SLOT}{MEET}
    float numbers[12];
    for (int a = 0; a < 3; ++a) {{
        numbers[a] = slabs.inverse.c[a]; numbers[3 + a] = slabs.origin_in.c[a]; numbers[6 + a] = slabs.origin_out.c[a];
        numbers[9 + a] = 1.0f;
    }}
    Slot slot;
    wrt_set_boxes(slot, numbers, numbers + 3, numbers + 6);
    slot.t_min = t_min; slot.t_max = t_max;
    wrt_meet(slot, (const char*)(bounds.data + node * 6 * W), entry.data + node * W, met.data + node * W);
""")
def meet(
    bounds: wp.array(dtype=float),
    node: int,
    slabs: RaySlabs,
    t_min: float,
    t_max: float,
    entry: wp.array(dtype=float),
    met: wp.array(dtype=int),
):
    """Tests a ray against the W boxes of a node."""
    ...


@wp.kernel(enable_backward=False)
def compare(
    bounds: wp.array(dtype=float),
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    ranges: wp.array(dtype=wp.vec2),
    entry: wp.array(dtype=float),
    met: wp.array(dtype=int),
    exact: wp.array(dtype=wp.vec2),
):
    """Ray i against node i, whose boxes make up a scene."""
    i = wp.tid()
    first = i * 6 * WIDTH
    low = wp.vec3(wp.inf, wp.inf, wp.inf)
    high = -low
    for lane in range(WIDTH):
        low = wp.min(low, wp.vec3(bounds[first + lane], bounds[first + WIDTH + lane], bounds[first + 2 * WIDTH + lane]))
        at = first + 3 * WIDTH + lane
        high = wp.max(high, wp.vec3(bounds[at], bounds[at + WIDTH], bounds[at + 2 * WIDTH]))
    slabs = ray_slabs(origins[i], usable_direction(directions[i]), reach(origins[i], low, high))
    meet(bounds, i, slabs, ranges[i][0], ranges[i][1], entry, met)
    for lane in range(WIDTH):
        at = first + lane
        interval = slab_interval(
            slabs,
            wp.vec3(bounds[at], bounds[at + WIDTH], bounds[at + 2 * WIDTH]),
            wp.vec3(bounds[at + 3 * WIDTH], bounds[at + 4 * WIDTH], bounds[at + 5 * WIDTH]),
        )
        exact[i * WIDTH + lane] = wp.vec2(wp.max(interval[0], ranges[i][0]), wp.min(interval[1], ranges[i][1]))


def run(low, high, origins, directions, ranges) -> tuple[np.ndarray, ...]:
    """Tests n rays against n nodes of 8 boxes: (met, t of entry) by multiply-adds, then by the exact test."""
    n = len(origins)
    bounds = np.concatenate([low.transpose(0, 2, 1), high.transpose(0, 2, 1)], axis=1).astype(np.float32)
    entry, met = wp.zeros(n * WIDTH, dtype=float, device="cpu"), wp.zeros(n * WIDTH, dtype=int, device="cpu")
    exact = wp.zeros(n * WIDTH, dtype=wp.vec2, device="cpu")
    vectors = [wp.array(values.astype(np.float32), dtype=wp.vec3, device="cpu") for values in (origins, directions)]
    spans = wp.array(ranges.astype(np.float32), dtype=wp.vec2, device="cpu")
    wp.launch(compare, n, [wp.array(bounds.ravel(), device="cpu"), *vectors, spans, entry, met, exact], device="cpu")
    enter, leave = exact.numpy().T
    return met.numpy() != 0, entry.numpy(), enter <= leave, enter


def check(*numbers) -> tuple[float, float]:
    """Compares the two tests. Returns the fractions of boxes met by the exact one, and by the other alone."""
    met, entry, expected, enter = run(*numbers)
    assert not (expected & ~met).any()
    assert (entry[expected] <= enter[expected]).all()
    return expected.mean(), (met & ~expected).mean()


def cases(rng: np.random.Generator, n: int, scale: float, offset: float) -> list[np.ndarray]:
    """Boxes of a scene of this size, many of them flat along some axis; origins within, far away and on planes; directions of
    any length, many of them with zeros or tiny components."""
    a, b = rng.uniform(-1, 1, (2, n, WIDTH, 3)) * scale
    low, high = np.minimum(a, b).astype(np.float32), np.maximum(a, b).astype(np.float32)
    flat = rng.random(low.shape) < 0.33
    high[flat] = low[flat]
    shift = (rng.uniform(-1, 1, (n, 1, 3)) * offset).astype(np.float32)
    low, high = low + shift, high + shift
    far = np.where(rng.random((n, 1)) < 0.3, 100.0, 1.0)
    origins = (rng.uniform(-1, 1, (n, 3)) * scale * far).astype(np.float32) + shift[:, 0]
    on_plane = rng.random((n, 3)) < 0.3
    origins = np.where(on_plane, low[:, 0], origins)
    aims = (low[:, 1] + (high[:, 1] - low[:, 1]) * rng.random((n, 3), dtype=np.float32)) - origins
    directions = np.where(rng.random((n, 1)) < 0.5, aims, rng.normal(size=(n, 3)) * scale) * 10.0 ** rng.uniform(-6, 6, (n, 1))
    small = rng.random((n, 3))
    tiny = directions * 10.0 ** rng.uniform(-30, 0, (n, 3))
    directions = np.where(small < 0.15, 0.0, np.where(small < 0.3, tiny, directions))
    directions[small[:, 0] < 0.03] *= -0.0
    directions[~np.any(np.abs(directions.astype(np.float32)) >= 1.2e-38, axis=1)] = (0.0, -1.0, 0.0)
    starts = np.where(rng.random(n) < 0.7, 0.0, rng.random(n) * 0.5)
    ends = np.where(rng.random(n) < 0.5, FARTHEST, starts + rng.random(n) * 2)
    return [low, high, origins, directions, np.stack([starts, ends], axis=1)]


@pytest.mark.parametrize("offset", [0.0, 1.0, 1000.0])
def test_no_box_is_lost(offset):
    """Scenes of every size, at the origin and far from it."""
    rng = np.random.default_rng(int(offset))
    for exponent in (-40, -37, -30, -12, -3, 0, 3, 8, 15, 25, 30):
        with np.errstate(over="ignore", under="ignore"):
            met, more = check(*cases(rng, 4000, 10.0**exponent, offset * 10.0**exponent))
        assert met > 0.02
        if -12 <= exponent <= 8 and offset <= 1:
            assert more < 0.02  # and few boxes more are met


def test_directions_too_short_for_products():
    """origin / direction overflows: no box is lost, and empty ones, whose planes are at infinity, are not met."""
    rng = np.random.default_rng(5)
    low, high, origins, directions, ranges = cases(rng, 4000, 1.0, 0.0)
    directions = directions / np.abs(directions).max(axis=1, keepdims=True) * 10.0 ** rng.uniform(-37, -25, (4000, 1))
    ranges[:, 1] = FARTHEST
    assert check(low, high, origins, directions, ranges)[0] > 0.02


@pytest.mark.parametrize("exponent", [-37, -25, 0, 30])
def test_empty_children_are_not_met(exponent):
    """Unused lanes of a node: low = inf, high = -inf."""
    rng = np.random.default_rng(6)
    low, high, origins, directions, ranges = cases(rng, 1000, 1.0, 0.0)
    directions = directions / np.abs(directions).max(axis=1, keepdims=True) * 10.0**exponent
    low[:, 5:], high[:, 5:] = np.inf, -np.inf
    assert not run(low, high, origins, directions, ranges)[0].reshape(-1, WIDTH)[:, 5:].any()
