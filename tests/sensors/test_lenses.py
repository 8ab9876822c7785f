"""Lenses: projected and back, against OpenCV and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.lenses import BARREL, CENTRE, FISHEYE, LENSES

from wrt.sensors import BrownConrady, DoubleSphere, Equirectangular, FTheta, KannalaBrandt

PIXELS = np.stack(np.meshgrid(np.linspace(0, 639, 41), np.linspace(0, 481, 31)), axis=-1)


@pytest.mark.parametrize("name", LENSES)
def test_forward_and_back(name):
    """Every pixel of the image has a ray, and points of the ray are at the pixel, to 1e-6 of a pixel."""
    lens = LENSES[name]
    origins, directions = lens.unproject(PIXELS)
    assert np.isfinite(directions).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-12)
    for distance in (0.1, 1.0, 37.0):
        np.testing.assert_allclose(lens.project(origins + distance * directions), PIXELS, atol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_back_and_forward(name):
    """Points that are seen are on the ray of their pixel."""
    lens, rng = LENSES[name], np.random.default_rng(5)
    points = rng.uniform(-1, 1, (500, 3)) * [1.0, 0.7, 1.0] + [0, 0, 2.5]
    origins, directions = lens.unproject(lens.project(points))
    away = points - origins
    np.testing.assert_allclose(away / np.linalg.norm(away, axis=-1, keepdims=True), directions, atol=1e-6)


@pytest.mark.parametrize("name", ["pinhole", "barrel", "rational", "prism"])
def test_opencv(name):
    """`project` is cv2.projectPoints, with the same pixels."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: pip install opencv-python-headless")
    lens, rng = LENSES[name], np.random.default_rng(6)
    points = rng.uniform([-1, -1, 2], [1, 1, 4], (300, 3))
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    np.testing.assert_allclose(lens.project(points), expected[:, 0], atol=1e-9)
    assert BrownConrady.from_matrix(matrix, lens.distortion) == lens


def test_opencv_fisheye():
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed: pip install opencv-python-headless")
    lens, rng = LENSES["kannala_brandt"], np.random.default_rng(6)
    points = rng.uniform(-1, 1, (300, 3)) * [3, 3, 1] + [0, 0, 2]
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    given = points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion)
    expected, _ = cv2.fisheye.projectPoints(*given)
    np.testing.assert_allclose(lens.project(points), expected[:, 0], atol=1e-9)


