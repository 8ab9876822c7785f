"""What the viewer's pictures show, without a browser."""

from dataclasses import replace

import numpy as np
import pytest

import wrt
from wrt import scenes
from wrt.imaging.image_files import to_bytes
from wrt.viewer.pictures.layers import tile_order
from wrt.viewer.pictures.looks import LOOKS, make_picture
from wrt.viewer.pictures.view_request import ViewRequest

SIZE = 48, 36


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def scene(request):
    return wrt.Scene(scenes.build("teapot", level=4), request.param, device="cpu")


@pytest.fixture(scope="module")
def wanted():
    view = scenes.BUILTIN_SCENES["teapot"].camera
    return ViewRequest(1, (view["position"], view["look_at"], view["up"], view["fov"]), SIZE, samples=2)


def finished(scene, wanted, scale=1.0, is_coarse=False, **options):
    picture, checks = make_picture(scene, wanted, scale, is_coarse, options), []
    while not picture.is_complete:
        picture.advance(lambda *_: checks.append(1))
    return picture


def test_beauty_is_the_picture_of_render(scene, wanted):
    picture = finished(scene, wanted, ambient_samples=2)
    expected = wrt.render(scene, wanted.camera_of(), samples=2, ambient_samples=2)
    np.testing.assert_array_equal(picture.pixels(), to_bytes(expected))
    assert picture.rays > 0


def test_other_integrators(wanted):
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    picture = finished(scene, replace(wanted, integrator="whitted", samples=1))
    expected = wrt.render(scene, wanted.camera_of(), integrator="whitted", samples=1)
    np.testing.assert_array_equal(picture.pixels(), to_bytes(expected))


def test_coarse_pictures_are_small_and_have_one_sample(scene, wanted):
    picture = finished(scene, wanted, 0.5, True)
    assert picture.pixels().shape == (18, 24, 3)


@pytest.fixture(scope="module")
def cloister():
    """A floor between two walls, below a roof: a tenth of the sky is seen from its middle."""
    x, y = 4.0, 1.5
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0), (-x, -y, 2), (x, -y, 2), (x, y, 2), (-x, y, 2)]
    quads = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 3, 7, 4), (2, 3, 7, 6)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    scene = wrt.Scene(wrt.TriangleMesh(np.array(corners, np.float32), faces), "bvh", device="cpu")
    camera = wrt.PinholeCamera(40, 30, fov=70.0, position=(3.0, -4.0, 1.2), look_at=(-1.0, 0.5, 0.9), up=(0, 0, 1))
    return scene, camera


DARK = {"light_color": 0.0, "ambient_color": 1.0, "albedo": 1.0, "background": 1.0, "smooth": False}


def linear(scene, camera, **options):
    """(H, W) linear openness of a picture."""
    picture = wrt.render(scene, camera, **DARK, **options)[..., 0].astype(np.float64)
    return np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)


def test_pixels_share_their_ambient_rays(cloister):
    """The mean over the window, where all of it is one plane; no more than rounding beyond it elsewhere."""
    scene, camera = cloister
    alone, shared = (linear(scene, camera, ambient_samples=2, ambient_radius=radius) for radius in (0, 2))
    rays = camera.rays()
    normal = np.abs(scene.intersect(rays).normal)
    hit = np.isfinite(normal).all(axis=-1) & (normal.sum(axis=-1) > 0)
    windows = np.lib.stride_tricks.sliding_window_view
    one_plane = hit[2:-2, 2:-2] & (np.ptp(windows(normal, (5, 5), axis=(0, 1)), axis=(-2, -1)).max(axis=-1) < 1e-6)
    one_plane &= windows(hit, (5, 5)).all(axis=(-2, -1))
    assert one_plane.sum() > 50
    mean = windows(alone, (5, 5)).mean(axis=(-2, -1))
    np.testing.assert_allclose(shared[2:-2, 2:-2][one_plane], mean[one_plane], atol=3e-3)
    np.testing.assert_array_equal(shared[~hit], alone[~hit])
    for radius in (-1, 9):
        with pytest.raises(ValueError, match="ambient_radius"):
            wrt.render(scene, camera, ambient_radius=radius)


