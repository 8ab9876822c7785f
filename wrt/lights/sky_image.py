"""The sky: light from infinitely far away, of one colour, a gradient, or an image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.validation import as_direction, as_float, as_real_array, first_bad
from wrt.materials.material import as_color

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers

__all__ = ["Sky"]

GRADIENT_ROWS = 64
MAX_CELLS = (512, 1024)
"""Most rows and columns of the grid by which directions are sampled."""


class Sky:
    """Light from all directions, seen where no surface is.

        wrt.lights.Sky(0.5)                                 # the same everywhere
        wrt.lights.Sky.gradient((0.9, 0.9, 0.9), (0.2, 0.4, 0.9))
        wrt.lights.Sky.image(array, up=(0, 1, 0))

    Args:
        radiance: linear: a number or (3,), each >= 0.

    Attributes:
        texels: (H, W, 3) float32 radiance in longitude and latitude. The top row is the zenith; the middle column is the
            direction `east`.
        up, east: (3,) unit vectors.

    Raises:
        ValueError: a value that is not finite, or negative.
    """

    def __init__(self, radiance: Numbers = 1.0) -> None:
        self._set(np.array(as_color("radiance", radiance), np.float32).reshape(1, 1, 3), (0.0, 0.0, 1.0), None)

    @classmethod
    def gradient(cls, horizon: Numbers, zenith: Numbers, ground: Numbers = 0.0, *, up: ArrayLike = (0.0, 0.0, 1.0)) -> Sky:
        """A sky that changes from the horizon to the zenith, linearly with the height on the sphere, over a ground.

        Args:
            horizon, zenith, ground: radiance, linear: a number or (3,).
            up: (3,) upward direction.

        Raises:
            ValueError: a value that is not finite, or negative; no direction.
        """
        colors = [np.array(as_color(name, c)) for name, c in (("horizon", horizon), ("zenith", zenith), ("ground", ground))]
        height = np.cos((np.arange(GRADIENT_ROWS) + 0.5) / GRADIENT_ROWS * np.pi)[:, None]
        rows = np.where(height > 0.0, colors[0] + height * (colors[1] - colors[0]), colors[2])
        sky = object.__new__(cls)
        sky._set(rows[:, None].astype(np.float32), up, None)
        return sky

    @classmethod
    def image(
        cls, image: ArrayLike, *, scale: float = 1.0, up: ArrayLike = (0.0, 0.0, 1.0), east: ArrayLike | None = None
    ) -> Sky:
        """A sky from an image in longitude and latitude (equirectangular). Bright parts are sampled more often.

        Args:
            image: (H, W, 3) radiance, linear, >= 0.
            scale: factor of the radiance.
            up: (3,) direction of the top row.
            east: (3,) direction of the middle column, made orthogonal to `up`; None for x, or for z if `up` is y.

        Raises:
            ValueError: a wrong shape, values that are not finite or negative, no direction.
        """
        texels = as_real_array("image", image).astype(np.float32) * np.float32(as_float("scale", scale, finite=True))
        if texels.ndim != 3 or texels.shape[2] != 3 or texels.size == 0:
            raise ValueError(f"image must have shape (H, W, 3), not {texels.shape}")
        if not (np.isfinite(texels).all() and texels.min() >= 0.0):
            bad = first_bad(~(np.isfinite(texels) & (texels >= 0.0)), texels)
            raise ValueError(f"image times scale{bad}; it must be finite and not negative")
        sky = object.__new__(cls)
        sky._set(texels, up, east)
        return sky

    def _set(self, texels: np.ndarray, up: Any, east: Any) -> None:
        self.texels = np.ascontiguousarray(texels)
        self.texels.flags.writeable = False
        self.up = as_direction("up", up)
        wanted = (
            (np.array([0.0, 0.0, 1.0]) if abs(self.up[1]) > 0.9 else np.eye(3)[0])
            if east is None
            else as_direction("east", east)
        )
        if abs(wanted @ self.up) > 0.999:
            wanted = np.eye(3)[np.argmin(np.abs(self.up))]
        across = wanted - (wanted @ self.up) * self.up
        self.east = across / np.linalg.norm(across)

    @property
    def north(self) -> np.ndarray:
        """(3,) unit vector to the right of `east` in the image."""
        return np.cross(self.up, self.east)

    def cells(self) -> np.ndarray:
        """(R, C) float64 weights of cells of equal solid angle, by which directions are sampled; all above 0.

        The weight is the largest luminance of the texels around a cell's centre and edges, so that no bright texel is missed.
        """
        height, width = self.texels.shape[:2]
        if height == width == 1:
            return np.ones((1, 1))
        rows, columns = min(max(2 * height, 2), MAX_CELLS[0]), min(width, MAX_CELLS[1])
        brightness = self.texels.astype(np.float64) @ (0.2126, 0.7152, 0.0722)
        at = np.clip(np.arccos(1.0 - 2.0 * np.arange(rows + 1) / rows) / np.pi * height - 0.5, 0, height - 1)
        first = np.floor(at[:-1]).astype(int)
        last = np.minimum(np.ceil(at[1:]).astype(int), height - 1)
        by_row = np.array([brightness[low : high + 1].max(axis=0) for low, high in zip(first, last, strict=True)])
        if width > 1:
            by_row = np.maximum(by_row, np.maximum(np.roll(by_row, 1, axis=1), np.roll(by_row, -1, axis=1)))
            starts = np.arange(columns) * width // columns
            by_row = np.maximum.reduceat(by_row, starts, axis=1)
        floor = max(by_row.mean() * 1e-3, 1e-30)
        return np.maximum(by_row, floor)

    @property
    def mean(self) -> np.ndarray:
        """(3,) radiance, averaged over the sphere."""
        height = self.texels.shape[0]
        edges = np.cos(np.arange(height + 1) / height * np.pi)
        return ((edges[:-1] - edges[1:]) / 2.0) @ self.texels.astype(np.float64).mean(axis=1)
