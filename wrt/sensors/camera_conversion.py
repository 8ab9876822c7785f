"""Views of `wrt.PinholeCamera` and `wrt.OrthographicCamera` as sensors, and back: centres of pixels differ by half a pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.imaging.cameras import OrthographicCamera, PinholeCamera
from wrt.sensors.lens_models import BrownConrady, LensModel, Orthographic

SAME = 1e-9
"""Relative difference up to which focal lengths and centres count as equal."""


def lens_of(camera: Any) -> LensModel:
    """The lens of `Camera.from_camera`."""
    if isinstance(camera, PinholeCamera):
        focal = camera.height / 2 / np.tan(np.radians(camera.fov) / 2)
        kind: type[BrownConrady | Orthographic] = BrownConrady
    elif isinstance(camera, OrthographicCamera):
        focal, kind = camera.height / camera.view_height, Orthographic
    else:
        raise TypeError(f"camera must be a wrt.PinholeCamera or a wrt.OrthographicCamera, not {type(camera).__name__}")
    return kind(float(focal), float(focal), (camera.width - 1) / 2, (camera.height - 1) / 2)


def camera_of(lens: LensModel, width: int, height: int, pose: Any) -> PinholeCamera | OrthographicCamera:
    """See `Camera.to_camera`."""
    if not isinstance(lens, (BrownConrady, Orthographic)):
        raise ValueError(
            f"a lens of {type(lens).__name__} has no wrt.PinholeCamera; take a BrownConrady or an Orthographic one"
        )
    if isinstance(lens, BrownConrady) and (any(lens.distortion) or lens.skew):
        raise ValueError("the lens has distortion or skew, which a wrt.PinholeCamera has not; undistort the image first")
    if abs(lens.fx - lens.fy) > SAME * lens.fx:
        raise ValueError(f"fx is {lens.fx} and fy {lens.fy}; pixels of a wrt.PinholeCamera are square")
    centre = (width - 1) / 2, (height - 1) / 2
    if not np.allclose((lens.cx, lens.cy), centre, rtol=0.0, atol=SAME * max(width, height)):
        raise ValueError(f"(cx, cy) is {lens.cx, lens.cy}; the axis of a wrt.PinholeCamera passes through the centre, {centre}")
    if isinstance(lens, Orthographic):
        return OrthographicCamera.from_opencv(width, height, pose, view_height=height / lens.fy)
    return PinholeCamera.from_opencv(width, height, pose, fov=float(np.degrees(2 * np.arctan(height / 2 / lens.fy))))
