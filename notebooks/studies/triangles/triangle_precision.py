"""How right a triangle test is: its t, u and v against float64, what it misses and what it invents, and where it leaks.

Havel and Herout compare tests on triangles of a scene; here the two things that errors grow with are varied one at a time:
how far the triangle is from the origin, in lengths of its longest edge, and how slim it is. All rays of a case start at one
point, so that every test can take part. The exact answer is that of the float32 numbers that the test is given, computed in
float64; pairs whose exact answer is within `MARGIN` of an edge do not count.

Leaks are counted on closed convex bodies, from inside, with rays at vertices and at points of edges: a ray that hits nothing
went through between two triangles. This is asked of the whole engine, with a tree, and of forms that are not in the engine by
brute force.

References: havel-herout-2010.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from studies.triangles.isolated_tests import Beams, Soup, closest, pairs
from wrt.kernels.triangle import TRIANGLE_TESTS

if TYPE_CHECKING:
    import trimesh

    from wrt.kernels.triangle.support.triangle_contract import TestForm, TriangleTest

DISTANCES = (1.0, 10.0, 100.0, 1e3, 1e4)
"""From the origin to the triangle, in lengths of its longest edge."""

SLIMNESS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5)
"""Height over the longest edge, as a share of an equilateral triangle's."""

MARGIN = 0.01
"""Pairs with a weight closer to 0 do not count."""

LEAST_COSINE = 0.1
"""Between a ray and the triangle's normal: what every test finds hard is not measured here."""

NEAR = 3.0
"""Distance where slimness is varied."""

LANES = 8
"""Triangles at once, of forms that are not in the engine."""

SCALES = (1e-6, 1.0, 1e6)
"""Of the whole scene: nothing should depend on it."""


def precision(test: TriangleTest, count: int = 20_000, seed: int = 0) -> dict[str, list[dict[str, Any]]]:
    """Errors of a test by "distance", "slimness" and "scale": a list of cases each, see `errors`.

    Args:
        test: uses its scalar form, to which the others are equal to the bit.
        count: pairs a case.
        seed: of the random pairs, which are the same for all tests.
    """
    return {
        "distance": [{"distance": d, **errors(test, *aimed_pairs(count, d, 1.0, 1.0, seed))} for d in DISTANCES],
        "slimness": [{"slimness": s, **errors(test, *aimed_pairs(count, NEAR, s, 1.0, seed))} for s in SLIMNESS],
        "scale": [{"scale": s, **errors(test, *aimed_pairs(count, NEAR, 1.0, s, seed))} for s in SCALES],
    }


