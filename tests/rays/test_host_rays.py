"""Rays that kernels read where NumPy has them: which layouts need no copy, and that all give the same rays."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.engine.host_arrays import HostArray, address_of, as_array
from wrt.engine.rays.device_rays import lay_out
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import use_threads

N, H, W = 24, 4, 6
CENTER = np.array([1.0, -2.0, 0.5])
GENERATOR = np.random.default_rng(5)
POINTS, VECTORS = (GENERATOR.normal(size=(N, 3)).astype(np.float32) for _ in range(2))
POINT = POINTS[3]

IN_PLACE = {
    "each its own": (POINTS, VECTORS),
    "one origin": (POINT, VECTORS),
    "one origin with axes": (POINT[None, None], VECTORS.reshape(H, W, 3)),
    "one origin, broadcast": (np.broadcast_to(POINT, (N, 3)), VECTORS),
    "one origin in float64": (POINT.astype(np.float64), VECTORS),
    "one direction": (POINTS, VECTORS[0]),
    "a picture": (POINTS.reshape(H, W, 3), VECTORS.reshape(H, W, 3)),
    "a slice of rows": (POINTS[4:9], VECTORS[9:14]),
    "one component of stride 0 axes": (np.broadcast_to(POINT, (H, W, 3)), VECTORS.reshape(H, W, 3)),
    "read only": (np.frombuffer(POINTS.tobytes(), np.float32).reshape(N, 3), VECTORS),
}

COPIED = {
    "every second row": (POINTS[::2], VECTORS[::2]),
    "rows reversed": (POINTS[::-1], VECTORS),
    "columns of a table": (np.hstack([POINTS, VECTORS])[:, :3], np.hstack([POINTS, VECTORS])[:, 3:]),
    "column by column": (np.asfortranarray(POINTS), VECTORS),
    "float64": (POINTS.astype(np.float64), VECTORS),
    "directions in float64": (POINTS, VECTORS.astype(np.float64)),
    "origins by row": (POINTS[:H, None], VECTORS.reshape(H, W, 3)),
    "a row of directions for all": (POINTS.reshape(H, W, 3), VECTORS[:W]),
    "one ray": (POINTS[:1], VECTORS[:1]),
    "no rays": (POINTS[:0], VECTORS[:0]),
    "other bytes": (POINTS.astype(">f8"), VECTORS),
    "lists": (POINTS.tolist(), VECTORS.tolist()),
}


@pytest.mark.parametrize("name", [*IN_PLACE, *COPIED])
def test_rays_are_those_that_were_passed(name):
    """Stride by stride, relative to the centre where they were float64."""
    origins, directions = {**IN_PLACE, **COPIED}[name]
    arrays = lay_out(Rays(origins, directions), wp.get_device("cpu"), CENTER)
    assert isinstance(arrays.origins, HostArray) == (name in IN_PLACE)
    shape = np.broadcast_shapes(np.shape(origins)[:-1], np.shape(directions)[:-1])
    assert (arrays.shape, arrays.count) == (shape, int(np.prod(shape)))
    assert arrays.layout.centered == (np.asarray(origins).dtype != np.float32)
    batch, offset = arrays.batch, CENTER if arrays.layout.centered else 0.0
    for values, packed, stride, shift in (
        (origins, batch.origins, batch.origin_stride, offset),
        (directions, batch.directions, batch.direction_stride, 0.0),
    ):
        rows = packed.numpy()[np.arange(arrays.count) * stride]
        expected = (np.broadcast_to(np.asarray(values), (*shape, 3)) - shift).astype(np.float32).reshape(-1, 3)
        np.testing.assert_array_equal(rows, expected)


@pytest.mark.parametrize("name", IN_PLACE)
def test_nothing_is_copied(name):
    origins, directions = IN_PLACE[name]
    arrays = lay_out(Rays(origins, directions), wp.get_device("cpu"), CENTER)
    assert arrays.directions.ptr == directions.__array_interface__["data"][0]
    if not arrays.layout.centered:
        assert arrays.origins.ptr == origins.__array_interface__["data"][0]


def test_the_arrays_live_as_long_as_their_owner_is_needed():
    """A view, or a Warp array, keeps the memory."""
    array = HostArray(0, 0, wp.vec3, None)
    values = np.arange(30, dtype=np.float32).reshape(-1, 3)
    array = HostArray(values.__array_interface__["data"][0], len(values), wp.vec3, values)
    expected, view, packed = values.copy(), array.numpy(), as_array(array)
    del values, array
    gc.collect()
    np.testing.assert_array_equal(view, expected)
    np.testing.assert_array_equal(packed.numpy(), expected)
    assert view.shape == (10, 3)


@pytest.mark.parametrize(
    "values",
    [
        POINTS,
        POINTS[5:],
        POINTS[::-1],
        POINTS[:0],
        np.broadcast_to(POINT, (N, 3)),
        POINTS.astype(">f8"),
        POINTS.view(np.recarray),
    ],
    ids=["own", "part", "reversed", "empty", "repeated", "other bytes", "subclass"],
)
def test_the_address_of_an_array_is_numpys(values):
    """Read from the array object itself, which takes a tenth of the time of what NumPy offers."""
    assert address_of(values) == values.__array_interface__["data"][0]


def test_arrays_whose_contents_change_in_place_are_looked_at_again():
    """What is remembered of arrays follows from shapes, strides and types: views that are shuffled in place, or get many
    origins, are other rays at the next call."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")
    angle = np.linspace(0.0, 0.2, 40_000, dtype=np.float32)
    directions = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=1)
    origins = np.full_like(directions, 5.0)
    plan = scene.explain(origins, directions)
    assert plan.coherent
    assert plan.shared_origin
    origins += GENERATOR.normal(size=origins.shape).astype(np.float32)
    assert not scene.explain(origins, directions).shared_origin
    origins[:] = 5.0
    directions[:] = GENERATOR.normal(size=directions.shape)
    assert not scene.explain(origins, directions).coherent
    directions[:] = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=1)
    assert scene.explain(origins, directions) == plan


def test_out_of_range_origins_miss_without_a_warning():
    """An origin in float64 that float32 does not hold becomes infinite, which misses."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu")
    for bad in (1e300, -1e300, np.inf, np.nan):
        hits = scene.intersect(np.array([bad, 0.0, 0.0]), VECTORS.repeat(100, axis=0))
        assert not hits.is_hit.any()


def test_the_same_call_with_other_numbers_of_rays_and_threads():
    """The division of a call's rays into chunks, and its job, are remembered: other rays and threads must not get them."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=3), device="cpu")
    rays = GENERATOR.normal(size=(2, 60_000, 3)).astype(np.float32) * 3
    expected = scene.intersect(rays[0], -rays[0] + 0.2 * rays[1], traversal="brute").t
    for count, threads in ((60_000, 2), (60_000, 3), (5_000, 3), (60_000, 1), (59_999, 2), (60_000, 2)):
        with use_threads(threads):
            found = scene.intersect(rays[0][:count], (-rays[0] + 0.2 * rays[1])[:count], traversal="packet")
        np.testing.assert_array_equal(found.t, expected[:count])
