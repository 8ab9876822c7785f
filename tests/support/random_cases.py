"""Random meshes and rays in any shape, type and layout, and the crossings of each ray in float64: strategies for hypothesis."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

import wrt
from support.environment import DEVICES

LONG = int(os.environ.get("WRT_PROPERTY_EXAMPLES", "0"))
EXAMPLES = settings(
    max_examples=LONG or 120, derandomize=not LONG, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)

ON_DEVICES = pytest.mark.parametrize("device", DEVICES)

MARGIN = 1e-2
"""Barycentric weight, and sine of the angle between ray and triangle, below which a ray is not clear."""

# -- what is passed ----------------------------------------------------------------------------------------------------

SHAPES = st.sampled_from([(), (1,), (0,), (40,), (9, 5), (1, 30), (30, 1), (2, 0, 2), (4, 1, 9)])
FLOATS = [np.float32, np.float64]


@dataclass
class Case:
    """A mesh and rays as they are passed, and the rays as the oracle takes them, float64 and broadcast."""

    mesh: wrt.TriangleMesh
    passed: tuple[Any, Any]
    origins: np.ndarray
    directions: np.ndarray
    t_min: Any
    t_max: Any

    @property
    def shape(self) -> tuple[int, ...]:
        return self.origins.shape[:-1]

    @property
    def is_warp(self) -> bool:
        return any(isinstance(values, wp.array) for values in self.passed)


@st.composite
def meshes(draw) -> wrt.TriangleMesh:
    """Up to a dozen triangles, of corners of their own or shared, near the origin or far from it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shift = draw(st.sampled_from([0.0, 1000.5]))
    triangles, points = draw(st.integers(1, 12)), draw(st.integers(3, 20))
    vertices = rng.integers(-4, 5, (points, 3)) / 4 + shift
    faces = rng.integers(0, points, (triangles, 3)).astype(draw(st.sampled_from([np.int32, np.int64, np.uint8])))
    return wrt.TriangleMesh(vertices.astype(draw(st.sampled_from(FLOATS))), faces[:: draw(st.sampled_from([1, -1]))])


def laid_out(draw, values: np.ndarray) -> Any:
    """The same numbers in some type of array and some layout of memory."""
    layout = draw(st.sampled_from(["plain", "reversed", "strided", "fortran", "list", "read-only", "swapped"]))
    if layout == "reversed" and values.ndim > 1:
        return values[::-1].copy()[::-1]
    if layout == "strided":
        return np.repeat(values, 2, axis=-1)[..., ::2]
    if layout == "fortran":
        return np.asfortranarray(values)
    if layout == "list" and values.size:
        return values.tolist()
    if layout == "read-only":
        values = values.copy()
        values.flags.writeable = False
    if layout == "swapped":
        return values.astype(values.dtype.newbyteorder())
    return values


@st.composite
def cases(draw, device: str = "cpu", warp: bool = True) -> Case:
    """A mesh and rays that are aimed at it, some bad ones among them."""
    mesh = draw(meshes())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = draw(SHAPES)
    shapes = [shape, shape]
    if draw(st.booleans()):  # one of the two broadcasts
        shared = tuple(n if draw(st.booleans()) else 1 for n in shape)
        shapes[draw(st.integers(0, 1))] = draw(st.sampled_from([(), shared, shared[1:] if shared[:1] == (1,) else shared]))
    low, high = mesh.bounds
    origins = rng.uniform(low - 1, high + 1, (*shapes[0], 3))
    directions = rng.uniform(-1, 1, (*shapes[1], 3))
    if draw(st.integers(0, 3)) and np.broadcast_shapes(*shapes) == shapes[1]:  # most are aimed at triangles
        corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, shapes[1])]].astype(np.float64)
        weights = rng.dirichlet((2, 2, 2), shapes[1])
        directions = ((weights[..., None] * corners).sum(axis=-2) - origins) * draw(st.sampled_from([0.5, 1.0, 1.0, 1e-3, 1e3]))
    dtype = draw(st.sampled_from([np.float16, np.float32, np.float64, np.int32, np.uint8]))
    directions = directions.astype(draw(st.sampled_from(FLOATS)))
    origins = np.rint(origins).clip(0, 255).astype(dtype) if dtype in (np.int32, np.uint8) else origins.astype(dtype)
    for values in (origins, directions):
        if values.size and values.dtype.kind == "f" and draw(st.integers(0, 3)) == 0:
            values.reshape(-1)[rng.integers(values.size)] = draw(st.sampled_from([np.nan, np.inf, -np.inf]))
    if directions.size and draw(st.integers(0, 5)) == 0:
        directions.reshape(-1, 3)[0] = 0.0
    whole = np.broadcast_shapes(*shapes)
    t_min, t_max = draw(st.sampled_from([0.0, 0.1, 0])), draw(st.sampled_from([np.inf, 1.7, 3]))
    if draw(st.booleans()):
        t_max = rng.uniform(0.1, 3.0, whole).astype(np.float32)
    passed = laid_out(draw, origins), laid_out(draw, directions)
    if warp and shapes[0] == shapes[1] == whole and whole and draw(st.booleans()) and np.ndim(t_max) == 0:
        kinds = {2: wp.vec3, 4: wp.vec3, 8: wp.vec3d, 1: wp.vec3}
        passed = tuple(
            wp.array(values.astype(np.float64), dtype=kinds[values.itemsize], device=device) for values in (origins, directions)
        )
    as_seen = [np.broadcast_to(values.astype(np.float64), (*whole, 3)) for values in (origins, directions)]
    return Case(mesh, passed, *as_seen, t_min, t_max)


