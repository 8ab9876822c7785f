"""Numbers and meshes that nobody would save: raw bits, all exponents, NaN payloads, denormals; flat, coincident, mixed."""

from __future__ import annotations

import numpy as np

SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 1.1754944e-38, 1.1754942e-38, 3.4028235e38, -3.4028235e38, 1.7014118e38, 1.8446743e19,
     1.8446745e19, 1e-19, 8388608.0, 16777217.0, 0.1, np.inf, -np.inf, np.nan],
    dtype=np.float32,
)  # fmt: skip
"""Ends of ranges, of float32 and of its squares."""


def raw_bits(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """float32 of any 32 bits."""
    return rng.integers(0, 1 << 32, shape, dtype=np.uint32).view(np.float32)


def near_exponent(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Raw bits, with exponents from a window of a few."""
    first = int(rng.integers(0, 256))
    exponent = np.minimum(first + rng.integers(0, 1 + int(rng.integers(0, 40)), shape), 255).astype(np.uint32)
    bits = rng.integers(0, 1 << 32, shape, dtype=np.uint32)
    return (bits & np.uint32(0x807FFFFF) | exponent << np.uint32(23)).view(np.float32)


def special(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Ends of ranges."""
    return rng.choice(SPECIAL[: int(rng.integers(2, len(SPECIAL) + 1))], shape)


def ordinary(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Around the origin, or far from it."""
    offset = rng.normal(size=3) * 2.0 ** int(rng.integers(-20, 20)) if rng.random() < 0.3 else 0.0
    return (rng.normal(size=shape) + offset).astype(np.float32)


def on_grid(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Few different coordinates: planar, coincident and duplicate triangles."""
    return rng.integers(-2, 3, shape).astype(np.float32)


def mixed_scales(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Each triangle with a size and a place of its own."""
    size, place = (2.0 ** rng.integers(-60, 60, (shape[0], *(1 for _ in shape[1:]))) for _ in range(2))
    with np.errstate(over="ignore"):
        return (rng.normal(size=shape) * size + (place if rng.random() < 0.5 else 0.0)).astype(np.float32)


NUMBERS = (raw_bits, near_exponent, special, ordinary, on_grid, mixed_scales)


def triangle_count(rng: np.random.Generator) -> int:
    """Mostly few: it is where blocks and bins begin and end that is of interest."""
    return int(rng.choice([1, 2, 3, 5, 8, 9, 16, 17, 33, 65, 130], p=[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.07, 0.03]))


def corners(rng: np.random.Generator) -> np.ndarray:
    """(F, 3, 3) float32, corners of triangles; anything may be among them."""
    shape = (triangle_count(rng), 3, 3)
    points = NUMBERS[rng.integers(len(NUMBERS))](rng, shape)
    if rng.random() < 0.3:  # most from one kind, some from another
        other = NUMBERS[rng.integers(len(NUMBERS))](rng, shape)
        points = np.where(rng.random(shape) < rng.random() ** 2, other, points)
    if rng.random() < 0.2:
        axis = int(rng.integers(3))
        points[:, :, axis] = points[0, 0, axis]
    if rng.random() < 0.1:
        points[:] = points[:1]
    if rng.random() < 0.2:
        points[:, 2] = points[:, int(rng.integers(2))]
    return points


def finite_corners(rng: np.random.Generator) -> np.ndarray:
    """The same, with 0 for what is no number."""
    return np.nan_to_num(corners(rng), nan=0.0, posinf=0.0, neginf=0.0)


def shared(rng: np.random.Generator, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) vertices and (F, 3) int32 faces of triangles (F, 3, 3), some of which use each other's vertices, and none some."""
    vertices = points.reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    if rng.random() < 0.3:
        changed = rng.random(faces.shape) < 0.3
        faces = np.where(changed, rng.integers(0, len(vertices), faces.shape), faces).astype(np.int32)
    return vertices, faces
