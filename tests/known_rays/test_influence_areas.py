"""Influence areas found in rays: those of casters again, those of a renderer's shadow rays, none in noise."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from support.hits import assert_same_hits
from support.meshes import SCENES

import wrt
from wrt.builders.influence.area_top_level import region_of
from wrt.engine.launch.area_trees import assign
from wrt.engine.rays.device_rays import to_device

PLANES = (
    wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 5), direction=(0.2, 0.1, -1), width=4, height=3, depth=9),
    wrt.known_rays.PlaneInfluenceArea(position=(5, 0, 0), direction=(-1, 0.3, 0.2), width=2, height=3, depth=9),
)
POINT = wrt.known_rays.PointInfluenceArea(position=(-2, 4, 1), direction=(0.5, -1, 0), fov=(60, 40), near=0.2, far=9)


def areas_in(*rays, **options) -> wrt.known_rays.InfluenceAreas:
    """The areas that are found in rays, by scikit-learn."""
    pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'wrt[cluster]'")
    return wrt.known_rays.InfluenceAreas.from_rays(*rays, **options)


def mixed_batch(count: int, seed: int, jitter: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """35 % and 20 % of rays from the planes, 25 % towards the point from around, 20 % noise."""
    rng = np.random.default_rng(seed)
    sun, sky = (
        wrt.known_rays.PlaneCaster.of(plane, jitter).rays(int(share * count), seed)
        for plane, share in zip(PLANES, (0.35, 0.2), strict=True)
    )
    lamp = wrt.known_rays.SquareCapCaster.of(POINT).rays(int(0.25 * count), seed)
    from_lamp = lamp.origins + lamp.directions * rng.uniform(0.5, 8, (len(lamp), 1))
    noise = count - len(sun) - len(sky) - len(lamp)
    origins = np.concatenate([sun.origins, sky.origins, from_lamp, rng.uniform(-5, 5, (noise, 3))])
    directions = np.concatenate([sun.directions, -3 * sky.directions, -lamp.directions, rng.normal(size=(noise, 3))])
    order = rng.permutation(count)
    return origins[order], directions[order]


@pytest.mark.parametrize(("count", "seed", "jitter"), [(300, 0, 0.0), (4000, 1, 0.5), (100_000, 2, 0.0)])
def test_round_trip(count, seed, jitter):
    found = areas_in(*mixed_batch(count, seed, jitter), seed=seed)
    assert [type(area) for area in found] == [
        wrt.known_rays.PlaneInfluenceArea,
        wrt.known_rays.PointInfluenceArea,
        wrt.known_rays.PlaneInfluenceArea,
    ]
    np.testing.assert_allclose(found.shares, [0.35, 0.25, 0.2], atol=0.03)
    assert abs(found.explained - 0.8) < 0.04
    np.testing.assert_allclose(found[1].position, POINT.position, atol=1e-4)
    for area, plane in ((found[0], PLANES[0]), (found[2], PLANES[1])):
        sine = np.linalg.norm(np.cross(area.direction, plane.direction)) / np.linalg.norm(plane.direction)
        assert sine < (1e-6 if jitter == 0.0 else 2e-3)
    sun = wrt.known_rays.PlaneCaster.of(PLANES[0]).rays(1000, seed=99)
    inside = region_of(found[0], np.full(3, -5.0), np.full(3, 5.0)).contains(sun.origins)
    assert inside.mean() > 0.9  # the rectangle's corners may lie outside of what the sample shows
    assert "35." in str(found) or "34." in str(found) or "36." in str(found)
    assert "parallel rays along" in str(found)
    assert "rays through (-2, 4, 1)" in str(found)


def test_noise_has_no_areas():
    rng = np.random.default_rng(0)
    found = areas_in(rng.uniform(-1, 1, (3000, 3)), rng.normal(size=(3000, 3)))
    assert (len(found), found.shares, found.explained) == (0, (), 0)
    assert str(found) == "100.0%  no area"


@pytest.mark.parametrize("fov", [2.0, 60.0])
def test_a_camera(fov):
    """All rays from one point; through a long lens they are nearly parallel, and still the point's."""
    camera = wrt.PinholeCamera(60, 40, fov=fov, position=(30, 2, 1), look_at=(0, 0, 0))
    with pytest.raises(ValueError, match=r"pass bounds=scene\.bounds"):
        areas_in(camera.rays())
    (area,) = found = areas_in(camera.rays(), bounds=[(-1, -1, -1), (1, 1, 1)])
    assert isinstance(area, wrt.known_rays.PointInfluenceArea)
    np.testing.assert_allclose(area.position, camera.position, atol=1e-9)
    assert found.shares[0] > 0.99
    assert fov < min(area.fov) < 2.2 * fov
    np.testing.assert_allclose(area.frame[2], camera.forward, atol=0.02 * np.radians(fov))