# -- what is expected --------------------------------------------------------------------------------------------------


@dataclass
class Crossings:
    """All crossings of N rays with F triangles, before bounds of t are asked about.

    Attributes:
        t: (N, F) float64, inf where there is none.
        is_clear: (N,) bool.
    """

    t: np.ndarray
    is_clear: np.ndarray

    def within(self, t_min: np.ndarray, t_max: np.ndarray) -> np.ndarray:
        """(N, F) t of the crossings that count; rays are no longer clear that end near one."""
        for bound in (t_min, t_max):
            with np.errstate(invalid="ignore"):
                near = np.abs(self.t - bound[:, None]) <= MARGIN * np.abs(bound[:, None])
            self.is_clear &= ~(near & np.isfinite(self.t)).any(axis=1)
        return np.where((self.t >= t_min[:, None]) & (self.t <= t_max[:, None]), self.t, np.inf)


def crossings_of(mesh: wrt.TriangleMesh, origins: np.ndarray, directions: np.ndarray) -> Crossings:
    """By Moeller and Trumbore, every ray with every triangle; a bad ray has none."""
    origins, directions = origins.reshape(-1, 1, 3), directions.reshape(-1, 1, 3)
    a, b, c = mesh.vertices[mesh.faces].astype(np.float64).transpose(1, 0, 2)
    is_bad = ~np.isfinite(origins + directions).all(axis=2) | ~directions.any(axis=2)
    origins, directions = np.where(is_bad[..., None], 0.0, origins), np.where(is_bad[..., None], 1.0, directions)
    normal = np.cross(b - a, c - a)
    across = np.cross(directions, c - a)
    det = (across * (b - a)).sum(axis=2)
    sizes = np.linalg.norm(normal, axis=1) * np.linalg.norm(directions, axis=2)
    has_area = np.linalg.norm(normal, axis=1) > 1e-9
    is_grazing = np.abs(det) <= MARGIN * sizes
    det = np.where(is_grazing, 1.0, det)
    start = origins - a
    u = (across * start).sum(axis=2) / det
    turned = np.cross(start, b - a)
    v, t = (turned * directions).sum(axis=2) / det, (turned * (c - a)).sum(axis=2) / det
    weights = np.stack([1 - u - v, u, v])
    is_hit = (weights > 0).all(axis=0) & ~is_grazing & has_area & (t >= 0)
    beside = (weights > -MARGIN).all(axis=0) & ~(weights > MARGIN).all(axis=0)
    reach = np.linalg.norm(mesh.bounds - origins, axis=2).max(axis=1)[:, None]
    starts_there = np.abs(t) * np.linalg.norm(directions, axis=2) <= 1e-4 * reach
    unclear = has_area & (is_grazing | beside | ((weights > -MARGIN).all(axis=0) & starts_there))
    return Crossings(np.where(is_hit & ~is_bad, t, np.inf), is_bad[:, 0] | ~unclear.any(axis=1))


def expected_of(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """((N, F) t of the crossings that count, inf elsewhere; (N,) whether the ray is clear)."""
    found = crossings_of(case.mesh, case.origins, case.directions)
    bounds = [np.broadcast_to(np.asarray(b, dtype=np.float64), case.shape).reshape(-1) for b in (case.t_min, case.t_max)]
    return found.within(*bounds), found.is_clear


def numpy_of(values: Any, case: Case) -> np.ndarray:
    """A result as a NumPy array, of the kind and shape that it must have."""
    assert isinstance(values, wp.array if case.is_warp else np.ndarray)
    array = values.numpy() if case.is_warp else values
    assert array.shape[: len(case.shape)] == (case.shape or ((1,) if case.is_warp else ()))
    return array.reshape(-1, *array.shape[len(case.shape or (() if not case.is_warp else (1,))) :])


def assert_nearest(t: np.ndarray, primitive: np.ndarray, expected: np.ndarray, clear: np.ndarray, rtol: float) -> None:
    """Closest hits are those expected; of several that are as near, any."""
    nearest = expected.min(axis=1, initial=np.inf)
    np.testing.assert_array_equal((primitive >= 0)[clear], np.isfinite(nearest)[clear])
    found = np.flatnonzero(clear & (primitive >= 0))
    np.testing.assert_allclose(t[found], nearest[found], rtol=rtol)
    np.testing.assert_allclose(expected[found, primitive[found]], nearest[found], rtol=rtol)
    assert np.isinf(t[primitive < 0]).all()


# -- properties --------------------------------------------------------------------------------------------------------
