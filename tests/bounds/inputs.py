"""Numbers, triangles and rays for the search: random, and such that roundings add up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

UNIT = 2.0**-24
"""Half a unit in the last place of 1, the greatest relative error of a rounding to float32."""

SCALES = 100
"""Scenes have sizes of 2^-SCALES to 2^SCALES."""


def numbers(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Float32 of both signs and sizes up to 2, each row (the first axis) of one kind."""
    kind = rng.integers(0, 5, (shape[0],) + (1,) * (len(shape) - 1))
    ordinary = rng.uniform(-1.0, 1.0, shape)
    above = rng.choice([-1.0, 1.0], shape) * (1.0 + rng.integers(0, 4, shape) * 2.0**-23)  # the coarsest roundings
    below = rng.choice([-1.0, 1.0], shape) * (1.0 - rng.integers(0, 4, shape) * 2.0**-24)
    exponents = ordinary * 2.0 ** rng.integers(-30, 1, shape)
    few = rng.integers(-4, 5, shape) / 4.0 + rng.integers(-1, 2, shape) * 2.0**-23
    return np.choose(kind, [ordinary, above, below, exponents, few]).astype(np.float32)


def scales(rng: np.random.Generator, count: int, most: int = SCALES) -> np.ndarray:
    """(count, 1) powers of two, a third of them 1."""
    return np.where(rng.random((count, 1)) < 0.33, 1.0, np.exp2(rng.integers(-most, most + 1, (count, 1)))).astype(np.float32)


def weights(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) float64 weights of points of triangles: inside, at edges and vertices and close to them."""
    inside = rng.dirichlet([1.0] * 3, count)
    near = np.exp2(-rng.uniform(0.0, 40.0, (count, 3)))
    edge = inside * rng.integers(0, 2, (count, 3))
    chosen = np.choose(rng.integers(0, 3, (count, 1)), [inside, near, edge]) + 1e-30
    return chosen / chosen.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class Cases:
    """Rays, each with a triangle that its line meets or nearly meets.

    Attributes:
        origin, direction: (N, 3) float32.
        corners: (N, 3, 3) float32, of the triangles.
        reach: (N,) float64: largest distance along an axis between the origin and a corner, and twice the origin's own largest
            coordinate, as the centre of a scene is 0.
    """

    origin: np.ndarray
    direction: np.ndarray
    corners: np.ndarray
    reach: np.ndarray


def triangles(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3, 3) float32 corners, of sizes up to 2: any, needles, slivers, small ones far away, some in a plane."""
    corners = numbers(rng, (count, 3, 3)).astype(np.float64)
    along = rng.uniform(-1.0, 2.0, (count, 1))
    thin = np.exp2(-rng.uniform(0.0, 30.0, (count, 1))) * rng.uniform(-1.0, 1.0, (count, 3))
    needle = corners[:, 0] + along * (corners[:, 1] - corners[:, 0]) + thin
    kind = rng.integers(0, 4, (count, 1))
    corners[:, 2] = np.where(kind == 1, needle, corners[:, 2])
    small = np.exp2(-rng.uniform(0.0, 20.0, (count, 1, 1)))
    corners = np.where(kind[:, :, None] == 2, corners[:, :1] + small * (corners - corners[:, :1]), corners)
    axis, flat = rng.integers(0, 3, count), rng.random(count) < 0.15
    corners[flat, :, axis[flat]] = corners[flat, :1, axis[flat]]
    return corners.astype(np.float32)


def rays_at(rng: np.random.Generator, points: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(N, 3) float32 directions from the origins to points, of any length; a fifth along axes and diagonals."""
    count = len(points)
    direction = points - origin.astype(np.float64)
    size = np.abs(direction).max(axis=1, keepdims=True)
    direction = direction / np.where(size > 0.0, size, 1.0) * np.exp2(rng.integers(-20, 21, (count, 1)))
    plain = rng.integers(-1, 2, (count, 3)) + rng.integers(-1, 2, (count, 3)) * 2.0**-24
    direction = np.where(rng.random((count, 1)) < 0.8, direction, plain)
    none = ~(np.abs(direction).max(axis=1) > 0.0)
    direction[none] = [0.0, 0.0, 1.0]
    return direction.astype(np.float32)


def cases(rng: np.random.Generator, count: int, most: int = SCALES) -> Cases:
    """Rays at triangles."""
    corners = triangles(rng, count)
    points = (weights(rng, count)[:, :, None] * corners).sum(axis=1)
    origin = numbers(rng, (count, 3)).astype(np.float64)
    near = np.exp2(-rng.uniform(0.0, 24.0, (count, 1)))
    origin = np.where(rng.random((count, 1)) < 0.3, points + near * origin, origin).astype(np.float32)
    direction = rays_at(rng, points, origin)
    size = scales(rng, count, most)
    origin, corners = origin * size, corners * size[:, :, None]
    far = np.abs(corners.astype(np.float64) - origin[:, None]).max(axis=(1, 2))
    return Cases(origin, direction, corners, np.maximum(far, 2.0 * np.abs(origin.astype(np.float64)).max(axis=1)))
