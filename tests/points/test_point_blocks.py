"""Closest points block by block: the answers of one call, limits and masks of each point, executors, jobs, refusals."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from support.meshes import SCENES
from support.point_oracles import points_around

import wrt

BLOCK = 320 * 300
"""Memory for 300 points."""


def parts_of(blocks: wrt.batches.Blocks, name: str) -> np.ndarray:
    """An attribute of all blocks."""
    return np.concatenate([getattr(answer, name) for _, answer in blocks])


@pytest.fixture(scope="module")
def scene():
    return wrt.Scene(SCENES["teapot"](), device="cpu")


@pytest.fixture(scope="module")
def points(scene):
    return points_around(scene.meshes[0], 2000)


@pytest.mark.parametrize("precise", [False, True])
def test_as_in_one_call(scene, points, precise, tmp_path):
    """Arrays, memory-mapped files, a greatest distance for each point, features and positions."""
    most = np.linspace(0.0, 2.0, len(points))
    whole = scene.closest_point(points, max_distance=most, precise=precise)
    assert 0.1 < whole.is_hit.mean() < 0.9
    np.save(tmp_path / "points.npy", points)
    mapped = np.load(tmp_path / "points.npy", mmap_mode="r")
    blocks = scene.closest_point_blocks(mapped, max_distance=most, memory=BLOCK, precise=precise)
    assert len(blocks) >= 7
    for name in ("distance", "feature", "primitive_id", "position", "uv"):
        np.testing.assert_array_equal(parts_of(blocks, name), getattr(whole, name))
        assert parts_of(blocks, name).dtype == getattr(whole, name).dtype
    found = np.zeros(len(points), dtype=whole.t.dtype)
    assert blocks.write({"t": found}) == len(points)
    np.testing.assert_array_equal(found, whole.distance)


def test_reductions_and_executors(scene, points):
    whole = scene.closest_point(points)
    grid = points.reshape(40, 50, 3)
    farthest = scene.closest_point_blocks(grid, memory=BLOCK, reduce={"t": "max"}, axis=1).result()["t"]
    np.testing.assert_array_equal(farthest, whole.distance.reshape(40, 50).max(axis=1))
    with ThreadPoolExecutor(2) as executor:
        blocks = scene.closest_point_blocks(points, memory=BLOCK, executor=executor, reduce={"t": "min", "is_hit": "sum"})
        assert blocks.result() == {"t": whole.distance.min(), "is_hit": len(points)}


def test_jobs(scene, points, tmp_path):
    """Some blocks now, the others later; another distance is another job."""
    blocks = scene.closest_point_blocks(points, memory=BLOCK)
    assert wrt.cluster.Job(tmp_path / "job", blocks).run(most=2).status.done == 2
    result = wrt.cluster.Job(tmp_path / "job", blocks).run().result()
    whole = scene.closest_point(points)
    for name in ("t", "primitive_id", "geometry_id"):
        np.testing.assert_array_equal(result[name], getattr(whole, name))
    for other in (
        scene.closest_point_blocks(points, memory=BLOCK, max_distance=1.0),
        scene.closest_point_blocks(points, memory=BLOCK, precise=True),
        scene.intersect_blocks(points, [0, 0, 1], memory=BLOCK),
    ):
        with pytest.raises(ValueError, match="was begun with"):
            wrt.cluster.Job(tmp_path / "job", other)


def test_masks_of_points(points):
    """Rows of masks are cut with the points."""
    box = trimesh.creation.box((1, 1, 1))
    placed = [wrt.Instance(box, trimesh.transformations.translation_matrix([3 * i, 0, 0]), mask=1 << i) for i in range(2)]
    scene, mask = wrt.Scene(placed, device="cpu"), np.arange(2000) % 2 + 1
    found = parts_of(scene.closest_point_blocks(points, mask=mask, memory=BLOCK), "instance_id")
    np.testing.assert_array_equal(found, mask - 1)


def test_arrays_of_dask(scene, points):
    """By Dask's threads, which the answers do not depend on."""
    da, xarray = pytest.importorskip("dask.array"), pytest.importorskip("xarray")
    lazy, map_points = da.from_array(points, chunks=(700, 3)), wrt.cluster.map_points
    for precise in (False, True):
        whole = scene.closest_point(points, max_distance=40.0, precise=precise)
        for name in ("distance", "feature", "instance_id", "primitive_id", "uv", "position", "normal", "is_hit"):
            answer = map_points(scene, lazy, name, max_distance=40.0, precise=precise)
            expected, found = getattr(whole, name), answer.compute(scheduler="threads")
            assert (answer.dtype, answer.shape, answer.chunks[0]) == (expected.dtype, expected.shape, (700, 700, 600))
            np.testing.assert_array_equal(found, expected)
    near, far = map_points(scene, lazy, "is_hit", max_distance=0.5), map_points(scene, lazy, "is_hit")
    assert near.name != far.name  # so that both may be in one computation
    assert near.sum().compute() < far.sum().compute() == len(points)
    labelled = map_points(scene, xarray.DataArray(lazy, dims=["sample", "axis"]))
    assert (labelled.dims, labelled.name) == (("sample",), "distance")
    with pytest.raises(ValueError, match="choose from distance"):
        map_points(scene, lazy, "t")
    with pytest.raises(ValueError, match=r"points must have shape \(\.\.\., 3\)"):
        map_points(scene, lazy[:, :2])
    whole = lazy[:4].astype(np.int32)
    assert map_points(scene, whole, "position").dtype == scene.closest_point(np.zeros((1, 3), np.int32)).position.dtype
    with pytest.raises(TypeError, match="k is not an option of map_points; choose from mask"):
        map_points(scene, lazy, k=2)
    with pytest.raises(TypeError, match="max_distance must be a number"):  # chunks would not take their parts of it
        map_points(scene, lazy, max_distance=np.ones(700))
    with pytest.raises(TypeError, match="points must be an array of Dask"):
        map_points(scene, points)


REFUSED = {
    "one point": (ValueError, {"points": np.zeros(3)}, "points must have a leading axis"),
    "iterator": (TypeError, {"points": iter([np.zeros((2, 3))])}, "points must be an array"),
    "negative": (ValueError, {"points": np.zeros((2, 3)), "max_distance": -1.0}, "max_distance must be 0 or more"),
    "shapes": (ValueError, {"points": np.zeros((2, 3)), "max_distance": np.ones(3)}, r"max_distance \(3,\) does not broadcast"),
    "reduce": (ValueError, {"points": np.zeros((2, 3)), "reduce": {"height": "max"}}, "reduce has the key 'height'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(scene, case):
    kind, options, message = REFUSED[case]
    with pytest.raises(kind, match=message):
        scene.closest_point_blocks(**options).write({"t": np.zeros(2, np.float32)})
