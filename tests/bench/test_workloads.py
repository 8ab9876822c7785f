"""The workloads of the benchmark: rays where they belong, and the same every time."""

import numpy as np
import pytest
import trimesh

import wrt
from wrt.bench.core.workloads import AO_RANGE, OFFSET, WORKLOADS, WorkloadMaker, pixel_order
from wrt.scenes import teapot

SIZE = 16
MESH = teapot(level=2, ground=False)
SPHERE = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=2))


def made(name, **options):
    return next(WorkloadMaker(MESH, **{"size": SIZE, **options}).make([name]))


@pytest.mark.parametrize("name", WORKLOADS)
def test_workloads_are_float32_and_the_same_every_time(name):
    one, two = made(name), made(name)
    for a, b in ((one.origins, two.origins), (one.directions, two.directions)):
        assert a.dtype == np.float32
        assert a.shape == (len(one), 3)
        assert np.isfinite(a).all()
        np.testing.assert_array_equal(a, b)
    assert one.name == name
    assert len(one) == SIZE * SIZE or (one.query == "occlusion" and 0 < len(one) < SIZE * SIZE)


@pytest.mark.parametrize(("name", "factor"), [("far", 1.1), ("near", 0.55)])
def test_views_look_at_the_centre_from_the_stated_distance(name, factor):
    view = made(name)
    assert view.shares_origin
    assert view.origins.strides[0] == 0
    towards = view.origins[0] - MESH.center
    expected = factor * MESH.extent / 2 / np.tan(np.radians(22.5))
    assert np.linalg.norm(towards) == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(towards / expected, np.array([0.3, 0.25, 1.0]) / np.linalg.norm([0.3, 0.25, 1.0]), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(view.directions, axis=1), 1.0, rtol=1e-6)
    middle = view.directions.mean(axis=0)
    np.testing.assert_allclose(middle / np.linalg.norm(middle), -towards / expected, atol=1e-5)


def test_far_sees_all_of_the_mesh():
    view = made("far")
    eye, cosines = view.origins[0], view.directions @ (-np.array([0.3, 0.25, 1.0]) / np.linalg.norm([0.3, 0.25, 1.0]))
    to_vertices = MESH.vertices - eye
    along = to_vertices @ (MESH.center - eye) / np.linalg.norm(to_vertices, axis=1) / np.linalg.norm(MESH.center - eye)
    assert along.min() > cosines.min()


def test_tiles_and_rows_hold_the_same_rays():
    tiles, rows = made("far"), made("far", order="rows")
    order = pixel_order(SIZE, "tiles")
    np.testing.assert_array_equal(tiles.directions, rows.directions[order])
    assert order[:6].tolist() == [0, 1, 2, 3, SIZE, SIZE + 1]
    assert order[16] == 4
    assert rows.directions[1, 1] == pytest.approx(rows.directions[0, 1], abs=0.05)
    assert rows.directions[0, 1] > rows.directions[-1, 1], "the first row is the upper one"


def test_random_rays_fill_the_box():
    rays = made("random", size=32)
    low, high = MESH.bounds
    assert (rays.origins >= low.astype(np.float32)).all()
    assert (rays.origins <= high.astype(np.float32)).all()
    assert np.abs(rays.directions.mean(axis=0)).max() < 0.1
    assert not np.array_equal(rays.directions, made("random", size=32, seed=1).directions)


def test_shadow_rays_end_at_the_light():
    maker = WorkloadMaker(MESH, size=SIZE)
    (rays,) = maker.make(["shadow"])
    np.testing.assert_allclose(rays.origins + rays.directions * rays.t_max, np.tile(maker.light, (len(rays), 1)), rtol=1e-5)
    assert np.linalg.norm(maker.light - MESH.center) > MESH.extent / 2, "the light is outside"


def test_ao_rays_leave_the_surface_upwards_with_a_cosine_distribution():
    maker = WorkloadMaker(MESH, size=64)
    (rays,) = maker.make(["ao"])
    points, normals = maker.visible
    cosines = np.sum(normals * rays.directions, axis=1)
    assert cosines.min() > -1e-6
    assert cosines.mean() == pytest.approx(2 / 3, abs=0.05)
    assert rays.t_max == pytest.approx(AO_RANGE * MESH.extent)
    view = made("far", size=64)
    assert (np.sum((view.origins[0] - points) * normals, axis=1) > 0).all(), "normals face the eye"
    hits = wrt.Scene(MESH, device="cpu").intersect(points, (-normals).astype(np.float32))
    assert hits.is_hit.all()
    assert hits.t.max() < 2 * OFFSET * MESH.extent, "the points lie just above the surface"


def test_thinned_workloads_are_evenly_picked():
    for rays in (made("far"), made("random")):
        few = rays.thinned(50)
        chosen = rays.chosen(50)
        assert len(few) == 50
        assert len(few.origins) == 50
        np.testing.assert_array_equal(few.directions, rays.directions[chosen])
        np.testing.assert_array_equal(few.origins, rays.origins[chosen])
        assert set(np.diff(chosen)) <= {len(rays) // 50, len(rays) // 50 + 1}
        assert rays.thinned(10**9) is rays


def test_workloads_refuse_bad_arguments():
    with pytest.raises(ValueError, match="multiple of 4"):
        WorkloadMaker(MESH, size=6)
    assert len(made("far", size=6, order="rows")) == 36
    with pytest.raises(ValueError, match="order 'spiral' is unknown"):
        WorkloadMaker(MESH, order="spiral")
    with pytest.raises(ValueError, match="workload 'fog' is unknown; choose from far"):
        made("fog")
