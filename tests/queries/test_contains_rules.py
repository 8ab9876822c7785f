"""`contains` by winding numbers: against solid angles in float64 and closed forms, on every kind of scene and traversal."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.bodies import BODIES, feature_points, winding_number
from support.meshes import load_model
from support.repeated_bodies import BODIES as REPEATED
from support.repeated_bodies import FACES, POINTS, TURNED, VERTICES, box, box_at, in_box, joined

import wrt
from wrt.kernels.traversal import TRAVERSALS
from wrt.query import inside
from wrt.query.checks import inside_check

SIGNED = ("union", "winding")


def by_rules(scene: wrt.Scene, points: np.ndarray, **options: str) -> dict[str, np.ndarray]:
    return {rule: scene.contains(points, rule=rule, **options) for rule in SIGNED}


def expect(scene: wrt.Scene, points: np.ndarray, union: np.ndarray, winding: np.ndarray, **options: str) -> None:
    """Asserts the answers by both rules."""
    found = by_rules(scene, points, **options)
    np.testing.assert_array_equal(found["union"], union)
    np.testing.assert_array_equal(found["winding"], winding)


HALF = in_box(0) | ((np.abs(POINTS[:, 1:]) < 0.5).all(axis=1) & (np.abs(POINTS[:, 0] - 0.5) < 0.5))
"""Points in one of two boxes that overlap by half."""

OVERLAP = ((np.abs(POINTS[:, 1:]) < 0.5).all(axis=1)) & (np.abs(POINTS[:, 0] - 0.25) < 0.25)
LARGE = (np.abs(POINTS) < 1.0).all(axis=1)
NOWHERE = np.zeros(len(POINTS), dtype=bool)

CASES = {
    "overlapping": (joined((VERTICES, FACES), (box_at(0.5), FACES)), HALF, HALF),
    "inside out": (wrt.TriangleMesh(VERTICES, TURNED), NOWHERE, in_box(0)),
    "both inside out": (joined((VERTICES, TURNED), (box_at(0.5), TURNED)), NOWHERE, HALF),
    "one of two inside out": (
        joined((VERTICES, FACES), (box_at(0.5), TURNED)),
        in_box(0) & ~OVERLAP,
        HALF & ~OVERLAP,
    ),
    "a cavity": (joined((VERTICES * 2, FACES), (VERTICES, TURNED)), LARGE & ~in_box(0), LARGE & ~in_box(0)),
    "one within another": (joined((VERTICES * 2, FACES), (VERTICES, FACES)), LARGE, LARGE),
    "one triangle twice": (box(FACES[:1]), in_box(0), in_box(0)),
    "one triangle three times": (box(FACES[3:4], FACES[3:4]), in_box(0), in_box(0)),
    "all twice": (box(FACES), in_box(0), in_box(0)),
    "both sides of every face": (box(TURNED), NOWHERE, NOWHERE),
    "on the same ground": (REPEATED["one in another on the same ground"][0], in_box(0, 2.0), in_box(0, 2.0)),
    "two that touch": (REPEATED["two that touch in triangles"][0], in_box(0) | in_box(1), in_box(0) | in_box(1)),
}


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
@pytest.mark.parametrize("name", CASES)
def test_closed_forms(name, tree):
    """Boxes that overlap, are inside out, have cavities, or are written twice."""
    mesh, union, winding = CASES[name]
    expect(wrt.Scene(mesh, tree, device="cpu"), POINTS, union, winding)


def whole_numbers(mesh: wrt.TriangleMesh, points: np.ndarray) -> np.ndarray:
    """Winding numbers of points, by solid angles in float64; those of a closed surface that faces one way."""
    rows = inside_check.vertex_rows(mesh.vertices.astype(np.float64), mesh.faces)
    turns = inside_check.winding_numbers(rows, np.asarray(points, np.float64))
    assert inside_check.are_whole(turns).all()
    return np.rint(turns)


def spheres(turned: tuple[int, ...] = ()) -> list[wrt.TriangleMesh]:
    """Six spheres that overlap; those in `turned` are inside out."""
    rng, made = np.random.default_rng(5), []
    for number in range(6):
        sphere = trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.4, 0.9))
        faces = np.asarray(sphere.faces)[:, ::-1] if number in turned else np.asarray(sphere.faces)
        made.append(wrt.TriangleMesh((sphere.vertices + rng.uniform(-0.6, 0.6, 3)).astype(np.float32), faces))
    return made


@pytest.mark.parametrize("turned", [(), (1, 4), tuple(range(6))])
def test_against_solid_angles(turned, device):
    """Numbers from -6 to 6, in one mesh and in six, on both trees."""
    meshes = spheres(turned)
    points = np.random.default_rng(1).uniform(-1.3, 1.3, (5, 400, 3))
    turns = whole_numbers(wrt.TriangleMesh.concatenate(meshes), points.reshape(-1, 3)).reshape(5, 400)
    assert np.abs(turns).max() >= 3
    for geometry in (meshes, wrt.TriangleMesh.concatenate(meshes)):
        for tree in ("bvh", "kdtree"):
            expect(wrt.Scene(geometry, tree, device=device), points, turns > 0, turns != 0)


@pytest.mark.parametrize(
    ("tree", "traversal"),
    [
        (tree, name)
        for name, way in TRAVERSALS.items()
        for tree, on in way.on.items()
        if tree != "none" and on.each_hit and way.supports("winding", tree) and way.width is None
    ]
    + [("bvh", "brute")],
)
def test_every_traversal(tree, traversal):
    """Each traversal that offers all hits, for enough points that streams and lists are full."""
    meshes = spheres((2,))
    points = np.random.default_rng(2).uniform(-1.3, 1.3, (3000, 3))
    turns = whole_numbers(wrt.TriangleMesh.concatenate(meshes), points)
    expect(wrt.Scene(meshes, tree, device="cpu"), points, turns > 0, turns != 0, traversal=traversal)


@pytest.mark.parametrize(
    "accelerator", [wrt.KdTree(builder="lazy"), wrt.KdTree(split_clipping=True), wrt.Bvh(width=4)], ids=str
)
def test_other_trees(accelerator):
    """A tree that is built where rays visit it, one that clips triangles, and another width."""
    meshes = spheres((0,))
    points = np.random.default_rng(3).uniform(-1.3, 1.3, (1500, 3))
    turns = whole_numbers(wrt.TriangleMesh.concatenate(meshes), points)
    expect(wrt.Scene(meshes, accelerator, device="cpu"), points, turns > 0, turns != 0)


@pytest.mark.parametrize("name", BODIES)
def test_edges_and_vertices(name):
    """Rays along the direction of the test through vertices and edges of convex bodies: the sum is exactly 1 or 0."""
    body, way = BODIES[name], np.array(inside.DIRECTIONS[0], dtype=np.float32).astype(np.float64)
    scene = wrt.Scene(body, device="cpu")
    points = feature_points(body)
    for distance in (0.2, 5.0):
        start = points - distance * way
        np.testing.assert_array_equal(scene.contains(start, rule="union"), scene.contains(start))
        np.testing.assert_array_equal(scene.contains(start, rule="winding"), scene.contains(start))


def test_the_bunny():
    """Against winding numbers by solid angles, and inside out."""
    bunny = load_model("bunny.ply")
    points = np.random.default_rng(0).uniform(*bunny.bounds, (150, 3))
    triangles = bunny.vertices[bunny.faces].astype(np.float64)
    within = np.array([winding_number(triangles - point) for point in points]) > 0.5
    expect(wrt.Scene(bunny, device="cpu"), points, within, within)
    turned = wrt.TriangleMesh(bunny.vertices, bunny.faces[:, ::-1])
    expect(wrt.Scene(turned, device="cpu"), points, np.zeros(150, dtype=bool), within)


def test_instances(device):
    """Instances that overlap, are turned and mirrored, and one that no ray sees. A mirrored body keeps its front outside."""
    mirror, aside, turn = np.diag([-1.0, 1.0, 1.0, 1.0]), np.eye(4), trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    mirror[0, 3] = aside[0, 3] = 0.5
    points = POINTS[:1500]
    first, second = in_box(0)[:1500], ((np.abs(points[:, 1:]) < 0.5).all(axis=1)) & (np.abs(points[:, 0] - 0.5) < 0.5)
    for matrix in (aside, mirror):
        scene = wrt.Scene([wrt.Instance(box()), wrt.Instance(box(), matrix)], device=device)
        for traversal in ("auto", "single"):
            expect(scene, points, first | second, first | second, traversal=traversal)
    hidden = wrt.Scene([wrt.Instance(box()), wrt.Instance(box(), aside, mask=0)], device=device)
    expect(hidden, points, first, first)
    inside_out = wrt.TriangleMesh(VERTICES, TURNED)
    scene = wrt.Scene([wrt.Instance(box()), wrt.Instance(inside_out, mirror)], device=device)
    expect(scene, points, first & ~second, first ^ second)
    rotated = ((np.abs(points @ turn[:3, :3]) < 0.5).all(axis=1)) | first
    expect(wrt.Scene([wrt.Instance(box()), wrt.Instance(box(), turn)], device=device), points, rotated, rotated)


def test_holes_are_outvoted():
    """A sphere without one triangle: the majority of three rays decides by these rules, too."""
    body = BODIES["icosphere"]
    way = np.array(inside.DIRECTIONS[0])
    hole = int(np.argmax(body.triangles_center @ way))
    scene = wrt.Scene(wrt.TriangleMesh(body.vertices, np.delete(body.faces, hole, axis=0)), device="cpu")
    points = np.outer(np.linspace(-0.9, 0.8, 40), body.triangles_center[hole])
    for rule in SIGNED:
        assert scene.contains(points, rule=rule).all()
        assert not scene.contains(points + 5.0, rule=rule).any()


def test_forms_of_points(device):
    """One point, none, NaN and infinity; Warp in, Warp out."""
    import warp as wp

    scene = wrt.Scene(box(), device=device)
    for rule in SIGNED:
        assert scene.contains([0.0, 0.0, 0.0], rule=rule).shape == ()
        assert scene.contains(np.empty((0, 3)), rule=rule).shape == (0,)
        assert scene.contains([[np.nan, 0, 0], [np.inf, 0, 0], [0.4, 0, 0]], rule=rule).tolist() == [False, False, True]
        native = scene.contains(wp.array(POINTS, dtype=wp.vec3, device=device), rule=rule)
        assert native.dtype == wp.bool
        np.testing.assert_array_equal(native.numpy(), scene.contains(POINTS, rule=rule))


def test_unknown_rules():
    """Refused before anything is compiled, with the rules that there are."""
    scene = wrt.Scene(box(), device="cpu")
    with pytest.raises(ValueError, match="rule 'odd' is unknown; choose from parity, winding, union"):
        scene.contains([0.0, 0.0, 0.0], rule="odd")
    with pytest.raises(TypeError, match="rule must be a name, not int"):
        scene.contains([0.0, 0.0, 0.0], rule=1)


def test_verify_compares_each_rule(monkeypatch):
    """A rule with a wrong sign is found out."""
    from wrt.query.inside import RULES

    scene = wrt.Scene(spheres((1,)), device="cpu")
    assert scene.verify(100).ok
    monkeypatch.setitem(RULES, "union", RULES["winding"])
    report = scene.verify(100)
    assert not report.ok
    assert report.inside.wrong > 0
