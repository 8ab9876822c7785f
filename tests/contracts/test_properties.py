"""Every public query on whatever may be passed to it, against brute force in float64: examples by hypothesis.

Meshes are small, with corners on a coarse grid, so that triangles without area, duplicates and shared edges are common. Rays
come in every shape, type and memory layout. The oracle lists the crossings of each ray and each triangle by the formulas of
Moeller and Trumbore in float64, and says which rays are *clear*: none of their crossings is so near to an edge, to a grazing
angle or to an end of the ray that float32 decides. Clear rays must be answered exactly as the oracle says; of the others the
queries must agree with one another.

`WRT_PROPERTY_EXAMPLES=5000 pytest tests/contracts/test_properties.py` looks further, at other examples each time.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import warp as wp
from conftest import DEVICES
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import wrt
from wrt.planning.plan import Plan

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


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_every_query_of_rays(device, data):
    """Closest hits and what follows from them, occlusion, counts, lists, blocks, plans: of the same rays."""
    case = data.draw(cases(device))
    scene = wrt.Scene(case.mesh, data.draw(st.sampled_from(["bvh", "kdtree"])), device=device)
    bounds = {"t_min": case.t_min, "t_max": case.t_max}
    expected, clear = expected_of(case)
    hits = scene.intersect(*case.passed, **bounds)
    assert hits.shape == case.shape
    t, primitive = numpy_of(hits.t, case), numpy_of(hits.primitive_id, case)
    assert_nearest(t, primitive, expected, clear, 1e-3)
    is_hit = numpy_of(hits.is_hit, case)
    np.testing.assert_array_equal(is_hit, primitive >= 0)
    np.testing.assert_array_equal(numpy_of(hits.geometry_id, case), np.where(is_hit, 0, -1))
    corners = case.mesh.vertices[case.mesh.faces[primitive]].astype(np.float64)
    u, v = numpy_of(hits.uv, case).astype(np.float64).T
    point = np.stack([1 - u - v, u, v], axis=1)[:, None] @ corners
    near = 1e-4 * (1.0 + np.abs(case.mesh.bounds).max())
    np.testing.assert_allclose(numpy_of(hits.position, case)[is_hit], point[is_hit, 0], atol=near)
    np.testing.assert_allclose(numpy_of(hits.normal, case)[is_hit], case.mesh.face_normals[primitive[is_hit]], atol=1e-5)

    occluded = numpy_of(scene.occluded(*case.passed, **bounds), case)
    np.testing.assert_array_equal(occluded, is_hit)
    count = numpy_of(scene.count(*case.passed, **bounds), case)
    np.testing.assert_array_equal(count[clear], np.isfinite(expected).sum(axis=1)[clear])
    lists = scene.intersect_all(*case.passed, **bounds)
    np.testing.assert_array_equal(numpy_of(lists.count, case), count)
    offsets, listed_t, listed = (
        values.numpy() if case.is_warp else values for values in (lists.offsets, lists.t, lists.primitive_id)
    )
    for ray in np.flatnonzero(clear):
        own = slice(offsets[ray], offsets[ray + 1])
        assert sorted(listed[own]) == np.flatnonzero(np.isfinite(expected[ray])).tolist()
        assert (np.diff(listed_t[own]) >= 0).all()
    assert isinstance(scene.explain(*case.passed, **bounds), Plan)
    if case.shape and not case.is_warp:
        rows = [block.primitive_id for _, block in scene.intersect_blocks(*case.passed, **bounds, memory=700)]
        joined = np.concatenate(rows) if rows else np.zeros(case.shape, dtype=np.int32)
        np.testing.assert_array_equal(joined.reshape(-1), primitive)


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_precise_hits(device, data):
    """In float64: what the oracle says, to its own rounding."""
    case = data.draw(cases(device))
    expected, clear = expected_of(case)
    scene = wrt.Scene(case.mesh, device=device)
    hits = scene.intersect(*case.passed, case.t_min, case.t_max, precise=True)
    assert_nearest(numpy_of(hits.t, case), numpy_of(hits.primitive_id, case), expected, clear, 1e-9)


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_skipping_a_triangle(device, data):
    """The answer is that of the mesh without it."""
    case = data.draw(cases(device, warp=False))
    scene, count = wrt.Scene(case.mesh, device=device), case.mesh.triangle_count
    skip = np.random.default_rng(data.draw(st.integers(0, 99))).integers(-1, count, case.shape)
    expected, clear = expected_of(case)
    expected[np.arange(skip.size), skip.reshape(-1)] = np.where(skip.reshape(-1) >= 0, np.inf, expected[:, -1])
    hits = scene.intersect(*case.passed, case.t_min, case.t_max, skip=skip)
    assert_nearest(hits.t.reshape(-1), hits.primitive_id.reshape(-1), expected, clear, 1e-3)
    own = scene.intersect(*case.passed, case.t_min, case.t_max)
    past = scene.intersect(*case.passed, case.t_min, case.t_max, skip=own)
    assert not ((past.primitive_id == own.primitive_id) & own.is_hit).any()


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_masks_of_instances(device, data):
    """A ray sees the instances that have a bit in common with it."""
    case = data.draw(cases(device, warp=False))
    shift = np.eye(4)
    shift[:3, 3] = data.draw(st.sampled_from([0.0, 0.5]))
    masks = data.draw(st.tuples(st.integers(0, 3), st.integers(0, 3)))
    seen = np.random.default_rng(data.draw(st.integers(0, 99))).integers(0, 4, case.shape)
    scene = wrt.Scene([wrt.Instance(case.mesh, mask=masks[0]), wrt.Instance(case.mesh, shift, mask=masks[1])], device=device)
    parts, clear = [], np.ones(seen.size, dtype=bool)
    for mask, mesh in zip(masks, (case.mesh, case.mesh.transformed(shift)), strict=True):
        t, is_clear = expected_of(Case(mesh, (), case.origins, case.directions, case.t_min, case.t_max))
        parts.append(np.where((seen.reshape(-1, 1) & mask) != 0, t, np.inf))
        clear &= is_clear
    hits = scene.intersect(*case.passed, case.t_min, case.t_max, mask=seen)
    instance, primitive = hits.instance_id.reshape(-1), hits.primitive_id.reshape(-1)
    number = np.where(instance >= 0, instance * case.mesh.triangle_count + primitive, -1)
    assert_nearest(hits.t.reshape(-1), number, np.concatenate(parts, axis=1), clear, 1e-3)
    occluded = scene.occluded(*case.passed, case.t_min, case.t_max, mask=seen)
    np.testing.assert_array_equal(occluded, hits.is_hit)


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_points_that_see_each_other(device, data):
    case = data.draw(cases(device, warp=False))
    with np.errstate(invalid="ignore"):
        a, b = case.origins, case.origins + 2.5 * case.directions  # behind what most rays are aimed at
        visible = wrt.Scene(case.mesh, device=device).visible(a, b)
        found = crossings_of(case.mesh, a, b - a)
    between = found.within(np.zeros(visible.size), np.ones(visible.size))
    far = np.isfinite(a).all(axis=-1) & np.isfinite(b).all(axis=-1) & (a != b).any(axis=-1)
    chosen = found.is_clear & far.reshape(-1)
    np.testing.assert_array_equal(visible.reshape(-1)[chosen], np.isinf(between).all(axis=1)[chosen])


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_points_inside(device, data):
    """Of a tetrahedron, by its four half-spaces."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    corners = rng.integers(-4, 5, (4, 3)) / 4 + data.draw(st.sampled_from([0.0, 1000.5]))
    body = wrt.TriangleMesh(corners, [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    if abs(np.linalg.det(corners[1:] - corners[0])) < 0.05:
        return
    points = rng.uniform(corners.min(axis=0), corners.max(axis=0), (*data.draw(SHAPES), 3))
    affine = np.concatenate([points.reshape(-1, 3).T, np.ones((1, points[..., 0].size))])
    weights = np.linalg.solve(np.vstack([corners.T, np.ones(4)]), affine)
    inside, clear = (weights > 0).all(axis=0), (np.abs(weights) > MARGIN).all(axis=0)
    found = wrt.Scene(body, device=device).contains(laid_out(data.draw, points))
    assert found.shape == points.shape[:-1]
    np.testing.assert_array_equal(found.reshape(-1)[clear], inside[clear])


@ON_DEVICES
@EXAMPLES
@given(st.data())
def test_rays_that_go_on(device, data):
    """From where `spawn` puts them they meet their own triangle no more, and start beside the hit."""
    case = data.draw(cases(device, warp=False))
    scene = wrt.Scene(case.mesh, device=device)
    hits = scene.intersect(*case.passed)
    onward = np.random.default_rng(data.draw(st.integers(0, 99))).normal(size=(*case.shape, 3))
    starts = hits.spawn(laid_out(data.draw, onward))
    assert starts.shape == (*case.shape, 3)
    assert np.isnan(starts[~hits.is_hit]).all()
    near = 1e-4 * (1.0 + np.abs(case.mesh.bounds).max())
    np.testing.assert_allclose(starts[hits.is_hit], hits.position[hits.is_hit], atol=near)
    grazing = np.abs((hits.normal * onward).sum(axis=-1)) < MARGIN * np.linalg.norm(onward, axis=-1)
    again = scene.intersect(starts, onward).primitive_id
    assert not ((again == hits.primitive_id) & hits.is_hit & ~grazing).any()


@EXAMPLES
@given(cases(warp=False))
def test_adapters(case):
    """The shapes of trimesh and Open3D hold the answers of the scene."""
    scene = wrt.Scene(case.mesh, device="cpu")
    origins, directions = case.origins.reshape(-1, 3), case.directions.reshape(-1, 3)
    hits, lists = scene.intersect(origins, directions), scene.intersect_all(origins, directions)
    like_trimesh = wrt.RayMeshIntersector(case.mesh.to_trimesh(), device="cpu")
    np.testing.assert_array_equal(like_trimesh.intersects_first(origins, directions), hits.primitive_id)
    np.testing.assert_array_equal(like_trimesh.intersects_any(origins, directions), hits.is_hit)
    index_tri, index_ray = like_trimesh.intersects_id(origins, directions)
    np.testing.assert_array_equal(index_tri, lists.primitive_id)
    np.testing.assert_array_equal(index_ray, lists.ray_id)
    like_open3d = wrt.RaycastingScene(device="cpu")
    like_open3d.add_triangles(case.mesh.vertices, case.mesh.faces)
    rays = np.concatenate([case.origins, case.directions], axis=-1)
    answer = like_open3d.cast_rays(rays)
    assert answer["t_hit"].shape == case.shape
    np.testing.assert_array_equal(answer["t_hit"].reshape(-1), hits.t)
    np.testing.assert_array_equal(like_open3d.test_occlusions(rays).reshape(-1), hits.is_hit)
    np.testing.assert_array_equal(like_open3d.count_intersections(rays).reshape(-1), lists.count)


JUNK = st.one_of(
    st.none(),
    st.text(max_size=3),
    st.booleans(),
    st.complex_numbers(),
    st.dictionaries(st.integers(), st.integers(), max_size=2),
    st.binary(max_size=4),
    st.sampled_from([object(), object, float, np.datetime64("2020"), np.zeros((2, 4)), np.zeros(3, dtype=complex)]),
    st.sampled_from([np.zeros((2, 3), dtype=object), np.zeros((2, 3), dtype=bool), [[1, 2, 3], [4, 5]], [], {1, 2}, "abc", -1]),
)
SCENE = wrt.Scene(wrt.TriangleMesh(np.eye(3), [[0, 1, 2]]), device="cpu")
QUERIES = [
    SCENE.intersect,
    SCENE.occluded,
    SCENE.count,
    SCENE.intersect_all,
    SCENE.visible,
    SCENE.explain,
    SCENE.intersect_blocks,
]


def dtype_of(junk: Any) -> Any:
    """The type of its elements; None if it is no array."""
    try:
        return np.asarray(junk).dtype
    except ValueError:
        return None


@EXAMPLES
@given(st.data())
def test_junk_is_a_type_error_or_a_value_error(data):
    """Never another exception, and never an answer."""
    query, good = data.draw(st.sampled_from(QUERIES)), np.float32([[0.1, 0.2, 3.0]])
    junk = data.draw(JUNK)
    arguments = [[junk, good], [good, junk], [junk, junk]][data.draw(st.integers(0, 2))]
    with pytest.raises((TypeError, ValueError)):
        # types and values of the arrays of blocks are checked block by block
        list(query(*arguments)) if query == SCENE.intersect_blocks else query(*arguments)
    name = data.draw(st.sampled_from(["skip", "mask", "t_min", "t_max", "traversal", "triangle_test"]))
    is_bound = name in ("t_min", "t_max")
    is_fine = (is_bound and dtype_of(junk) == np.float64) or (name == "skip" and isinstance(junk, int))
    if junk is not None and not is_fine:
        with pytest.raises((TypeError, ValueError)):
            SCENE.intersect(good, good, **{name: junk})
    with pytest.raises((TypeError, ValueError)):
        wrt.TriangleMesh(junk, [[0, 1, 2]])
    with pytest.raises((TypeError, ValueError)):
        wrt.TriangleMesh(np.eye(3), junk)
    with pytest.raises((TypeError, ValueError)):
        wrt.Scene(junk)
