"""`wrt.analysis.bake` and `ambient_occlusion` against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.analysis import ambient_occlusion, bake

SQUARE = wrt.TriangleMesh([[0.0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]])
LAYOUT = np.array([[0.25, 0.25], [0.75, 0.25], [0.75, 0.5], [0.25, 0.5]])
"""Of the square in a quarter of the image's width; u and v are x / 8 + 1 / 4 and y / 8 + 1 / 4."""


def disc(radius: float, height: float, count: int = 256) -> wrt.TriangleMesh:
    turn = 2 * np.pi * np.arange(count) / count
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, height)], axis=1)
    faces = [[count, i, (i + 1) % count] for i in range(count)]
    return wrt.TriangleMesh(np.concatenate([rim, [[0, 0, height]]]), faces)


def test_a_disc_hides_what_its_solid_angle_says():
    """Under a disc of radius R at height h, h^2 / (R^2 + h^2) of the light arrives; none beyond the rays' ends is hidden."""
    floor = wrt.TriangleMesh([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]], [[0, 1, 2]])
    for radius, height in ((1.0, 1.0), (2.0, 0.5), (0.5, 2.0)):
        scene = wrt.Scene([floor, disc(radius, height)])
        point = scene.points_on([0], points=[[0.0, 0, 0]], instance_id=0)
        found = ambient_occlusion(scene, point, rays=4096)
        assert found.shape == (1,)
        assert found[0] == pytest.approx(height**2 / (radius**2 + height**2), abs=0.01)
        assert ambient_occlusion(scene, point, max_distance=0.99 * height)[0] == 1.0
    both = scene.points_on([0, -1], instance_id=0)
    np.testing.assert_array_equal(np.isnan(ambient_occlusion(scene, both)), [False, True])


def test_positions_in_an_image():
    """What a function of points returns lies in texels where it belongs, in rows from the top; charts are padded."""
    scene = wrt.Scene(SQUARE)
    image = bake(scene, lambda points: points.position, to="texture", uv=LAYOUT, resolution=32, padding=2)
    middle = (np.arange(32) + 0.5) / 32
    u, v = np.meshgrid(middle, 1 - middle)
    covered = (u > 0.25) & (u < 0.75) & (v > 0.25) & (v < 0.5)
    np.testing.assert_array_equal(image.covered, covered)
    expected = np.stack([8 * u - 2, 8 * v - 2, 0 * u], axis=-1)
    np.testing.assert_allclose(image.values[covered], expected[covered], atol=1e-5)
    known = np.isfinite(image.values[..., 0])
    rows, columns = np.nonzero(covered)
    box = np.zeros_like(covered)
    box[rows.min() - 2 : rows.max() + 3, columns.min() - 2 : columns.max() + 3] = True
    np.testing.assert_array_equal(known, box)
    corner = rows.min() - 1, columns.min() - 1
    np.testing.assert_array_equal(image.values[corner], image.values[rows.min(), columns.min()])
    edge = image.values[rows.min() - 1, columns.min() + 5]
    np.testing.assert_allclose(edge, image.values[rows.min(), columns.min() + 4 : columns.min() + 7].mean(axis=0), rtol=1e-6)
    bare = bake(scene, lambda points: points.primitive_id, to="texture", uv=LAYOUT[SQUARE.faces], resolution=32, padding=0)
    np.testing.assert_array_equal(np.isfinite(bare.values), covered)
    np.testing.assert_array_equal(bare.values[covered] == 1, (8 * v - 2 > (8 * u - 2) / 2)[covered])


def test_vertices():
    """Positions come back; at the corner of a box the mean of three sides by their angles; instances have their own place."""
    place = np.eye(4)
    place[:3, 3] = 5, 6, 7
    scene = wrt.Scene([wrt.Instance(SQUARE), wrt.Instance(SQUARE, place)])
    found = bake(scene, lambda points: points.position, instance_id=1)
    np.testing.assert_allclose(found, np.asarray(SQUARE.vertices) + place[:3, 3], atol=1e-6)
    sides = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    box = wrt.TriangleMesh(sides, [face for a, b, c, d in quads for face in ([a, b, c], [a, c, d])])
    normals = bake(wrt.Scene(box), lambda points: points.normal)
    np.testing.assert_allclose(normals, (2 * sides - 1) / 3, atol=1e-6)
    np.testing.assert_allclose(bake(wrt.Scene(box), "thickness"), np.ones(8), atol=1e-5)
    assert (bake(wrt.Scene(box), "ambient_occlusion") == 1.0).all()


def test_names_and_wrong_arguments():
    scene = wrt.Scene(SQUARE)
    np.testing.assert_allclose(bake(scene, "sky_view", rays=512), 1.0, atol=0.01)
    for problem, match, call in (
        (ValueError, "what", lambda: bake(scene, "light")),
        (TypeError, "what must be a name or a function of points, not int", lambda: bake(scene, 3)),
        (ValueError, "to", lambda: bake(scene, "thickness", to="image")),
        (ValueError, "the mesh has no texture coordinates; pass uv", lambda: bake(scene, "thickness", to="texture")),
        (ValueError, r"uv must have shape \(4, 2\)", lambda: bake(scene, "thickness", to="texture", uv=LAYOUT[:3])),
        (ValueError, r"from 0\.5 to 1\.5, and an image has", lambda: bake(scene, "thickness", to="texture", uv=2 * LAYOUT)),
        (ValueError, "what must return 6 rows of numbers", lambda: bake(scene, lambda points: points.t[:2])),
        (ValueError, "the scene has 2 surfaces; say with instance_id", lambda: bake(wrt.Scene([SQUARE, SQUARE]), "thickness")),
        (ValueError, "resolution", lambda: bake(scene, "thickness", to="texture", uv=LAYOUT, resolution=0)),
        (ValueError, "max_distance", lambda: ambient_occlusion(scene, scene.points_on([0]), max_distance=-1.0)),
        (TypeError, "scene must be a wrt.Scene", lambda: bake(SQUARE, "thickness")),
    ):
        with pytest.raises(problem, match=match):
            call()
