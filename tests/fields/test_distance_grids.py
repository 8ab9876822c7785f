"""Distances on grids: the values of single queries, dense and in a band; layout; the round trip to a mesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp
from warp.geometry import IsoSurfaceMarchingCubes

import wrt

SPHERE = trimesh.creation.icosphere(3)


@pytest.fixture(scope="module")
def scene():
    return wrt.Scene(SPHERE, device="cpu")


def points_of(grid: wrt.analysis.DistanceGrid) -> np.ndarray:
    return np.stack(np.meshgrid(*(grid.axis(number) for number in range(3)), indexing="ij"), axis=-1)


def test_dense(scene):
    """The values of single queries, in place and sign, and the closed form."""
    grid = wrt.analysis.distance_grid(scene, 30)
    assert (grid.values.shape, grid.values.dtype, grid.band) == ((30, 30, 30), np.float32, None)
    np.testing.assert_array_equal(grid.values, wrt.analysis.signed_distance(scene, points_of(grid)))
    np.testing.assert_allclose(grid.values, np.linalg.norm(points_of(grid), axis=-1) - 1.0, atol=1e-2)
    np.testing.assert_allclose(grid.end, points_of(grid)[-1, -1, -1])
    assert grid.spacing == pytest.approx(2.0 / 25)


def test_band(scene):
    """Within the band, the dense values; beyond, its ends."""
    bounds, band = [[-1.3, -0.2, -1.3], [1.3, 1.4, 1.5]], 0.15
    dense = wrt.analysis.distance_grid(scene, 40, bounds=bounds)
    narrow = wrt.analysis.distance_grid(scene, 40, bounds=bounds, band=band, sign="parity")
    np.testing.assert_array_equal(narrow.values, np.clip(dense.values, -np.float32(band), np.float32(band)))
    assert np.abs(narrow.values).max() == np.float32(band) == np.float32(narrow.band)
    assert dense.values.shape == (38, 24, 40)
    np.testing.assert_array_equal(dense.origin, bounds[0])
    assert (dense.end >= np.array(bounds[1]) - 1e-9).all()


def test_back_to_a_mesh(scene):
    """Marching cubes find the surface again, within a small part of a cell."""
    grid = wrt.analysis.distance_grid(scene, 40)
    field = wp.array(grid.values, dtype=float, device="cpu")
    low, high = wp.vec3(*grid.origin), wp.vec3(*grid.end)
    vertices, faces = IsoSurfaceMarchingCubes.extract(field, lower=low, upper=high)
    again = trimesh.Trimesh(vertices.numpy(), faces.numpy().reshape(-1, 3))
    assert np.abs(scene.closest_point(again.vertices).distance).max() < 0.05 * grid.spacing
    assert abs(again.volume) == pytest.approx(SPHERE.volume, rel=5e-3)


def test_progress(scene, capsys):
    wrt.analysis.distance_grid(scene, 12, progress=True)
    assert "4,096 points" in capsys.readouterr().err


@pytest.mark.cuda
def test_volume(scene):
    """On CUDA, a volume with the values; without CUDA, an error that says what to do."""
    grid = wrt.analysis.distance_grid(scene, 12)
    if not wp.get_cuda_devices():
        with pytest.raises(RuntimeError, match=r"on CUDA only.*use values"):
            grid.volume()
        with pytest.raises(RuntimeError, match="on CUDA only"):
            grid.volume("cpu")
    else:
        volume = grid.volume()
        assert volume.get_voxel_size() == pytest.approx((grid.spacing,) * 3)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"resolution": 5}, ValueError, "resolution must be at least 6"),
        ({"resolution": 1}, ValueError, "resolution"),
        ({"resolution": 8.5}, TypeError, "resolution"),
        ({"resolution": 10**6}, ValueError, "points is too large; lower resolution"),
        ({"resolution": 8, "bounds": [0, 1]}, ValueError, "bounds"),
        ({"resolution": 8, "bounds": [[0, 0, 0], [1, 1, -1]]}, ValueError, "bounds must be a lower and an upper corner"),
        ({"resolution": 8, "band": 0.0}, ValueError, "band must be above 0"),
        ({"resolution": 8, "band": 0.1, "sign": "pseudonormal"}, ValueError, "a band needs signs where nothing is near"),
        ({"resolution": 8, "sign": "odd"}, ValueError, "sign 'odd' is unknown"),
    ],
)
def test_what_is_refused(scene, arguments, error, message):
    with pytest.raises(error, match=message):
        wrt.analysis.distance_grid(scene, **arguments)
