"""Every public query on whatever may be passed to it, against brute force in float64: examples by hypothesis.

Meshes are small, with corners on a coarse grid, so that triangles without area, duplicates and shared edges are common. Rays
come in every shape, type and memory layout. The oracle lists the crossings of each ray and each triangle by the formulas of
Moeller and Trumbore in float64, and says which rays are *clear*: none of their crossings is so near to an edge, to a grazing
angle or to an end of the ray that float32 decides. Clear rays must be answered exactly as the oracle says; of the others the
queries must agree with one another.

`WRT_PROPERTY_EXAMPLES=5000 pytest tests/contracts/test_properties.py` looks further, at other examples each time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.random_cases import (
    EXAMPLES,
    MARGIN,
    ON_DEVICES,
    SHAPES,
    Case,
    assert_nearest,
    cases,
    crossings_of,
    expected_of,
    laid_out,
    numpy_of,
)

import wrt
from wrt.engine.plan.plan import Plan


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
    like_trimesh = wrt.compat.RayMeshIntersector(case.mesh.to_trimesh(), device="cpu")
    np.testing.assert_array_equal(like_trimesh.intersects_first(origins, directions), hits.primitive_id)
    np.testing.assert_array_equal(like_trimesh.intersects_any(origins, directions), hits.is_hit)
    index_tri, index_ray = like_trimesh.intersects_id(origins, directions)
    np.testing.assert_array_equal(index_tri, lists.primitive_id)
    np.testing.assert_array_equal(index_ray, lists.ray_id)
    like_open3d = wrt.compat.RaycastingScene(device="cpu")
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
