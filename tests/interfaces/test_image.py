"""Image files: what is written comes back, and what cannot be written is refused."""

import numpy as np
import pytest
from PIL import Image

import wrt
import wrt.imaging.ambient_rendering


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.float64])
def test_png_round_trip(tmp_path, shape, dtype):
    codes = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    image = codes if dtype == np.uint8 else (codes / 255).astype(dtype)
    wrt.save_image(tmp_path / "image.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "image.png")), codes)


def test_floats_are_rounded_to_the_nearest_byte(tmp_path):
    """Cut off, the bytes of a round trip are the same, and every other picture is darker by half a step."""
    codes = np.arange(256).reshape(16, 16)
    for shift in (-0.49, 0.49):
        wrt.save_image(tmp_path / "image.png", (codes + shift) / 255)
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "image.png")), codes)


def test_other_formats(tmp_path):
    image = np.linspace(0, 1, 16 * 16 * 3, dtype=np.float32).reshape(16, 16, 3)
    wrt.save_image(tmp_path / "image.npy", image)
    np.testing.assert_array_equal(np.load(tmp_path / "image.npy"), image)
    for name in ("image.jpg", "image.JPEG", "image.bmp", "image.tif", "image.webp"):
        wrt.save_image(str(tmp_path / name), image)
        assert np.abs(np.asarray(Image.open(tmp_path / name)) / 255.0 - image).max() < 0.1
    wrt.save_image(tmp_path / "clipped.png", np.array([[-1.0, 2.0]]))
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "clipped.png")), [[0, 255]])


@pytest.mark.parametrize(
    ("name", "image", "error", "message"),
    [
        ("a.png", np.zeros((4, 4, 2)), ValueError, r"not \(4, 4, 2\)"),
        ("a.png", np.zeros((0, 4, 3)), ValueError, r"not \(0, 4, 3\)"),
        ("a.png", np.zeros(4), ValueError, "must have shape"),
        ("a.png", np.zeros((4, 4), dtype=int), TypeError, "uint8, or floats"),
        ("a.png", np.full((4, 4), np.nan), ValueError, "16 values that are NaN"),
        ("a.xyz", np.zeros((4, 4)), ValueError, "unknown extension '.xyz'"),
        ("a", np.zeros((4, 4)), ValueError, "unknown extension ''"),
        ("a.jpg", np.zeros((4, 4, 4)), ValueError, "no alpha"),
        ("nowhere/a.png", np.zeros((4, 4)), FileNotFoundError, "no folder .*create it first"),
    ],
)
def test_what_cannot_be_saved(tmp_path, name, image, error, message):
    with pytest.raises(error, match=message):
        wrt.save_image(tmp_path / name, image)
    assert not list(tmp_path.iterdir())
