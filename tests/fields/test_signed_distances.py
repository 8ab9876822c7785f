"""Signed distances: closed forms, every sign on hostile meshes against the table of the guide, limits, forms of points."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from support.open_surfaces import surfaces
from support.sign_table import SIGNS, wrong_shares

import wrt
from wrt.analysis.pseudonormal_table import edge_normals, vertex_normals

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "distances.md"
POINTS = np.random.default_rng(1).uniform(-2.0, 2.0, (3000, 3))


def box_distance(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """The closed form."""
    away = np.abs(points) - half
    return np.linalg.norm(np.maximum(away, 0.0), axis=-1) + np.minimum(away.max(axis=-1), 0.0)


@pytest.mark.parametrize("sign", SIGNS)
@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
def test_closed_forms(tree, sign):
    """A box, a sphere and a torus; the round ones within the deviation of their meshes."""
    half = np.array([0.5, 1.0, 1.5])
    found = wrt.analysis.signed_distance(wrt.Scene(trimesh.creation.box(2 * half), tree, device="cpu"), POINTS, sign=sign)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, box_distance(POINTS, half), rtol=2e-6, atol=1e-6)
    sphere = wrt.Scene(trimesh.creation.icosphere(4), tree, device="cpu")
    found = wrt.analysis.signed_distance(sphere, POINTS.reshape(30, 100, 3), sign=sign)
    np.testing.assert_allclose(found.ravel(), np.linalg.norm(POINTS, axis=1) - 1.0, atol=2.5e-3)
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=256, minor_sections=128)
    expected = np.hypot(np.linalg.norm(POINTS[:, :2], axis=1) - 1.0, POINTS[:, 2]) - 0.4
    found = wrt.analysis.signed_distance(wrt.Scene(torus, tree, device="cpu"), POINTS, sign=sign)
    np.testing.assert_allclose(found, expected, atol=1.2e-3)


@pytest.fixture(scope="module")
def shares():
    return wrong_shares()


def test_the_table_of_the_guide(shares):
    """Its numbers are those that are measured; more than 30 meshes."""
    rows = dict(re.findall(r"^\| ([^|]+) \| [a-z ]+ \| ([\d. |]+) \|$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE))
    assert rows.keys() == shares.keys()
    assert len(rows) >= 30
    for name, (kind, measured) in shares.items():
        stated = [float(value) for value in rows[name].split("|")]
        atol = 0.3 if kind == "meets itself" else 0.15  # where sheets cross, the last bits of NumPy's sines count
        np.testing.assert_allclose(stated, [measured[rule] for rule in SIGNS], atol=atol, err_msg=name)


def test_which_sign_is_right(shares):
    """What the guide says of each sign."""
    kinds = {name: kind for name, (kind, _) in shares.items()}
    wrong = {rule: {name: own[rule] for name, (_, own) in shares.items()} for rule in SIGNS}
    for name, kind in kinds.items():
        if kind == "closed":
            assert max(wrong[rule][name] for rule in SIGNS) == 0.0
        if kind in ("overlapping", "meets itself", "doubled", "not manifold") and name != "one of two inverted":
            assert wrong["winding"][name] == wrong["auto"][name] == 0.0
        if kind == "turned over":
            assert wrong["parity"][name] == wrong["auto"][name] == 0.0
    assert wrong["parity"]["doubled, vertices apart"] > 5.0
    assert wrong["parity"]["six spheres"] > 1.0
    assert wrong["winding"]["half turned over"] > 5.0
    assert wrong["pseudonormal"]["inverted"] == 100.0
    assert wrong["pseudonormal"]["a fin on an edge"] > 1.0


def test_what_auto_chooses():
    """Winding numbers, but parity for closed meshes whose triangles face any way."""
    rules = {name: wrt.analysis.sign_rule(wrt.Scene(one.mesh, device="cpu")) for name, one in surfaces().items()}
    assert {rules[name] for name in ("1% turned over", "20% turned over", "half turned over")} == {"parity"}
    assert {rule for name, rule in rules.items() if "turned" not in name or "missing" in name} == {"winding"}


def test_at_edges_and_vertices():
    """Acute wedges, where the normal of one face tells the wrong side, by the sum at the edge and at the tip."""
    tip = trimesh.Trimesh([[0, 0, 0], [4, 1, 0], [4, -1, 0.5], [4, 0, -1.5]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    if tip.volume < 0:
        tip.invert()
    scene = wrt.Scene(tip, device="cpu")
    points = np.random.default_rng(2).normal(size=(4000, 3)) * [1.0, 1.5, 1.5] + [-0.2, 0, 0]
    inside = wrt.analysis.signed_distance(scene, points, sign="parity") < 0
    near = scene.closest_point(points)
    assert (near.feature == 0).sum() > 500
    assert (near.feature == 1).sum() > 500
    found = wrt.analysis.signed_distance(scene, points, sign="pseudonormal")
    clear = near.distance > 1e-5
    np.testing.assert_array_equal((found < 0)[clear], inside[clear])
    behind_one = (np.einsum("ij,ij->i", near.normal, points - near.position) < 0) & ~inside & clear
    assert behind_one.sum() > 10, "a single normal would be wrong"


def test_pseudonormals_of_a_box():
    """Angles at a corner weigh its three sides alike, however they are cut into triangles; edges point half way."""
    box = trimesh.creation.box((2, 2, 2))
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    for corners, own in ((vertices, faces), (vertices[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))):
        normals = vertex_normals(corners, own)
        np.testing.assert_allclose(normals, np.pi / 2 * np.sign(corners), atol=1e-12)
        edges = edge_normals(corners, own)
        middles = 0.5 * (corners[own] + corners[np.roll(own, -1, axis=1)])
        on_side = np.abs(middles).max(axis=-1, keepdims=True) * np.where(np.abs(middles) > 0.99, np.sign(middles), 0.0)
        flat = (np.abs(middles) > 0.99).sum(axis=-1) == 1
        np.testing.assert_allclose(edges[~flat], on_side[~flat], atol=1e-12)
        np.testing.assert_allclose(edges[flat], 2.0 * on_side[flat], atol=1e-12)


def test_max_distance():
    """Included; beyond it, an infinity with the sign, or NaN for pseudonormals; a limit for each point."""
    scene = wrt.Scene(trimesh.creation.box((2, 2, 2)), device="cpu")
    points = [[0, 0, 0], [0, 0, 0.5], [0, 0, 1.5], [0, 0, 3.0]]
    for sign in ("auto", "parity", "winding"):
        np.testing.assert_array_equal(
            wrt.analysis.signed_distance(scene, points, sign=sign, max_distance=0.5), [-np.inf, -0.5, 0.5, np.inf]
        )
    found = wrt.analysis.signed_distance(scene, points, sign="pseudonormal", max_distance=0.5)
    np.testing.assert_array_equal(found, [np.nan, -0.5, 0.5, np.nan])
    each = wrt.analysis.signed_distance(scene, points, max_distance=[1.0, 0.1, 0.6, 0.0])
    np.testing.assert_array_equal(each, [-1.0, -np.inf, 0.5, np.inf])


@pytest.mark.parametrize("sign", SIGNS)
def test_zeros_have_no_sign(sign):
    """On the surface, also for points that a sign says are inside."""
    box = trimesh.creation.box((2, 2, 2))
    points = np.concatenate([box.vertices, box.triangles_center])
    found = wrt.analysis.signed_distance(wrt.Scene(box, device="cpu"), points, sign=sign)
    assert (found == 0.0).all()
    assert not np.signbit(found).any()


def test_forms_of_points(device):
    """One point, none, NaN and infinity; Warp in, Warp out; instances; far from 0."""
    box = trimesh.creation.box((2, 2, 2))
    scene = wrt.Scene(box, device=device)
    for sign in SIGNS:
        found = wrt.analysis.signed_distance(scene, [0.0, 0.0, 0.25], sign=sign)
        assert (found.shape, float(found)) == ((), -0.75)
        assert wrt.analysis.signed_distance(scene, np.empty((0, 3)), sign=sign).shape == (0,)
        bad = wrt.analysis.signed_distance(scene, [[np.nan, 0, 0], [0, -np.inf, 0], [0, 0, 3]], sign=sign)
        np.testing.assert_array_equal(bad, [np.nan, np.nan, 2.0])
        native = wrt.analysis.signed_distance(scene, wp.array(POINTS, dtype=wp.vec3, device=scene.device), sign=sign)
        np.testing.assert_array_equal(native.numpy(), wrt.analysis.signed_distance(scene, POINTS.astype(np.float32), sign=sign))
        moved = np.diag([-1.0, 1.0, 1.0, 1.0])
        moved[0, 3] = 5e6
        twice = wrt.Scene([wrt.Instance(box, moved), wrt.Instance(box, np.diag([0.5, 0.5, 0.5, 1.0]))], device=device)
        near = wrt.analysis.signed_distance(twice, [[5e6, 0.0, 0.25], [5e6, 0.0, 2.0], [0, 0, 0]], sign=sign)
        np.testing.assert_allclose(near, [-0.75, 1.0, -0.5], atol=0.3 if sign == "winding" else 0.01)


def test_what_is_refused():
    scene = wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu")
    with pytest.raises(ValueError, match="sign 'odd' is unknown; choose from auto, parity, pseudonormal, winding"):
        wrt.analysis.signed_distance(scene, [0.0, 0.0, 0.0], sign="odd")
    with pytest.raises(TypeError, match="sign must be a name, not int"):
        wrt.analysis.signed_distance(scene, [0.0, 0.0, 0.0], sign=1)
    with pytest.raises(ValueError, match="max_distance must be 0 or more"):
        wrt.analysis.signed_distance(scene, [0.0, 0.0, 0.0], max_distance=-1.0)
    with pytest.raises(ValueError, match=r"points must have shape"):
        wrt.analysis.signed_distance(scene, [0.0, 0.0])


@pytest.mark.parametrize("power", [-60, -46, 30])
def test_pseudonormals_of_tiny_and_huge_scenes(power):
    """The sides of the same scene of size 1: products of three lengths neither vanish nor overflow."""
    mesh, points = trimesh.creation.icosphere(2), np.random.default_rng(0).uniform(-1.3, 1.3, (500, 3)).astype(np.float32)
    vertices, scale = mesh.vertices.astype(np.float32), np.float32(2.0**power)
    one, other = (wrt.Scene(wrt.TriangleMesh(vertices * size, mesh.faces), device="cpu") for size in (np.float32(1.0), scale))
    expected = wrt.analysis.signed_distance(one, points, sign="pseudonormal")
    assert expected.min() < -0.1 < 0.1 < expected.max()
    found = wrt.analysis.signed_distance(other, points * scale, sign="pseudonormal")
    np.testing.assert_array_equal(found < 0.0, expected < 0.0)
