"""Walls and cones before sensors, and distances to them in closed form."""

from __future__ import annotations

import numpy as np

import wrt
from wrt.sensors import LidarPattern


def wall(distance: float, low: float = -100.0, high: float = 100.0) -> wrt.TriangleMesh:
    """A wall across x, of width from `low` to `high` along y."""
    corners = [[distance, y, z] for y, z in ((low, -100), (high, -100), (high, 100), (low, 100))]
    return wrt.TriangleMesh(np.array(corners, dtype=np.float64), [[0, 1, 2], [0, 2, 3]])


def cone(half_angle: float, rows: int = 9, columns: int = 16) -> np.ndarray:
    """(rows, columns, 3) unit vectors around x."""
    angle, turn = np.meshgrid(np.linspace(0, half_angle, rows), np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    return np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)


def exact(pattern: LidarPattern) -> np.ndarray:
    return pattern.directions.astype(np.float64) / np.linalg.norm(pattern.directions.astype(np.float64), axis=-1, keepdims=True)
