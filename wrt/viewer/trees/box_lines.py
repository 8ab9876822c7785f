"""Boxes and paths as lines over the picture, in the colours of costs.

Coordinates are given to the browser relative to the centre of the scene: it draws in float32.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import viser

__all__ = ["box_corners", "box_edges", "draw_boxes", "heat_colors"]

CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
EDGES = np.array([(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit])
"""(12, 2) corners at the ends of the edges of a box."""


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(..., 8, 3) corners of boxes (..., 3)."""
    return np.where(CORNERS == 0, low[..., None, :], high[..., None, :])


def box_edges(corners: np.ndarray) -> np.ndarray:
    """(12 N, 2, 3) ends of the edges of boxes with corners (N, 8, 3)."""
    return corners[:, EDGES].reshape(-1, 2, 3)


def heat_colors(shares: np.ndarray) -> np.ndarray:
    """(N, 3) uint8 from blue for 0 over green and yellow to red for 1."""
    x = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    channels = (np.clip(2.0 * x - 0.4, 0.0, 1.0), 1.0 - np.abs(2.0 * x - 1.0) ** 2, np.clip(1.2 - 2.4 * x, 0.0, 1.0))
    return np.rint(255.0 * np.stack(channels, axis=-1)).astype(np.uint8)


def draw_boxes(client: viser.ClientHandle, name: str, corners: Any, colors: np.ndarray, center: np.ndarray) -> Any:
    """Draws boxes with corners (N, 8, 3) in colours (N, 3) and returns their handle; None for no boxes, which removes those of
    that name."""
    if len(corners) == 0:
        client.scene.remove_by_name(name)
        return None
    points = box_edges(np.asarray(corners) - center).astype(np.float32)
    shades = np.repeat(colors, 12, axis=0)[:, None].repeat(2, axis=1)
    position = tuple(map(float, center))
    return client.scene.add_line_segments(name, points, shades, thickness=1.5, thickness_units="screen", position=position)  # type: ignore[call-overload]
