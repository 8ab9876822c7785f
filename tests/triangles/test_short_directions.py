"""Directions of every length, and with components of every size: one rule, whatever answers.

Directions of 1e-38 missed and those of 1e-37 could hit at t = inf; a component of 1e-42 in one ray of a hundred made a view
three times as slow.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.algorithms import CLASSICS
from support.hits import assert_same_hits, mixed_rays
from support.meshes import SCENES

import wrt
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.kernels.traversal import TRAVERSALS

TREES = {"kdtree": wrt.KdTree(builder="in_place"), "bvh": wrt.Bvh()}
WAYS = ("engine", pytest.param("classics", marks=pytest.mark.classics))
MESH = SCENES["random_triangles"]()


def rays_at(mesh: wrt.TriangleMesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Good rays of every kind, with directions whose largest component is 1 to 2, float32."""
    origins, directions = mixed_rays(mesh, 2 * count, seed)
    good = np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1) & (directions != 0).any(axis=1)
    origins, directions = origins[good][:count], directions[good][:count]
    with np.errstate(all="ignore"):
        exponent = np.frexp(np.abs(directions).max(axis=1))[1]
    return origins, np.ldexp(directions, 1 - exponent[:, None]).astype(np.float32)


def closest_and_any(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray, ways: str):
    """What every traversal of a scene says, classics or all others: (its name, closest hits or None, occlusion or None)."""
    for name, way in TRAVERSALS.items():
        if (name in CLASSICS) != (ways == "classics") or way.needs_shared_origin or way.width not in (None, scene.state.width):
            continue
        if scene.accelerator.kind in way.trees or "none" in way.trees:
            kind = scene.accelerator.kind if scene.accelerator.kind in way.trees else "none"
            closest = scene.intersect(origins, directions, traversal=name) if way.supports(CLOSEST, kind) else None
            dark = scene.occluded(origins, directions, traversal=name) if way.supports(ANY, kind) else None
            yield name, closest, dark


def other_answers(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray) -> dict[str, np.ndarray]:
    """(rays,) whether a ray is hit, by queries that are no traversals of this scene."""
    few = [scene.intersect(o, d).is_hit for o, d in zip(origins[:20], directions[:20], strict=True)]
    placed = wrt.Scene([wrt.Instance(scene.meshes[0])], device="cpu")
    return {
        "count": scene.count(origins, directions) > 0,
        "all": scene.intersect_all(origins, directions).count > 0,
        "precise": scene.intersect(origins, directions, precise=True).is_hit,
        "instances": placed.intersect(origins, directions).is_hit,
        "single instances": placed.intersect(origins, directions, traversal="single").is_hit,
        "one ray": np.concatenate([few, scene.intersect(origins[20:], directions[20:]).is_hit]),
    }


@pytest.mark.parametrize("ways", WAYS)
@pytest.mark.parametrize("kind", TREES)
def test_short_directions_hit_or_miss_everywhere(kind, ways):
    """From 2^-126 on every length has the same hits, at t in proportion; below, every ray misses, whatever answers."""
    scene = wrt.Scene(MESH, TREES[kind], device="cpu")
    origins, directions = rays_at(MESH, 600)
    whole = scene.intersect(origins, directions, traversal="brute")
    assert 0.3 < whole.is_hit.mean() < 0.99
    for power in (-126, -116, -105, -100, -99, -64, 40):
        scaled = np.ldexp(directions, power).astype(np.float32)
        expected = scene.intersect(origins, scaled, traversal="brute")
        kept = (np.abs(directions) >= max(2.0**-20, 2.0 ** (-126 - power))) | (directions == 0)
        same = kept.all(axis=1) & (whole.t.astype(np.float64) < 2.0 ** (127 + power))  # no component is lost, and t is finite
        assert same.any()
        np.testing.assert_array_equal(expected.primitive_id[same], whole.primitive_id[same])
        np.testing.assert_array_equal(expected.t[same], np.ldexp(whole.t[same], -power))
        for name, hits, dark in closest_and_any(scene, origins, scaled, ways):
            if hits is not None:
                assert_same_hits(hits, expected)
            if dark is not None:
                np.testing.assert_array_equal(dark, expected.is_hit, err_msg=name)
    short = np.ldexp(directions, -127).astype(np.float32)
    for scale in (0.99, 2.0**-10, 2.0**-20):
        for name, hits, dark in closest_and_any(scene, origins, (short * np.float32(scale)).astype(np.float32), ways):
            assert hits is None or not hits.is_hit.any(), name
            assert dark is None or not dark.any(), name
        for name, is_hit in other_answers(scene, origins, (short * np.float32(scale)).astype(np.float32)).items():
            assert not is_hit.any(), name


