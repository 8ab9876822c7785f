"""Distances between meshes and triangles that meet: against all pairs in extended precision, exact cases, and closed forms."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
import trimesh
import warp as wp
from support.pair_oracles import all_pairs, distances, meet, rational_distance, triangles_of
from support.selection import slow

import wrt
from wrt.analysis import clearance, closest_pair, overlapping_triangles
from wrt.analysis.pair_bodies import pair_tree

IDENTITY = np.eye(4)


def moved(*by: float) -> np.ndarray:
    """A translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def turned(seed: int, scale: float = 1.0) -> np.ndarray:
    """A random rotation, and a scale."""
    return trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3)) * [
        [scale],
        [scale],
        [scale],
        [1],
    ]


def box(size: float = 1.0) -> trimesh.Trimesh:
    """A cube around 0."""
    return trimesh.creation.box([size] * 3)


def soup(seed: int, count: int = 40, size: float = 0.3) -> wrt.TriangleMesh:
    """Triangles anywhere in a cube of size 2."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def whole_soup(seed: int, count: int = 40, most: int = 3) -> wrt.TriangleMesh:
    """Triangles of few whole numbers: many touch, many have no area."""
    corners = np.random.default_rng(seed).integers(-most, most + 1, (count, 3, 3)).astype(np.float64)
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def place(a, b, first=IDENTITY, second=IDENTITY, **options) -> wrt.Scene:
    """Two instances."""
    return wrt.Scene([wrt.Instance(a, first), wrt.Instance(b, second)], **({"device": "cpu"} | options))


def check(scene: wrt.Scene, a: np.ndarray, b: np.ndarray, error: float = 1e-14) -> wrt.analysis.ClosestPair:
    """Compares the distance of bodies 0 and 1 with that of all pairs, and the points with their triangles."""
    found, expected = closest_pair(scene, 0, 1), distances(*all_pairs(a, b)).reshape(len(a), len(b))
    assert abs(found.distance - expected.min()) <= error
    assert expected[found.primitive_ids] <= expected.min() + error
    assert abs(np.linalg.norm(found.positions[0] - found.positions[1]) - found.distance) <= error
    for position, triangle in zip(found.positions, (a[found.primitive_ids[0]], b[found.primitive_ids[1]]), strict=True):
        point = np.broadcast_to(position, (1, 3, 3))
        assert distances(point, triangle[None])[0] <= error
    return found


@pytest.mark.width
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_soups(seed, device):
    """Turned, scaled and sheared instances of soups: the distance of all pairs; exchanged, to the bit the same."""
    a, b = soup(seed), soup(seed + 10)
    shear = moved(4.0, 0.5, 0.0)
    shear[0, 1], shear[2, 2] = 0.7, 0.2
    for transform in (moved(2.6, 0.0, 0.0), moved(0.0, 3.0, 1.0) @ turned(seed, 0.1), shear, moved(0.4, 0.3, 0.2)):
        scene = place(a, b, turned(seed + 5), transform, device=device)
        found = check(scene, triangles_of(a, turned(seed + 5)), triangles_of(b, transform))
        back = closest_pair(scene, 1, 0)
        assert (back.distance, back.primitive_ids) == (found.distance, found.primitive_ids[::-1])
        assert back.instance_ids == (1, 0)
        np.testing.assert_array_equal(back.positions, found.positions[::-1])


@pytest.mark.parametrize("seed", [0, 1, *slow(*range(2, 6))])
def test_meeting_is_exact(seed):
    """Triangles of whole numbers, a third of which touch or have no area: the same pairs as by separating planes."""
    a, b = whole_soup(seed), whole_soup(seed + 100)
    for shift in ([0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [5.0, 5.0, 5.0]):
        scene = place(a, b, IDENTITY, moved(*shift))
        expected = np.argwhere(meet(*all_pairs(triangles_of(a), triangles_of(b, moved(*shift)))).reshape(40, 40))
        pairs = overlapping_triangles(scene, 0, 1)
        assert pairs.dtype == np.int32
        np.testing.assert_array_equal(pairs, expected)
        back = overlapping_triangles(scene, 1, 0)
        np.testing.assert_array_equal(back[np.lexsort((back[:, 0], back[:, 1]))][:, ::-1], expected)
        found = closest_pair(scene, 0, 1)
        assert (found.distance == 0.0) == (len(expected) > 0)
        if len(expected):
            assert found.primitive_ids == tuple(expected[0]), "of pairs at distance 0, the first"
            assert np.abs(found.positions[0] - found.positions[1]).max() < 1e-14


def test_signs_of_large_numbers():
    """A vertex in a face, or one unit beside it, with coordinates of 28 bits, of whose products float64 loses half."""
    rng = np.random.default_rng(6)
    for case in range(60):
        a, u, w = rng.integers(-(2**25), 2**25, (3, 3))
        normal = np.cross(u, w)
        shift = (case % 3 - 1) * np.eye(3, dtype=int)[np.abs(normal).argmax()]
        vertex = a + u + w + shift
        away = 2.0**25 * normal / np.linalg.norm(normal)
        floor = np.array([a, a + 4 * u, a + 4 * w], dtype=np.float64)
        spike = np.array([vertex, vertex + np.rint(away + 0.1 * u), vertex + np.rint(away - 0.1 * w)], dtype=np.float64)
        scene = wrt.Scene([wrt.TriangleMesh(one, [[0, 1, 2]]) for one in (floor, spike)], device="cpu")
        expected = sum(int(x) * int(y) for x, y in zip(shift, normal, strict=True)) <= 0
        assert len(overlapping_triangles(scene, 0, 1)) == expected


def test_no_tolerance():
    """One unit in the last place tells touching from apart: at a vertex, on an edge, in one plane, and far from 0."""
    tetrahedron = wrt.TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )
    for touching in ([1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.25, 0.25, 0.5], [0.0, 0.0, -1.0]):
        for base in (0.0, 4096.0):
            scene = place(tetrahedron, tetrahedron, moved(base, base, base), moved(*np.add(touching, base)))
            assert len(overlapping_triangles(scene, 0, 1)) > 0
            assert closest_pair(scene, 0, 1).distance == 0.0
            away = np.add(touching, base)
            away = np.nextafter(away, np.inf if min(touching) >= 0.0 else -np.inf)
            scene.update(1, transform=moved(*away))
            assert len(overlapping_triangles(scene, 0, 1)) == 0
            assert 0.0 < closest_pair(scene, 0, 1).distance <= 3e-12


def test_boxes():
    """Closed forms: face to face, edge to face, corner to corner, one inside the other, and touching in every way."""
    scene = place(box(), box(), IDENTITY, moved(1.75, 0.3, 0.2))
    assert closest_pair(scene, 0, 1).distance == 0.75
    scene.update(1, transform=moved(2.0, 0.1, 0.0) @ trimesh.transformations.rotation_matrix(np.pi / 4, [0, 0, 1]))
    assert closest_pair(scene, 0, 1).distance == pytest.approx(1.5 - np.sqrt(0.5), abs=1e-15)
    scene.update(1, transform=moved(2.0, 3.0, -4.0))
    found = closest_pair(scene, 0, 1)
    assert found.distance == pytest.approx(np.sqrt(14.0), abs=1e-15)
    np.testing.assert_allclose(found.positions, [[0.5, 0.5, -0.5], [1.5, 2.5, -3.5]])
    scene.update(1, transform=moved(0.125, 0.0, 0.0) @ np.diag([0.5, 0.5, 0.5, 1.0]))
    assert closest_pair(scene, 0, 1).distance == 0.125
    assert len(overlapping_triangles(scene, 0, 1)) == 0, "inside, and not touching"
    for shift, least in (([1, 0, 0], 8), ([1, 1, 0], 4), ([1, 1, 1], 1), ([1, 0.5, 0.25], 4), ([0, 0, 0], 12)):
        scene.update(1, transform=moved(*shift))
        assert closest_pair(scene, 0, 1).distance == 0.0
        assert len(overlapping_triangles(scene, 0, 1)) >= least


def test_ties():
    """Of pairs at the same distance, the one of the smallest numbers; for every number of threads, to the bit the same."""
    mesh = trimesh.creation.box([1, 1, 1]).subdivide()
    expected = distances(*all_pairs(triangles_of(mesh), triangles_of(mesh, moved(3, 0, 0)))).reshape(len(mesh.faces), -1)
    assert (expected == 2.0).sum() > 20
    for threads in (1, 2):
        scene = place(mesh, mesh, IDENTITY, moved(3, 0, 0), num_threads=threads)
        assert closest_pair(scene, 0, 1).primitive_ids == tuple(np.argwhere(expected == 2.0)[0])


def test_needles():
    """Triangles 1e-9 as wide as long, nearly parallel to each other, some without an area, and points."""
    rng = np.random.default_rng(3)
    for width in (1e-3, 1e-6, 1e-9, 0.0):
        corners = np.zeros((60, 3, 3))
        corners[:, 1, 0] = rng.uniform(0.5, 1.5, 60)
        corners[:, 2, 0] = rng.uniform(0.0, 1.5, 60)
        corners[:, 1:, 1:] = rng.uniform(-width, width, (60, 2, 2))
        corners[:5] = corners[:5, :1]
        corners += rng.uniform(-0.3, 0.3, (60, 1, 3))
        meshes = [wrt.TriangleMesh(part.reshape(-1, 3), np.arange(90).reshape(-1, 3)) for part in (corners[:30], corners[30:])]
        check(place(*meshes), corners[:30], corners[30:])


def test_nearly_parallel():
    """Long edges, and faces, at angles down to 1e-7 with smaller gaps, against rational numbers: extended precision is off."""
    rng = np.random.default_rng(8)
    for angle in (1e-3, 1e-5, 1e-7):
        thin = np.zeros((24, 3, 3))
        thin[:, 0, 0], thin[:, 1, 0] = rng.uniform(-2, -1, 24), rng.uniform(1, 2, 24)
        thin[:, 2, 0], thin[:, 2, 2] = rng.uniform(-1, 1, 24), rng.uniform(0.1, 1.0, 24) * angle
        thin[:, :2, 1] = rng.uniform(-angle, angle, (24, 2))
        thin[12:, :, 2] = -thin[12:, :, 2] - 1e-4 * angle
        thin = thin @ turned(9)[:3, :3].T
        for a, b in zip(thin[:12], thin[12:], strict=True):
            scene = place(*(wrt.TriangleMesh(one, [[0, 1, 2]]) for one in (a, b)))
            assert closest_pair(scene, 0, 1).distance == pytest.approx(rational_distance(a, b), rel=0, abs=2e-15)


def test_far_and_large():
    """Nothing is left out by rounding: small triangles far from their mesh's centre and from each other, with tiny gaps."""
    rng = np.random.default_rng(4)
    ground = rng.uniform(-1, 1, (120, 3)) * [1e4, 1e4, 0.0]
    corners = ground[:, None] + rng.uniform(-30, 30, (120, 3, 3)) * [1, 1, 0]
    above = corners[rng.permutation(120)[:80]] + rng.uniform(1e-7, 3e-4, (80, 1, 1)) * [0, 0, 1]
    a, b = (wrt.TriangleMesh(part.reshape(-1, 3), np.arange(3 * len(part)).reshape(-1, 3)) for part in (corners, above))
    shift = moved(1e6, -1e6, 0.0)
    found = check(place(a, b), corners, above, 1e-11)
    assert 0.0 < found.distance < 1e-5
    far = check(place(a, b, shift, moved(1e6, -1e6, 1e8)), triangles_of(a, shift), triangles_of(b, moved(1e6, -1e6, 1e8)), 2e-8)
    assert far.distance == pytest.approx(1e8)