def test_camera_matrices_with_skew():
    """Calibrations of Matlab and COLMAP have a skew, which was refused: pixel (u, v) looks along K^-1 (u, v, 1)."""
    matrix, upright = (np.array([[500, skew, 320], [0, 500, 240], [0, 0, 1]]) for skew in (2.0, 0.0))
    assert BrownConrady.from_matrix(matrix).skew == KannalaBrandt.from_matrix(matrix).skew == 2.0
    directions = BrownConrady.from_matrix(matrix).unproject(PIXELS)[1]
    pixels = np.concatenate([PIXELS, np.ones((*PIXELS.shape[:-1], 1))], axis=-1)
    np.testing.assert_allclose(directions / directions[..., 2:], pixels @ np.linalg.inv(matrix).T, rtol=0, atol=1e-12)
    points = np.random.default_rng(4).uniform((-1, -1, 1), (1, 1, 3), (50, 3))
    skewed, plain = (BrownConrady.from_matrix(one, BARREL).project(points) for one in (matrix, upright))
    np.testing.assert_allclose(skewed[:, 0] - plain[:, 0], 2.0 * (plain[:, 1] - 240) / 500, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(skewed[:, 1], plain[:, 1])
    lower = upright.copy()
    lower[1, 0] = 1.0
    for bad in (2 * matrix, matrix.T, lower):
        with pytest.raises(ValueError, match="create_rays_pinhole"):
            BrownConrady.from_matrix(bad)


def test_pixel_convention():
    """The centre of the first pixel is at (0, 0): a principal point in the middle of 640 columns is at 319.5."""
    lens = BrownConrady(320.0, 320.0, 319.5, 239.5)
    _, directions = lens.unproject([[0.0, 239.5], [639.0, 239.5], [-0.5, 239.5]])
    np.testing.assert_allclose(directions[0] * [-1, 1, 1], directions[1], atol=1e-15)
    assert directions[2, 0] == pytest.approx(-np.sqrt(0.5))  # the edge of the image: 45 degrees


def test_closed_forms():
    """An equidistant fisheye lens: r = f angle; a double sphere with xi = 0, alpha = 0 is a pinhole; a panorama's columns."""
    equidistant = KannalaBrandt(100.0, 100.0, 0.0, 0.0)
    np.testing.assert_allclose(equidistant.project([1.0, 0.0, -1.0]), [100 * 0.75 * np.pi, 0], atol=1e-10)
    np.testing.assert_allclose(FTheta(0.0, 0.0, (100.0,)).project([0.0, 2.0, 0.0]), [0, 50 * np.pi], atol=1e-10)
    pinhole = DoubleSphere(500.0, 500.0, 10.0, 20.0, xi=0.0, alpha=0.0)
    np.testing.assert_allclose(pinhole.project([0.3, -0.2, 2.0]), [85.0, -30.0], atol=1e-10)
    panorama = Equirectangular(360, 180)
    np.testing.assert_allclose(
        panorama.project([[1.0, 0, 0], [0, -1, 0]])[:, [0, 1]], [[269.5, 89.5], [179.5, -0.5]], atol=1e-9
    )


def test_what_is_not_seen():
    """Behind a pinhole; beyond the largest angle; where a distortion folds back; outside of a panorama."""
    assert np.isnan(LENSES["pinhole"].project([[0, 0, -1.0], [0, 0, 0]])).all()
    narrow = KannalaBrandt(**FISHEYE, max_angle=1.0)
    assert np.isnan(narrow.project([1.0, 0, 0])).all()
    assert np.isnan(narrow.unproject([319.5 + 251.0, 241.0])[1]).all()
    folded = BrownConrady(**CENTRE, distortion=(-0.28, 0.0, 0, 0))  # r (1 - 0.28 r^2) is at most 0.727
    assert np.isfinite(folded.unproject([319.5 + 600 * 0.72, 241.0])[1]).all()
    assert np.isnan(folded.unproject([319.5 + 600 * 0.74, 241.0])[1]).all()
    assert np.isnan(Equirectangular(360, 180).unproject([-2.0, 0.0])[1]).all()
    assert np.isnan(LENSES["pinhole"].project([np.nan, 0, 1.0])).all()


@pytest.mark.parametrize("name", LENSES)
def test_warp_arrays(device, name):
    pixels = wp.array(PIXELS.reshape(-1, 2), dtype=wp.vec2d, device=device)
    origins, directions = LENSES[name].unproject(pixels)
    expected = LENSES[name].unproject(PIXELS.reshape(-1, 2))
    np.testing.assert_allclose(origins.numpy(), expected[0], atol=1e-12)
    np.testing.assert_allclose(directions.numpy(), expected[1], atol=1e-12)
    assert LENSES[name].project(directions).shape == (PIXELS.size // 2,)


WRONG = [
    (lambda: BrownConrady(**CENTRE, distortion=(0.1, 0.2, 0.3)), ValueError, "3 coefficients"),
    (lambda: BrownConrady(**CENTRE, distortion=(0.1,) * 14), ValueError, "14 coefficients"),
    (lambda: BrownConrady(0.0, 1.0, 0, 0), ValueError, "fx"),
    (lambda: BrownConrady.from_matrix(np.ones((3, 3))), ValueError, "skew"),
    (lambda: KannalaBrandt(**CENTRE, distortion=(0.1,) * 5), ValueError, "5 coefficients"),
    (lambda: KannalaBrandt(**CENTRE, max_angle=4.0), ValueError, "max_angle"),
    (lambda: FTheta(0, 0, ()), ValueError, "coefficients"),
    (lambda: DoubleSphere(**CENTRE, xi=1.5), ValueError, "xi"),
    (lambda: Equirectangular(0, 10), ValueError, "width"),
    (lambda: LENSES["pinhole"].project([1.0, 2.0]), ValueError, "points"),
    (lambda: LENSES["pinhole"].unproject(["a", "b"]), TypeError, "real numbers"),
]


@pytest.mark.parametrize("case", range(len(WRONG)))
def test_wrong_arguments(case):
    call, error, message = WRONG[case]
    with pytest.raises(error, match=message):
        call()