@pytest.mark.parametrize("ways", WAYS)
@pytest.mark.parametrize("kind", TREES)
def test_negligible_components_count_as_zero(kind, ways):
    """A component below 2^-126, or 2^-100 of the largest, gives the bits of one of 0."""
    scene = wrt.Scene(MESH, TREES[kind], device="cpu")
    origins, directions = rays_at(MESH, 600, seed=2)
    rng = np.random.default_rng(3)
    least = np.abs(directions).argmin(axis=1)
    tiny, zero = directions.copy(), directions.copy()
    rows = np.arange(len(origins))
    tiny[rows, least] = rng.choice([1e-42, -1e-42, 1e-45, 1e-38, 5e-32, -7e-31], len(origins)).astype(np.float32)
    zero[rows, least] = 0.0
    expected = scene.intersect(origins, zero, traversal="brute")
    assert expected.is_hit.mean() > 0.1
    for name, hits, dark in closest_and_any(scene, origins, tiny, ways):
        if hits is not None:
            assert_same_hits(hits, expected)
        if dark is not None:
            np.testing.assert_array_equal(dark, expected.is_hit, err_msg=name)
    counts = scene.count(origins, zero)
    np.testing.assert_array_equal(scene.count(origins, tiny), counts)
    np.testing.assert_array_equal(scene.intersect_all(origins, tiny).count, counts)


@pytest.mark.parametrize("ways", WAYS)
@pytest.mark.parametrize("kind", TREES)
def test_no_hit_at_infinity(kind, ways):
    """A hit whose t is beyond float32 is none, and one within is one, whatever answers."""
    corners = MESH.vertices * np.float32(1e9)
    scene = wrt.Scene(wrt.TriangleMesh(corners, MESH.faces), TREES[kind], device="cpu")
    origins, directions = rays_at(MESH, 600, seed=4)
    origins = origins * np.float32(1e9)
    unit = scene.intersect(origins, directions, traversal="brute")
    scaled = directions * np.float32(2.0**-100)
    expected = scene.intersect(origins, scaled, traversal="brute")
    finite = unit.t.astype(np.float64) * 2.0**100 <= np.finfo(np.float32).max
    assert 0.05 < finite.mean() < unit.is_hit.mean() - 0.05
    np.testing.assert_array_equal(expected.is_hit, finite)
    assert np.isfinite(expected.t[finite]).all()
    for name, hits, dark in closest_and_any(scene, origins, scaled, ways):
        if hits is not None:
            assert_same_hits(hits, expected)
        if dark is not None:
            np.testing.assert_array_equal(dark, expected.is_hit, err_msg=name)
    for name, is_hit in other_answers(scene, origins, scaled).items():
        if name != "precise":  # in float64, a t beside the largest float32 may be on the other side of it
            np.testing.assert_array_equal(is_hit, expected.is_hit, err_msg=name)


def test_a_hit_beyond_float32_is_none():
    """The same for one triangle and few rays, whose kernels are soon compiled."""
    scene = wrt.Scene(wrt.TriangleMesh([[0, 0, 0], [1e9, 0, 0], [0, 1e9, 0]], [[0, 1, 2]]), device="cpu")
    origins = np.float32([[1e8, 1e8, 1e9], [1e8, 1e8, 1e9]])
    directions = np.float32([[0, 0, -(2.0**-98)], [0, 0, -(2.0**-99)]])
    hits = scene.intersect(origins, directions)  # t is 3.2e38 and 6.3e38; float32 ends at 3.4e38
    np.testing.assert_array_equal(hits.is_hit, [True, False])
    assert np.isfinite(hits.t[0])