def test_boxes_of_trees_are_rounded():
    """Six gaps of about 1e-4, where float32 coordinates in the trees are wrong by five times as much: the least is found."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        corners = rng.uniform(-1e4, 1e4, (7, 1, 3)) + rng.uniform(-1e-6, 1e-6, (7, 3, 3))
        away = rng.normal(size=(6, 1, 3))
        others = corners[:6] + away / np.linalg.norm(away, axis=2, keepdims=True) * rng.uniform(9e-5, 1.1e-4, (6, 1, 1))
        meshes = [wrt.TriangleMesh(one.reshape(-1, 3), np.arange(3 * len(one)).reshape(-1, 3)) for one in (corners, others)]
        check(place(*meshes), corners, others, 1e-11)


def test_maps_that_cancel():
    """A mesh 1e8 from the origin of its space, moved back: rounding is that of the larger coordinates."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        corners = np.rint(rng.uniform(-1, 1, (30, 3, 3)) * 2.0**20) * 2.0**-20
        others = corners + np.array([0.0, 0.0, 2.0])
        others[:, :, 2] += np.rint(rng.uniform(1.0, 9.0, (30, 1)) * 8) * 2.0**-23
        meshes = [wrt.TriangleMesh(one.reshape(-1, 3), np.arange(90).reshape(-1, 3)) for one in (corners, others + 1e8)]
        there = moved(-1e8, -1e8, -1e8)
        check(place(*meshes, IDENTITY, there), corners, triangles_of(meshes[1], there))