def test_coarse_pictures_have_no_black_speckles(cloister):
    """Two ambient rays of a pixel are both blocked at many pixels of a dark place: the first picture of the atrium was black
    and white."""
    scene, camera = cloister
    true = linear(scene, camera, ambient_samples=256)
    pose = tuple(camera.position), tuple(camera.look_at), tuple(camera.up), camera.fov
    coarse = finished(scene, ViewRequest(1, pose, (40, 30)), 1.0, True, **DARK).pixels()[..., 0] / 255.0
    coarse = np.where(coarse <= 0.04045, coarse / 12.92, ((coarse + 0.055) / 1.055) ** 2.4)
    alone = linear(scene, camera, ambient_samples=2)
    inside = (true < 0.6) & (true > 0.05)
    assert inside.sum() > 100
    assert (alone[inside] == 0.0).mean() > 0.2
    assert (coarse[inside] == 0.0).mean() < 0.01
    assert np.abs(coarse - true)[inside].mean() < 0.4 * np.abs(alone - true)[inside].mean()


@pytest.mark.parametrize("look", [name for name in LOOKS if name != "beauty"])
def test_layers_and_costs(scene, wanted, look):
    """Each look makes a picture with more than one colour; what it shows is that of `intersect`."""
    picture = finished(scene, replace(wanted, look=look))
    pixels = picture.pixels()
    assert pixels.shape == (36, 48, 3)
    if "geometry" not in look and "instance" not in look:
        assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 3
    rays = wanted.camera_of().rays()
    hits = scene.intersect(rays, traversal="single", counters=True)
    grey = (pixels == pixels[~hits.is_hit][0]).all(axis=-1) if (~hits.is_hit).any() else np.zeros(hits.shape, bool)
    if look == "depth":
        assert picture.scale.low == pytest.approx(hits.t[hits.is_hit].min())
        assert picture.scale.high == pytest.approx(hits.t[hits.is_hit].max())
        assert (pixels[hits.is_hit].astype(int).sum(axis=-1) > 0).all()
    if look == "normals":
        expected = to_bytes((0.5 + 0.5 * hits.normal).astype(np.float32))
        assert np.abs(pixels[hits.is_hit].astype(int) - expected[hits.is_hit]).max() <= 1
    if look == "triangle ids":
        same = hits.primitive_id[:, 1:] == hits.primitive_id[:, :-1]
        assert (pixels[:, 1:] == pixels[:, :-1]).all(axis=-1)[same].all()
        assert (pixels[hits.is_hit] != pixels[~hits.is_hit][0]).any(axis=-1).all() if grey.any() else True
    counted = {"cost: nodes": "nodes", "cost: leaves": "leaves", "cost: triangle tests": "triangles"}
    if look in counted:
        np.testing.assert_array_equal(picture.values, hits.counters[counted[look]])
        assert picture.scale.high == picture.values.max()
    if look == "cost: packets taken apart":
        known = picture.values[np.isfinite(picture.values)]
        assert known.min() >= 0.0
        assert known.max() <= 100.0


def test_costs_of_packets_are_those_of_their_tiles(scene, wanted):
    """All pixels of a tile show one value, and it is what `intersect` counts for the tile's rays."""
    values = finished(scene, replace(wanted, look="cost: nodes of packets")).values
    tiles = values.reshape(9, 4, 6, 8).swapaxes(1, 2).reshape(54, 32)  # 48 x 36 pixels are 6 x 9 tiles of 8 x 4
    assert (tiles == tiles[:, :1]).all()
    rays = wanted.camera_of().rays()
    order = tile_order(*SIZE)
    directions = rays.directions.reshape(-1, 3)[order]
    flat = wrt.Rays(rays.origins.reshape(3), directions)
    plan = replace(scene.explain(flat, traversal="packet"), packet=32, reorder="none")
    counted = scene.intersect(flat, traversal=plan, counters=True).counters["nodes"]
    np.testing.assert_array_equal(tiles[:, 0], counted[::32])


def test_order_of_tiles_is_a_permutation():
    """Also where tiles are cut at the edges."""
    for width, height in ((8, 4), (13, 7), (1, 1), (3, 50)):
        np.testing.assert_array_equal(np.sort(tile_order(width, height)), np.arange(width * height))


def test_options_that_do_not_fit_are_errors(scene, wanted):
    other = "mlrta" if scene.accelerator.kind == "bvh" else "interleaved"
    with pytest.raises(ValueError, match=other):
        finished(scene, replace(wanted, look="depth", traversal=other))
