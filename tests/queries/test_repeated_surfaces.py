"""`contains` where surfaces are written more than once, and what `verify` says of it.

With all faces twice everything was outside, with one of a box's twelve twice 5.8 % of the points were wrong, and `verify` ended
with "no answer is wrong".
"""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.repeated_bodies import (
    BODIES,
    FACES,
    POINTS,
    TURNED,
    VERTICES,
    box,
    in_box,
    joined,
)

import wrt
from wrt.query import inside
from wrt.query.checks import inside_check

ZEROS = np.where(VERTICES < 0, -0.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
@pytest.mark.parametrize("name", BODIES)
def test_a_surface_that_is_written_twice_is_there_once(name, tree):
    """Against closed forms. Bodies that touch keep both sides of their common wall; where one is in another, each its floor."""
    mesh, expected = BODIES[name]
    np.testing.assert_array_equal(wrt.Scene(mesh, tree, device="cpu").contains(POINTS), expected)


def test_as_the_body_without_repetitions(device):
    """To the bit, near edges and corners too, for every fifth triangle of a sphere in whatever order, and in another mesh."""
    body = trimesh.creation.icosphere(3)
    vertices, faces = np.add(body.vertices, (3.0, 1.0, -2.0)), np.asarray(body.faces)
    way = np.array(inside.DIRECTIONS[0])
    points = np.concatenate([vertices, vertices[faces].mean(axis=1), vertices[np.asarray(body.edges)].mean(axis=1)])
    points = np.concatenate([points - 0.3 * way, points - 3.0 * way, points + 0.001 * way])
    plain = wrt.Scene(wrt.TriangleMesh(vertices, faces), device=device)
    twice = wrt.TriangleMesh(vertices, np.concatenate([faces, np.roll(faces[::5], 2, axis=1)]))
    others = [wrt.TriangleMesh(vertices, faces), wrt.TriangleMesh(vertices[::-1].copy(), len(vertices) - 1 - faces[::5])]
    expected = plain.contains(points)
    assert 0.2 < expected.mean() < 0.8
    for geometry in (twice, others):
        scene = wrt.Scene(geometry, device=device)
        np.testing.assert_array_equal(scene.contains(points), expected)
        assert scene.state.distinct().triangle_count == plain.triangle_count
        np.testing.assert_array_equal(scene.state.distinct().center, plain.center)
    assert plain.state.distinct() is plain.state, "what repeats nothing costs nothing"


def test_after_an_update():
    """A triangle that no longer repeats another counts again."""
    mesh = box(FACES)
    scene = wrt.Scene(mesh, device="cpu")
    assert scene.contains([0.0, 0.0, 0.0])
    moved = np.concatenate([VERTICES, VERTICES * 2.0]).astype(np.float32)
    scene.update(0, vertices=moved)
    assert scene.contains([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0]]).tolist() == [False, True]


def test_instances():
    """Repeated triangles of a shared mesh, and instances of equal meshes at the same place; others stay apart."""
    twice, plain = box(FACES[:5]), box()
    aside = np.eye(4)
    aside[0, 3] = 1.0
    outside = np.zeros(len(POINTS), dtype=bool)
    for instances, expected in (
        ([(twice, None, 1), (twice, aside, 1)], in_box(0) | in_box(1)),
        ([(plain, None, 1), (plain, np.eye(4), 3), (plain, aside, 1)], in_box(0) | in_box(1)),
        ([(plain, None, 1), (box(), None, 1)], in_box(0)),
        ([(plain, None, 0), (plain, None, 1)], in_box(0)),
        ([(plain, None, 1), (wrt.TriangleMesh(VERTICES, TURNED), None, 1)], outside),
    ):
        scene = wrt.Scene([wrt.Instance(mesh, matrix, mask=mask) for mesh, matrix, mask in instances], device="cpu")
        np.testing.assert_array_equal(scene.contains(POINTS), expected)
    scene = wrt.Scene([wrt.Instance(twice), wrt.Instance(twice)], device="cpu")
    assert scene.contains([0.0, 0.0, 0.0])
    scene.update(1, transform=aside)
    assert scene.contains([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]).all()


# -- verify ------------------------------------------------------------------------------------------------------------

SURE = "no answer is wrong"


@pytest.mark.parametrize(
    ("mesh", "doubt"),
    [
        (box(), None),
        (box(FACES), None),
        (BODIES["two that touch"][0], None),
        (box(faces=FACES[1:]), "3 edges have an odd number of triangles"),
        (box(TURNED[:1]), "1 triangles repeat another one turned over"),
        (box(TURNED), "12 triangles repeat another one turned over"),
        (box(FACES[:1, ::-1], faces=FACES[1:]), "triangles are turned over"),
        (BODIES["one in another on the same ground"][0], "are in several bodies"),
    ],
)
def test_verify_says_what_contains_cannot_answer(mesh, doubt):
    """Its last line is "no answer is wrong" only where contains agrees with winding numbers, and nothing is in doubt."""
    report = wrt.Scene(mesh, device="cpu").verify(100)
    assert report.ok, str(report)
    assert (report.inside.points, report.inside.wrong) == (100, 0)
    assert (str(report).splitlines()[-1] == SURE) == (doubt is None)
    assert len(report.inside.doubts) == (doubt is not None) + (mesh.triangle_count == 13)  # one turned over leaves odd edges
    assert doubt is None or doubt in str(report)


def test_verify_finds_a_wrong_parity(monkeypatch):
    """The reference knows nothing of how a scene finds repetitions, so one that overlooks them is found out."""
    scene = wrt.Scene(box(FACES), device="cpu")
    monkeypatch.setattr(type(scene.state), "find_distinct", lambda state: state)
    report = scene.verify(100)
    assert not report.ok
    assert report.inside.wrong > 50
    assert str(report).endswith("answers are WRONG")


def test_winding_numbers():
    """Two boxes, one in the other: 2, 1 and 0; half a box's sides: fractions; and a point near a side is no fault."""
    big = joined((VERTICES, FACES), (VERTICES * np.float32(3.0), FACES))
    corners = inside_check.vertex_rows(big.vertices.astype(np.float64), big.faces)
    turns = inside_check.winding_numbers(corners, np.array([[0.1, 0.2, 0.3], [1.0, 0.2, 0.1], [2.0, 0.0, 0.0]]))
    np.testing.assert_allclose(turns, [2.0, 1.0, 0.0], atol=1e-12)
    half = inside_check.vertex_rows(VERTICES.astype(np.float64), FACES[:6])
    assert 0.1 < inside_check.winding_numbers(half, np.array([[0.1, 0.2, 0.3]]))[0] < 0.9
    triangles = VERTICES[FACES].astype(np.float64)
    assert inside_check.is_near(np.array([0.1, 0.2, 0.5 + 1e-7]), triangles, 2e-7)
    assert not inside_check.is_near(np.array([0.1, 0.2, 0.5 + 1e-7]), triangles, 5e-8)