@pytest.mark.parametrize("tree", ["bvh", "kdtree", wrt.KdTree(builder="lazy")], ids=str)
def test_every_tree(tree):
    """Also kd-trees, and meshes that share a tree, whose ids are those of the meshes; the same bits."""
    a, b = soup(1, 200), soup(2, 200)
    there = b.transformed(moved(2.3, 0.2, 0.1))
    expected = closest_pair(place(a, b, IDENTITY, moved(2.3, 0.2, 0.1)), 0, 1)
    instanced = closest_pair(place(a, b, IDENTITY, moved(2.3, 0.2, 0.1), accelerator=tree), 0, 1)
    scene = wrt.Scene([a, there], tree, device="cpu")
    shared = closest_pair(scene, 0, 1)
    assert instanced.distance == expected.distance
    assert shared.distance == pytest.approx(expected.distance, abs=1e-15)
    assert shared.primitive_ids == instanced.primitive_ids == expected.primitive_ids
    assert (shared.instance_ids, shared.geometry_ids) == ((-1, -1), (0, 1))
    np.testing.assert_array_equal(overlapping_triangles(scene, 0, 1), np.empty((0, 2)))
    assert clearance(scene).distance == shared.distance


def test_spheres():
    """Two spheres of many triangles, at every distance: the closed form, up to their facets."""
    sphere = trimesh.creation.icosphere(4)
    scene = place(sphere, sphere)
    for distance in (0.001, 0.3, 20.0):
        scene.update(1, transform=moved(2.0 + distance, 0.0, 0.0) @ turned(2))
        assert distance <= closest_pair(scene, 0, 1).distance <= distance + 2 * 2e-3
    scene.update(1, transform=moved(1.0, 0.0, 0.0))
    pairs = overlapping_triangles(scene, 0, 1)
    middles = triangles_of(sphere)[pairs[:, 0]].mean(axis=1)
    assert len(pairs) > 100
    assert np.abs(middles[:, 0] - 0.5).max() < 0.1, "they meet in a circle halfway"


