"""Meshes to test on: built-in scenes, soups full of ties and of degenerate triangles, and measured models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import wrt
from wrt import scenes

MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"


def load_model(name: str) -> wrt.TriangleMesh:
    """A measured model; the test is skipped where the models are not at hand."""
    path = MODELS / name
    if not path.exists():
        pytest.skip(f"the model {name} is not at hand beside the checkout")
    return wrt.TriangleMesh.load(path)


SCENES = {
    "teapot": lambda: scenes.build("teapot", level=4),
    "random_triangles": lambda: scenes.build("random_triangles", count=700, size=0.4, seed=3),
    "stadium": lambda: scenes.build("teapot_in_stadium", level=3, rows=9),
    "atrium": lambda: scenes.build("atrium", bays=(3, 2), detail=1),
    "wood": lambda: scenes.build("wood", trees=2, leaves=2),
    "grid": lambda: snapped_soup(600, seed=5),
    "degenerate": lambda: degenerate_soup(),
    "needles": lambda: needles(),
}

"""Large enough for deep trees, small enough for brute force again and again."""

STORED = SCENES | {
    "stadium": lambda: scenes.build("teapot_in_stadium", level=3),
    "atrium": lambda: scenes.build("atrium", bays=(3, 2), detail=3),
    "wood": lambda: scenes.build("wood", trees=3),
}
"""The meshes of which `tests.bits` keeps hashes: three of them larger."""


def snapped_soup(count: int, seed: int) -> wrt.TriangleMesh:
    """Random triangles whose corners lie on a grid of 9 x 9 x 9 points."""
    corners = np.random.default_rng(seed).integers(0, 9, (count, 3, 3)) / 8
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))


def degenerate_soup() -> wrt.TriangleMesh:
    """Duplicates of each triangle, needles, points, and triangles in axis-aligned planes."""
    rng = np.random.default_rng(11)
    corners = rng.random((100, 3, 3))
    needles = corners.copy()
    needles[:, 2] = needles[:, 1]
    points = np.repeat(rng.random((50, 1, 3)), 3, axis=1)
    flat = rng.random((90, 3, 3))
    for axis in range(3):
        flat[axis * 30 : (axis + 1) * 30, :, axis] = rng.integers(0, 4, (30, 1)) / 3
    corners = np.concatenate([corners, corners, corners[::-1], needles, points, flat]).astype(np.float32)
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def needles(count: int = 480, seed: int = 17) -> wrt.TriangleMesh:
    """Long triangles 1e3 to 1e8 times as long as wide, across each other, and some ordinary ones among them."""
    rng = np.random.default_rng(seed)
    start, along = rng.random((count, 3)), rng.normal(size=(count, 3))
    along *= rng.uniform(0.3, 0.9, (count, 1)) / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across *= np.linalg.norm(along, axis=1, keepdims=True) / np.linalg.norm(across, axis=1, keepdims=True)
    across /= rng.choice([1e3, 1e4, 1e5, 1e6, 1e7, 1e8], (count, 1))
    corners = np.stack([start, start + along, start + rng.random((count, 1)) * along + across], axis=1)
    corners = np.concatenate([corners, rng.random((count // 8, 1, 3)) + rng.uniform(-0.2, 0.2, (count // 8, 3, 3))])
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * len(corners)).reshape(-1, 3))
