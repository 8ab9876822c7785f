"""Textures by tiles on demand: pictures have the bits of whole images, whatever the budget."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.imaging.integrators.texture_tiles import MIN_BUDGET
from wrt.scenes.shapes import plane

CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)

CAMERA = wrt.PinholeCamera(61, 47, fov=60, position=(0, -2.5, 1.8), look_at=(0, 0, 0.2), up=(0, 0, 1))


def image(height, width, seed):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def textured(corners, color, surface=None, repeats=1.0):
    uv = repeats * CORNERS[[0, 3, 1, 2]]
    material = wrt.Material("glossy", color=1.0, metallic=0.8, color_texture=color, surface_texture=surface)
    return corners.with_materials(material, uv=uv)


@pytest.fixture(scope="module")
def scene():
    """Images whose edges are no multiples of a tile's, one of them smaller than a tile, one used twice, one repeated."""
    first, second, small = wrt.Texture(image(300, 517, 0)), wrt.Texture(image(1000, 65, 1)), wrt.Texture(image(3, 5, 2))
    parts = [
        textured(plane((-2, -2), (2, 2), z=0.0), first, second, 3.0),
        textured(plane((-1, 0), (0, 1), z=0.3), second, first),
        textured(plane((0.2, 0), (1, 1), z=0.3), small),
    ]
    return wrt.Scene(parts)


def rendering(scene, **options):
    return wrt.pictures.Rendering(
        scene, CAMERA, samples=2, depth=4, lights=[wrt.lights.Sky(1.0), wrt.lights.PointLight((1, -1, 2), 3.0)], **options
    )


@pytest.mark.parametrize("integrator", ["path", "whitted"])
def test_pictures_have_the_bits_of_whole_images(scene, integrator):
    """The smallest budget holds 8 of the 62 tiles: generations are cut into many parts."""
    whole = rendering(scene, integrator=integrator).advance()
    assert whole.tile_loads == 0
    for budget in (MIN_BUDGET, 5 * MIN_BUDGET):
        tiled = rendering(scene, integrator=integrator, texture_memory=budget).advance()
        assert tiled.tile_loads > budget // MIN_BUDGET * 8
        np.testing.assert_array_equal(tiled.linear, whole.linear)
        np.testing.assert_array_equal(tiled.layers["albedo"], whole.layers["albedo"])
        assert tiled.key == whole.key
    assert whole.linear.std() > 0.05


def test_tiles_of_instances(scene):
    """Triangles of instances are numbered by their mesh."""
    placed = wrt.Scene([wrt.Instance(mesh, np.eye(4)) for mesh in scene.meshes])
    whole = rendering(placed, integrator="path").advance()
    tiled = rendering(placed, integrator="path", texture_memory=2 * MIN_BUDGET).advance()
    assert tiled.tile_loads > 16
    np.testing.assert_array_equal(tiled.linear, whole.linear)


def test_images_that_fit_are_whole(scene):
    assert rendering(scene, integrator="path", texture_memory=1 << 22).advance(1).tile_loads == 0


def test_only_tiles_that_are_seen_are_loaded():
    """A camera above one corner of an image of 256 tiles: the others are never read."""
    mesh = textured(plane((-8, -8), (8, 8)), wrt.Texture(image(1024, 1024, 3)))
    camera = wrt.OrthographicCamera(16, 16, view_height=1.0, position=(-7, -7, 5), look_at=(-7, -7, 0), up=(0, 1, 0))
    options = {"integrator": "path", "samples": 3, "depth": 2, "lights": [wrt.lights.Sky(1.0)]}
    tiled = wrt.pictures.Rendering(wrt.Scene(mesh), camera, texture_memory=1 << 20, **options).advance()
    assert 1 <= tiled.tile_loads <= 9
    np.testing.assert_array_equal(tiled.linear, wrt.pictures.Rendering(wrt.Scene(mesh), camera, **options).advance().linear)


def test_images_in_mapped_files(tmp_path):
    """An image that numpy maps from a file stays there."""
    np.save(tmp_path / "wall.npy", image(200, 300, 4))
    mapped = np.load(tmp_path / "wall.npy", mmap_mode="r")
    texture = wrt.Texture(mapped)
    assert np.shares_memory(texture.pixels, mapped)
    mesh = textured(plane((-2, -2), (2, 2)), texture)
    whole = rendering(wrt.Scene(mesh), integrator="path").advance()
    tiled = rendering(wrt.Scene(mesh), integrator="path", texture_memory=MIN_BUDGET).advance()
    np.testing.assert_array_equal(tiled.linear, whole.linear)


def test_budgets_are_checked(scene):
    with pytest.raises(ValueError, match="texture_memory"):
        rendering(scene, texture_memory=1000)
    with pytest.raises(TypeError, match="texture_memory"):
        rendering(scene, texture_memory="1 GB")