def test_clearance():
    """The nearest two of twenty bodies, of some of them, without hidden ones, and by environment; as by all pairs."""
    rng = np.random.default_rng(5)
    mesh, places = soup(7, 30), [moved(*rng.uniform(-8, 8, 3)) @ turned(k, 0.5) for k in range(20)]
    scene = wrt.Scene([wrt.Instance(mesh, one) for one in places], device="cpu")
    apart = np.full((20, 20), np.inf)
    for i in range(20):
        for j in range(i + 1, 20):
            apart[i, j] = closest_pair(scene, i, j).distance
    found = clearance(scene)
    assert (found.distance, found.instance_ids) == (apart.min(), divmod(int(apart.argmin()), 20))
    assert found.geometry_ids == (0, 0)
    chosen = [11, 2, 5, 2, 17]
    some = clearance(scene, chosen)
    assert some.distance == apart[np.ix_(sorted(set(chosen)), sorted(set(chosen)))].min()
    scene.update(found.instance_ids[0], mask=0)
    apart[found.instance_ids[0]] = apart[:, found.instance_ids[0]] = np.inf
    assert clearance(scene).distance == apart.min()
    scene.update(list(range(0, 20, 2)), environment=0)
    scene.update(list(range(1, 20, 2)), environment=1)
    apart[0::2, 1::2] = apart[1::2, 0::2] = np.inf
    assert clearance(scene).distance == apart.min()