def errors(test: TriangleTest, corners: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> dict[str, Any]:
    """One case.

    Returns:
        "t": relative error, "u" and "v": absolute error, each with its "median", "p99" (99th percentile) and "max" over the
        hits that are clear (None without any); "missed": share of the clear hits that the test misses; "invented": share of
        the clear misses that it hits.
    """
    got = pairs(test, Soup(corners, origin), Beams(origin[None], directions)).astype(np.float64)
    exact = solve(corners, origin, directions)
    t, u, v = exact.T
    clearance = np.minimum(np.minimum(u, v), 1.0 - u - v)
    inside, outside, hit = clearance > MARGIN, clearance < -MARGIN, ~np.isnan(got[:, 0])
    both = inside & hit
    difference = np.abs(got - exact)[both]
    difference[:, 0] /= np.abs(t[both])
    found = {name: quantiles(column) for name, column in zip("tuv", difference.T, strict=True)}
    return {**found, "missed": share(~hit[inside]), "invented": share(hit[outside])}


def share(mask: np.ndarray) -> float | None:
    """Share of what is true; None of nothing."""
    return float(mask.mean()) if mask.size else None


def quantiles(values: np.ndarray) -> dict[str, float] | None:
    """Median, 99th percentile and greatest."""
    if not values.size:
        return None
    middle, high, most = np.quantile(values, [0.5, 0.99, 1.0])
    return {"median": float(middle), "p99": float(high), "max": float(most)}


def aimed_pairs(
    count: int, distance: float, slimness: float, scale: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles around an origin and a ray at each, inside or beside it.

    Returns:
        (N, 3, 3) corners, (3,) origin and (N, 3) directions, float32, N <= count: those that see their triangle at more
        than a grazing angle.
    """
    rng = np.random.default_rng(seed)
    along, aside = unit(rng.normal(size=(count, 3))), unit(rng.normal(size=(count, 3)))
    across = unit(np.cross(along, aside))
    origin = scale * distance * np.array([0.4, -0.3, 0.2])
    middle = origin + scale * distance * unit(rng.normal(size=(count, 3)))
    height = scale * slimness * np.sqrt(0.75)
    corners = np.stack([middle - 0.5 * scale * along, middle + 0.5 * scale * along, middle + height * across], axis=1)
    corners = np.roll(corners, 1, axis=1).astype(np.float32)
    weights = rng.dirichlet((1.0, 1.0, 1.0), count)
    beside = rng.random(count) < 0.5
    weights[beside] = np.roll(weights[beside] * [-1.0, 1.0, 1.0], rng.integers(3), axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    targets = (corners.astype(np.float64) * weights[..., None]).sum(axis=1)
    directions = (targets - origin) * rng.uniform(0.5, 2.0, (count, 1))
    normals = unit(np.cross(along, across))
    steep = np.abs((normals * unit(directions)).sum(axis=1)) > LEAST_COSINE
    near = np.abs(weights).max(axis=1) < 2.0
    kept = steep & near
    return corners[kept], origin.astype(np.float32), directions[kept].astype(np.float32)


def solve(corners: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N, 3) float64 (t, u, v) at which the lines of rays meet the planes of triangles; NaN where they do not."""
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    direction, first, second, start = directions.astype(np.float64), b - a, c - a, origin.astype(np.float64) - a
    p, q = np.cross(direction, second), np.cross(start, first)
    with np.errstate(all="ignore"):
        scale = 1.0 / (first * p).sum(axis=1)
        return (
            np.stack([(second * q).sum(axis=1), (start * p).sum(axis=1), (direction * q).sum(axis=1)], axis=1) * scale[:, None]
        )


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def leaks(test: TestForm, origins: int = 32, subdivisions: int = 4, seed: int = 0) -> dict[str, dict[str, float]]:
    """Rays per million that leave a closed convex body unseen, by "edges" and "vertices".

    Args:
        test: an entry of `TRIANGLE_TESTS`, or a form that is measured only.
        origins: points inside each body; every vertex and three points of every edge are aimed at from each.
        subdivisions: of the icosahedron that bodies are made of: 20 * 4^subdivisions triangles each.
        seed: of the points.

    Returns:
        For each feature "rays", "leaked" and "per_million".
    """
    rng = np.random.default_rng(seed)
    counts = {"edges": np.zeros(2, int), "vertices": np.zeros(2, int)}
    for body in bodies(subdivisions):
        meets = asks_engine(test, body) if test.name in TRIANGLE_TESTS else asks_all(test, body)
        for _ in range(origins):
            origin = (0.6 * rng.random() * body.vertices[rng.integers(len(body.vertices))]).astype(np.float32)
            for feature, points in features(body).items():
                directions = (points - origin).astype(np.float32)
                hit = meets(origin, directions)
                counts[feature] += (len(hit), (~hit).sum())
    return {
        name: {"rays": int(rays), "leaked": int(leaked), "per_million": float(1e6 * leaked / rays)}
        for name, (rays, leaked) in counts.items()
    }


Meets = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(3,) origin, (N, 3) directions -> (N,) whether they hit anything."""


def asks_engine(test: TestForm, body: trimesh.Trimesh) -> Meets:
    """Asks a scene of the body."""
    from wrt.scene.scene import Scene

    scene = Scene(body, "bvh", device="cpu")
    return lambda origin, ways: scene.intersect(origin, ways, traversal="single", triangle_test=test.name).is_hit


def asks_all(test: TestForm, body: trimesh.Trimesh) -> Meets:
    """Asks all triangles of the body."""
    soup = Soup(body.triangles)
    return lambda origin, ways: closest(test, soup, Beams(origin[None], ways), frustum=0, width=LANES)()[1] >= 0


def bodies(subdivisions: int) -> list[trimesh.Trimesh]:
    """A ball, and an ellipsoid of slim triangles that lies askew; both about the origin, convex, with shared vertices."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    ellipsoid = ball.copy()
    ellipsoid.apply_scale((1.0, 0.3, 5.0))
    ellipsoid.apply_transform(trimesh.transformations.euler_matrix(0.3, 1.1, -0.7))
    return [ball, ellipsoid]


def features(body: trimesh.Trimesh) -> dict[str, np.ndarray]:
    """Points on edges and vertices."""
    a, b = np.moveaxis(body.vertices[body.edges_unique], 1, 0)
    return {"edges": np.concatenate([a + share * (b - a) for share in (0.21, 0.5, 0.83)]), "vertices": body.vertices}