def test_rays_all_around_a_lamp_take_the_sides_of_a_cube():
    lamp = wrt.known_rays.CircularCapCaster(position=(1, 2, 3), direction=(1, 0, 0), angle=180).rays(3000)
    origins = lamp.origins + lamp.directions * np.random.default_rng(0).uniform(0.5, 2, (3000, 1))
    found = areas_in(origins, -lamp.directions)
    assert len(found) == 6
    assert all(np.allclose(area.position, (1, 2, 3), atol=1e-5) and area.fov == pytest.approx((90, 90)) for area in found)
    np.testing.assert_allclose(found.shares, 1 / 6, atol=0.03)
    inside = np.stack([region_of(area, origins.min(axis=0), origins.max(axis=0)).contains(origins) for area in found])
    assert inside.any(axis=0).all()


def test_shadow_rays_of_a_scene():
    """What is found answers for the rays it was found in."""
    mesh = SCENES["random_triangles"]()
    plain = wrt.Scene(mesh, "bvh", device="cpu")
    seen = plain.intersect(wrt.PinholeCamera(64, 64, position=(0.5, -2, 1.5), look_at=(0.5, 0.5, 0.5)).rays())
    rays = [wrt.known_rays.directional_shadow_rays(seen, (0.2, 0.5, -1)), wrt.known_rays.point_shadow_rays(seen, (0.2, 0.3, 2))]
    origins = np.concatenate([r.origins[seen.is_hit] for r in rays])
    directions = np.concatenate([np.asarray(r.directions)[seen.is_hit] for r in rays])
    found = areas_in(origins, directions, bounds=plain.bounds)
    assert [type(area) for area in found] == [wrt.known_rays.PlaneInfluenceArea, wrt.known_rays.PointInfluenceArea]
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=found, local=wrt.Bvh()), device="cpu")
    batch = wrt.Rays(origins, directions)
    cuts = assign(scene.state, to_device(batch, scene.device, scene.center).batch)
    assert (cuts.area.numpy() < 2).mean() > 0.97
    assert np.isinf(cuts.rest.numpy()).mean() > 0.8
    assert_same_hits(scene.intersect(batch), plain.intersect(batch))


def test_without_the_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.cluster", None)
    with pytest.raises(ImportError, match="pip install scikit-learn"):
        wrt.known_rays.InfluenceAreas.from_rays(*mixed_batch(100, 0))


RAYS = mixed_batch(40, 0)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "message"),
    [
        (RAYS[:1], {}, TypeError, "directions is missing"),
        ((wrt.Rays(*RAYS), RAYS[1]), {}, TypeError, "not both"),
        ((RAYS[0][:, :2], RAYS[1]), {}, ValueError, "origins must have shape"),
        ((RAYS[0][:3], RAYS[1]), {}, ValueError, "do not broadcast"),
        ((RAYS[0], RAYS[1] * np.nan), {}, ValueError, "no ray has"),
        ((RAYS[0], RAYS[1] * 0), {}, ValueError, "no ray has"),
        (RAYS, {"tolerance": 45}, ValueError, "tolerance is 45"),
        (RAYS, {"least_share": 0}, ValueError, "least_share is 0"),
        (RAYS, {"samples": 3}, ValueError, "samples is 3"),
        (RAYS, {"seed": 0.5}, TypeError, "seed"),
        (RAYS, {"bounds": [(0, 0, 0), (1, 1, -1)]}, ValueError, "bounds must be"),
    ],
)
def test_bad_arguments(arguments, options, error, message):
    with pytest.raises(error, match=message):
        wrt.known_rays.InfluenceAreas.from_rays(*arguments, **options)