def test_up_to_a_distance():
    """A closed interval; what is farther is not found."""
    scene = place(box(), box(), IDENTITY, moved(1.75, 0.0, 0.0))
    for query in (lambda most: closest_pair(scene, 0, 1, max_distance=most), lambda most: clearance(scene, max_distance=most)):
        assert query(0.75).distance == 0.75
        missed = query(np.nextafter(0.75, 0.0))
        assert (missed.found, missed.distance, missed.primitive_ids, missed.instance_ids) == (False, np.inf, (-1, -1), (-1, -1))
        assert np.isnan(missed.positions).all()
        assert query(0.0).found is False
    scene.update(1, transform=moved(1.0, 0.0, 0.0))
    assert closest_pair(scene, 0, 1, max_distance=0.0).distance == 0.0


def test_trees_are_kept_with_meshes():
    """Moving instances makes nothing anew, and nothing outlives the scene."""
    scene = place(box(), box(0.5), IDENTITY, moved(3, 0, 0))
    closest_pair(scene, 0, 1)
    before = [pair_tree(part) for part in scene.state.parts]
    scene.update(1, transform=moved(4, 0, 0))
    assert closest_pair(scene, 0, 1).distance == 3.25
    assert all(pair_tree(part) is one for part, one in zip(scene.state.parts, before, strict=True))
    gone = [weakref.ref(part) for part in scene.state.parts]
    del scene, before
    gc.collect()
    assert all(one() is None for one in gone)


def test_bad_input():
    """Each mistake is named, and what to do."""
    scene = place(box(), box(), IDENTITY, moved(3, 0, 0))
    with pytest.raises(ValueError, match="first and second are both instance 1"):
        closest_pair(scene, 1, 1)
    with pytest.raises(ValueError, match="second is 2"):
        overlapping_triangles(scene, 0, 2)
    with pytest.raises(TypeError, match="first must be an int"):
        closest_pair(scene, 0.5, 1)
    with pytest.raises(ValueError, match="max_distance must be 0 or more"):
        clearance(scene, max_distance=-1.0)
    with pytest.raises(ValueError, match="max_distance is nan"):
        closest_pair(scene, 0, 1, max_distance=np.nan)
    with pytest.raises(TypeError, match=r"instances must be a sequence of instance ids.*pass \[0, 1\]"):
        clearance(scene, 1)
    with pytest.raises(ValueError, match="at least two"):
        clearance(scene, [1, 1])
    with pytest.raises(ValueError, match=r"instances\[1\] is 7"):
        clearance(scene, [0, 7])
    with pytest.raises(ValueError, match=r"the scene has one; make it of both, wrt.Scene\(\[mesh, other\]\)"):
        clearance(wrt.Scene(box(), device="cpu"))
    assert clearance(scene, wp.array([0, 1], dtype=int, device="cpu")).distance == 2.0


def test_against_fcl():
    """The library of robotics agrees, in its own coordinates and through its own trees."""
    fcl = pytest.importorskip("fcl", reason="python-fcl is not installed: pip install python-fcl")
    a, b = trimesh.creation.icosphere(2), trimesh.creation.torus(1.0, 0.3)
    bodies = []
    for mesh in (a, b):
        model = fcl.BVHModel()
        model.beginModel(len(mesh.vertices), len(mesh.faces))
        model.addSubModel(mesh.vertices, mesh.faces)
        model.endModel()
        bodies.append(model)
    scene = place(a, b)
    for seed, shift in enumerate(([3, 0, 0], [0, 4, 1], [1.5, 0, 0.5])):
        transform = moved(*shift) @ turned(seed)
        scene.update(1, transform=transform)
        there = fcl.CollisionObject(bodies[1], fcl.Transform(transform[:3, :3], transform[:3, 3]))
        here = fcl.CollisionObject(bodies[0], fcl.Transform())
        meets = fcl.collide(here, there, fcl.CollisionRequest(), fcl.CollisionResult()) > 0
        assert meets == (len(overlapping_triangles(scene, 0, 1)) > 0)
        if not meets:
            distance = fcl.distance(here, there, fcl.DistanceRequest(), fcl.DistanceResult())
            assert closest_pair(scene, 0, 1).distance == pytest.approx(distance, abs=1e-6)
