"""`Scene.filtered`: rays pass through triangles and the holes of alpha masks, and answers are those of what is left."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import pickle
from typing import Any

import numpy as np
import pytest
import warp as wp
from PIL import Image
from support.hits import mixed_rays
from support.meshes import degenerate_soup
from support.ptx import compile_to_ptx
from support.written_gltf import GltfWriter

import wrt
from wrt.cluster.identity.scene_hashes import scene_hash
from wrt.kernels.answers import MASKED
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.materials.material import cutoff_of_image

TEAPOT = wrt.scenes.build("teapot", level=3)

UP, DOWN = np.array([0, 0, 1], dtype=np.float32), np.array([0, 0, -1], dtype=np.float32)

SQUARE = wrt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
"""Of two triangles in the plane z = 0; texture coordinates are x, y."""

FLOOR = wrt.TriangleMesh(np.asarray(SQUARE.vertices) - UP, SQUARE.faces)


def leaf(radius: float = 0.4, pixels: int = 64, **texture) -> wrt.TriangleMesh:
    """The square with a disc of an image on it."""
    across = (np.arange(pixels) + 0.5) / pixels - 0.5
    image = np.full((pixels, pixels, 4), 255, dtype=np.uint8)
    image[..., 3] = np.where(np.hypot(across[:, None], across) < radius, 255, 0)
    material = wrt.Material(color_texture=wrt.Texture(image, **texture), alpha_cutoff=0.5)
    return SQUARE.with_materials(material, uv=np.asarray(SQUARE.vertices)[:, :2])


def alpha_of(texture: wrt.Texture, uv: np.ndarray) -> np.ndarray:
    """(N,) float64 in [0, 255] at texture coordinates, bilinear."""

    def folded(coordinate: np.ndarray, wrap: str) -> np.ndarray:
        if wrap == "mirror":
            return 1 - np.abs(coordinate - 2 * np.floor(coordinate / 2) - 1)
        return coordinate - np.floor(coordinate) if wrap == "repeat" else np.clip(coordinate, 0, 1)

    def texels(place: np.ndarray, count: int, wrap: str) -> tuple[list[np.ndarray], np.ndarray]:
        first = np.floor(place).astype(int)
        both = [number % count if wrap == "repeat" else np.clip(number, 0, count - 1) for number in (first, first + 1)]
        return both, place - first

    (height, width), alpha = texture.alpha.shape, texture.alpha.astype(float)
    columns, a = texels(folded(uv[:, 0], texture.wrap[0]) * width - 0.5, width, texture.wrap[0])
    rows, b = texels((1 - folded(uv[:, 1], texture.wrap[1])) * height - 0.5, height, texture.wrap[1])
    upper, lower = ((1 - a) * alpha[row, columns[0]] + a * alpha[row, columns[1]] for row in rows)
    return (1 - b) * upper + b * lower


def nearest(lists: wrt.results.AllHits, kept: np.ndarray) -> np.ndarray:
    """(N,) t of the first hit of each ray that is kept; inf for none."""
    found = np.full(len(lists.offsets) - 1, np.inf, dtype=np.float32)
    np.minimum.at(found, lists.ray_id[kept], lists.t[kept])
    return found


@pytest.mark.parametrize(
    ("tree", "traversal"), [("bvh", "single"), ("bvh", "stream"), ("bvh", "packet"), ("kdtree", "single"), ("bvh", "brute")]
)
def test_without_triangles(tree, traversal, device):
    """Engines that look at triangles one by one, in lanes of rays and in lanes of triangles."""
    mesh, rng = degenerate_soup(), np.random.default_rng(3)
    ignored = rng.random(mesh.triangle_count) < 0.4
    ignored[[mesh.vertices[mesh.faces[:, 0]].argmin(axis=0), mesh.vertices[mesh.faces[:, 0]].argmax(axis=0)]] = False
    rays, kept = mixed_rays(mesh, 400, 5), np.flatnonzero(~ignored)
    scene = wrt.Scene(mesh, tree, device=device)
    filtered, without = (
        scene.filtered(ignore=ignored),
        wrt.Scene(wrt.TriangleMesh(mesh.vertices, mesh.faces[kept]), device=device),
    )
    hits, before = filtered.intersect(*rays, traversal=traversal), scene.intersect(*rays)
    assert ignored[before.primitive_id[before.is_hit]].sum() > 20
    if (without.bounds == scene.bounds).all():
        expected = without.intersect(*rays, traversal="brute")
        np.testing.assert_array_equal(hits.primitive_id, np.append(kept, -1)[expected.primitive_id])
        np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32))
    brute = filtered.intersect(*rays, traversal="brute")
    for name in ("t", "uv", "primitive_id"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(brute, name))
    np.testing.assert_array_equal(filtered.occluded(*rays, traversal=traversal), brute.is_hit)
    assert not scene.filtered(ignore=np.ones(len(ignored), bool)).occluded(*rays, traversal=traversal).any()


def test_lists_ends_and_float64(device):
    """`intersect_all`, `count`, t_min, t_max and back sides; `precise`; a pickle; a Warp array as mask."""
    ignored = np.random.default_rng(1).random(TEAPOT.triangle_count) < 0.5
    rays = mixed_rays(TEAPOT, 800, 7)
    scene = wrt.Scene(TEAPOT, device=device)
    filtered = scene.filtered(ignore=wp.array(ignored, dtype=wp.bool))
    every, left = scene.intersect_all(*rays), filtered.intersect_all(*rays)
    kept = ~ignored[every.primitive_id]
    np.testing.assert_array_equal(left.t, every.t[kept])
    np.testing.assert_array_equal(left.primitive_id, every.primitive_id[kept])
    np.testing.assert_array_equal(filtered.count(*rays), np.bincount(every.ray_id[kept], minlength=len(rays[0])))
    hits = filtered.intersect(*rays)
    precise, without = filtered.intersect(*rays, precise=True), np.flatnonzero(~ignored)
    remaining = wrt.Scene(wrt.TriangleMesh(TEAPOT.vertices, TEAPOT.faces[without]), device=device)
    expected = remaining.intersect(*rays, precise=True)
    np.testing.assert_array_equal(precise.t, expected.t)
    np.testing.assert_array_equal(precise.primitive_id, np.append(without, -1)[expected.primitive_id])
    points = np.random.default_rng(2).uniform(*TEAPOT.bounds, (300, 3))
    near, expected = filtered.closest_point(points), remaining.closest_point(points)
    np.testing.assert_array_equal(near.distance, expected.distance)
    np.testing.assert_array_equal(near.primitive_id, without[expected.primitive_id])
    assert len({scene_hash(one) for one in (scene, filtered, scene.filtered(ignore=~ignored), scene.filtered())}) == 3
    again = pickle.loads(pickle.dumps(filtered)).intersect(*rays)
    np.testing.assert_array_equal(again.primitive_id, hits.primitive_id)
    np.testing.assert_array_equal(filtered.filtered().intersect(*rays).primitive_id, scene.intersect(*rays).primitive_id)


def test_instances_and_updates(device):
    """Masks are those of meshes, in all instances; they stay when instances and vertices move."""
    ends = np.concatenate([np.eye(3), -np.eye(3)])
    ball = wrt.TriangleMesh(ends, [[a, b, c] for a in (0, 3) for b in (1, 4) for c in (2, 5)])
    matrix = np.eye(4)
    matrix[:3, 3] = 3, 0, 0
    scene = wrt.Scene([wrt.Instance(ball), wrt.Instance(ball, matrix), wrt.Instance(SQUARE, matrix)], device=device)
    lower = np.asarray(ball.vertices)[ball.faces].mean(axis=1)[:, 2] < 0
    filtered = scene.filtered(ignore={0: lower})
    from_below = [[0.05, 0.02, -5], [3.05, 0.02, -5]]
    assert (scene.count(from_below, UP) >= 2).all()
    np.testing.assert_array_equal(filtered.count(from_below, UP), scene.count(from_below, UP) - 1)
    matrix[:3, 3] = 0, 9, 0
    filtered.update(1, transform=matrix)
    assert filtered.count([0.05, 9.02, -5], UP) == 1
    assert scene.count([0.05, 9.02, -5], UP) == 0
    filtered.add(wrt.Instance(ball, np.diag([1.0, 1, -1, 1])))  # its upper half is the lower one of the mesh
    assert filtered.count([0.05, 0.02, -5], UP, t_max=4.9) == 1
    filtered.remove(3)
    filtered.update(0, vertices=2 * np.asarray(ball.vertices))
    assert filtered.count([0.05, 0.02, -5], UP) == 1
    single = wrt.Scene(ball, device=device).filtered(ignore=lower)
    single.update(0, vertices=np.asarray(ball.vertices) + 4 * UP)
    assert single.count([0.05, 0.02, -5], UP) == 1


@pytest.mark.parametrize("wrap", [("repeat", "mirror"), ("clamp", "repeat")])
def test_holes_of_images(wrap, device):
    """Against all hits, of which NumPy leaves those whose alpha is enough; coordinates reach beyond the image."""
    rng = np.random.default_rng(4)
    texture = wrt.Texture(rng.integers(0, 256, (11, 16, 4)).astype(np.uint8), wrap=wrap)
    leaves = wrt.Material(color_texture=texture, alpha_cutoff=0.45)
    of_face = np.arange(TEAPOT.triangle_count) % 2
    uv = (1.3 * np.asarray(TEAPOT.vertices)[:, :2]).astype(np.float32)
    scene = wrt.Scene(TEAPOT.with_materials([wrt.Material(), leaves], of_face=of_face, uv=uv), device=device)
    filtered = scene.filtered(alpha=True)
    rays = rng.uniform(*TEAPOT.bounds, (3000, 3)), rng.normal(size=(3000, 3)).astype(np.float32)
    every = scene.intersect_all(*rays)
    weights = np.concatenate([1 - every.uv.sum(axis=1, keepdims=True), every.uv], axis=1)
    alpha = alpha_of(texture, (weights[..., None] * uv[TEAPOT.faces[every.primitive_id]]).sum(axis=1))
    there = (of_face[every.primitive_id] == 0) | (alpha >= 255 * 0.45)
    clear = (
        np.bincount(every.ray_id, (of_face[every.primitive_id] == 1) & (np.abs(alpha - 255 * 0.45) < 0.01), len(rays[0])) == 0
    )
    assert clear.mean() > 0.99
    assert 0.1 < there.mean() < 0.95
    np.testing.assert_array_equal(filtered.count(*rays)[clear], np.bincount(every.ray_id[there], minlength=len(rays[0]))[clear])
    hits = filtered.intersect(*rays)
    np.testing.assert_array_equal(hits.t[clear], nearest(every, there)[clear])
    np.testing.assert_array_equal(filtered.occluded(*rays), hits.is_hit)
    assert hits.plan.traversal == "single"
    assert "alpha masks" in str(filtered.explain(*rays))
    left = filtered.intersect_all(*rays)
    np.testing.assert_array_equal(left.t[clear[left.ray_id]], every.t[there & clear[every.ray_id]])


def test_a_leaf_above_a_floor(device):
    """A hole in closed form; two leaves in one plane, of which the lower number is a hole; an instance; pictures."""
    across = np.linspace(0.013, 0.987, 41)
    x, y = np.meshgrid(across, across)
    origins = np.stack([x, y, np.ones_like(x)], axis=-1)
    radius = np.hypot(x - 0.5, y - 0.5)
    inside, sure = radius < 0.4, np.abs(radius - 0.4) > 1.5 / 64
    scene = wrt.Scene([leaf(), FLOOR], device=device).filtered(alpha=True)
    expected = np.where(inside, 1.0, 2.0)
    np.testing.assert_array_equal(scene.intersect(origins, DOWN).t[sure], expected[sure])
    np.testing.assert_array_equal(scene.count(origins, DOWN)[sure], np.where(inside, 2, 1)[sure])
    pairs = scene.visible(origins, origins - [0, 0, 1.5])
    np.testing.assert_array_equal(pairs[sure], ~inside[sure])
    assert not scene.occluded(origins[0, 0], [np.nan, 0, -1])
    assert (scene.intersect(origins, DOWN, t_min=1.5).t == 2.0).all()
    assert not scene.occluded(origins, DOWN, t_max=1.5, cull_backfaces=True)[sure & ~inside].any()
    coplanar = wrt.Scene([leaf(), leaf(0.6)], device=device).filtered(alpha=True)
    ids = coplanar.intersect(origins, DOWN).geometry_id
    assert (ids[sure & inside] == 0).all()
    assert (ids[sure & ~inside & (radius < 0.55)] == 1).all()
    place = np.diag([1.0, 1.0, -1.0, 1.0])  # mirrored
    placed = [wrt.Instance(FLOOR), wrt.Instance(FLOOR), wrt.Instance(leaf(), place), wrt.Instance(FLOOR)]
    mirrored = wrt.Scene(placed, device=device).filtered(alpha=True)
    np.testing.assert_array_equal(mirrored.intersect(origins, DOWN).instance_id[sure], np.where(inside, 2, 0)[sure])


@wp.func
def is_kept(scene: Any, hit: wrt.device.Hit, ignored: wp.array(dtype=wp.bool)):
    return not ignored[hit.primitive_id]


@wp.func
def is_even(scene: Any, hit: wrt.device.Hit, divisor: int):
    return hit.primitive_id % divisor == 0


kept_hit, even_hit = wrt.device.hit_where(is_kept), wrt.device.hit_where(is_even)


@wrt.device.kernel
def ask_filters(
    first: int,
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    ignored: wp.array(dtype=wp.bool),
    found: wp.array(dtype=float),
    even: wp.array(dtype=float),
):
    """Item: a ray. Two functions decide."""
    i = first + wp.tid()
    found[i] = kept_hit(scene, origins[i], directions[i], 0.1, wp.inf, ignored).t
    even[i] = even_hit(scene, origins[i], directions[i], 0.1, wp.inf, 2).t


def test_functions_in_kernels(device):
    """Of all hits, the first that is accepted; the handle of a filtered scene knows its triangles."""
    scene, (origins, directions) = wrt.Scene(TEAPOT, device=device), mixed_rays(TEAPOT, 500, 3)
    ignored = np.random.default_rng(8).random(TEAPOT.triangle_count) < 0.5
    rays = [wp.array(np.asarray(a, np.float32), dtype=wp.vec3, device=device) for a in (origins, directions)]
    every = scene.intersect_all(*rays, t_min=0.1)
    ids, ray, t = (values.numpy() for values in (every.primitive_id, every.ray_id, every.t))
    mask = wp.array(ignored, dtype=wp.bool, device=device)
    for handle, kept in ((scene.handle(), ids >= 0), (scene.filtered(ignore=ignored).handle(), ~ignored[ids])):
        found, even = wp.zeros(500, dtype=float, device=device), wp.zeros(500, dtype=float, device=device)
        wrt.device.launch(ask_filters, 500, [handle, *rays, mask, found, even], device=device)
        for values, accepted in ((found, ~ignored[ids]), (even, ids % 2 == 0)):
            expected = np.full(500, np.inf, dtype=np.float32)
            np.minimum.at(expected, ray[kept & accepted], t[kept & accepted])
            np.testing.assert_array_equal(values.numpy(), expected)
    with pytest.raises(TypeError, match=r"accept must be a wp\.func of \(scene, hit, data\), not function"):
        wrt.device.hit_where(lambda scene, hit, data: True)
    with pytest.raises(TypeError, match="and takes a, b"):
        wrt.device.hit_where(wp.func(two_arguments))


def two_arguments(a: int, b: int):
    return a == b


def test_pictures(device):
    """Paths pass through the holes of a leaf above a red floor, lit from a sky; the key of the samples tells filters apart."""
    ground = wrt.TriangleMesh(np.asarray(FLOOR.vertices) * [9, 9, 1] - [4, 4, 0], FLOOR.faces)
    ground = ground.with_materials(wrt.Material(color=(0.9, 0.1, 0.1)))
    scene = wrt.Scene([leaf(), ground], device=device)
    camera = wrt.PinholeCamera(24, 24, position=(0.5, 0.5, 1.0), look_at=(0.5, 0.5, 0.0), up=(0, 1, 0), fov=53.0)
    options = {"integrator": "path", "samples": 2, "lights": [wrt.lights.Sky.gradient(0.4, 0.8)]}
    pictures = [wrt.pictures.Rendering(each, camera, **options).advance() for each in (scene, scene.filtered(alpha=True))]
    whole, holes = (picture.linear for picture in pictures)
    corners = np.ix_([1, 2, -2, -3], [1, 2, -2, -3])
    np.testing.assert_allclose(whole[corners][..., 0], whole[corners][..., 1], rtol=1e-5)
    assert (holes[corners][..., 0] > 3 * holes[corners][..., 1]).all()
    np.testing.assert_allclose(holes[12, 12], whole[12, 12], rtol=1e-5)
    assert len({pictures[0].key, pictures[1].key, wrt.pictures.Rendering(scene.filtered(), camera, **options).key}) == 2


def gltf_card(path, sampler, material):
    """A unit square in a file, with an image of 4 x 4 texels three times across it and two times along it, moved by a texel."""
    alpha = np.random.default_rng(2).permutation(16).reshape(4, 4) >= 6
    image = np.full((4, 4, 4), 255, dtype=np.uint8)
    image[..., 3] = np.where(alpha, 200, 0)
    png = io.BytesIO()
    Image.fromarray(image).save(png, "PNG")
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    data = corners.tobytes() + corners[:, :2].tobytes() + np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16).tobytes()
    views = [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in ((0, 48), (48, 32), (80, 12))]
    kinds = [(5126, 4, "VEC3"), (5126, 4, "VEC2"), (5123, 6, "SCALAR")]
    moved = {"KHR_texture_transform": {"offset": [0.25, 0.0], "scale": [3, 2]}}
    model = {"baseColorTexture": {"index": 0, "extensions": moved}} | material.pop("model", {})
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": model} | material],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [sampler],
        "images": [{"uri": "data:image/png;base64," + base64.b64encode(png.getvalue()).decode()}],
        "accessors": [
            {"bufferView": view, "componentType": kind, "count": count, "type": form}
            for view, (kind, count, form) in enumerate(kinds)
        ],
        "bufferViews": views,
        "buffers": [{"uri": uri, "byteLength": len(data)}],
    }
    path.write_text(json.dumps(document))
    return wrt.Scene(wrt.TriangleMesh.load(path), device="cpu"), alpha


GLTF_WRAPS = {10497: lambda i: i % 4, 33071: lambda i: np.clip(i, 0, 3), 33648: lambda i: np.minimum(i % 8, 7 - i % 8)}
"""Texels of 4, beyond the edges of an image, by glTF's numbers."""


@pytest.mark.parametrize(("across", "along"), [(10497, 33648), (33648, 33071), (33071, 10497)])
def test_masks_of_gltf(tmp_path, across, along):
    """From a file to rays: holes are where its image, its sampler and KHR_texture_transform put them."""
    mask = {"alphaMode": "MASK", "model": {"baseColorFactor": [1, 1, 1, 0.9]}}
    scene, alpha = gltf_card(tmp_path / "a.gltf", {"wrapS": across, "wrapT": along}, mask)
    column, row = np.meshgrid(np.arange(12), np.arange(8))
    places = np.stack([(column + 0.5) / 12, (row + 0.5) / 8, np.ones_like(row)], axis=-1)  # centres of texels
    there = alpha[GLTF_WRAPS[along](row), GLTF_WRAPS[across](column + 1)]
    assert 0.2 < there.mean() < 0.9
    hits = scene.filtered(alpha=True).intersect(places, DOWN)
    np.testing.assert_array_equal(hits.is_hit, there)
    assert hits.plan.traversal == "single"
    assert scene.intersect(places, DOWN).is_hit.all()  # without alpha=True, nothing has holes


@pytest.mark.parametrize(
    ("material", "share"),
    [
        ({}, 1.0),
        ({"alphaMode": "OPAQUE"}, 1.0),
        ({"alphaMode": "BLEND"}, 1.0),
        ({"alphaMode": "MASK"}, 0.625),
        ({"alphaMode": "MASK", "alphaCutoff": 0.8}, 0.0),  # above 200 of 255
        ({"alphaMode": "MASK", "alphaCutoff": 0.0}, 1.0),
        ({"alphaMode": "MASK", "model": {"baseColorFactor": [1, 1, 1, 0.4]}}, 0.0),
    ],
)
def test_alpha_modes_of_gltf(tmp_path, material, share):
    """Rays hit what is OPAQUE, and all of what is blended, whatever its alpha; a cutoff makes a mask of that."""
    scene, _ = gltf_card(tmp_path / "a.gltf", {}, dict(material))
    column, row = np.meshgrid(np.arange(12), np.arange(8))
    places = np.stack([(column + 0.5) / 12, (row + 0.5) / 8, np.ones_like(row)], axis=-1)
    assert scene.filtered(alpha=True).occluded(places, DOWN).mean() == share
    if material == {"alphaMode": "BLEND"}:
        (mesh,) = scene.meshes
        cut = dataclasses.replace(mesh.materials.materials[0], alpha_cutoff=0.5)
        mesh = mesh.with_materials(cut, uv=mesh.materials.corner_uv)
        assert wrt.Scene(mesh, device="cpu").filtered(alpha=True).occluded(places, DOWN).mean() == 0.625


def test_cutoffs():
    assert cutoff_of_image(0.5, 1.0) == 0.5
    assert cutoff_of_image(0.5, 0.8) == 0.625
    assert cutoff_of_image(0.5, 0.25) > 1.0
    assert cutoff_of_image(0.0, 0.0) == 0.0


def test_bad_filters():
    scene, two = wrt.Scene(SQUARE), wrt.Scene([SQUARE, FLOOR])
    with pytest.raises(TypeError, match=r"ignore must hold bools, one a triangle, not int64; of ids make np\.isin"):
        scene.filtered(ignore=[0, 1])
    with pytest.raises(ValueError, match=r"ignore has shape \(3,\), and mesh 0 has 2 triangles; it must be \(2,\)"):
        scene.filtered(ignore=np.zeros(3, bool))
    with pytest.raises(ValueError, match="ignore is one array, and the scene has 2 meshes; pass a mapping"):
        two.filtered(ignore=np.zeros(4, bool))
    with pytest.raises(ValueError, match="a key of ignore"):
        two.filtered(ignore={2: np.zeros(2, bool)})
    with pytest.raises(TypeError, match="alpha"):
        scene.filtered(alpha="yes")
    with pytest.raises(ValueError, match=r"alpha_cutoff is -0\.5; it must be 0 or more"):
        wrt.Material(alpha_cutoff=-0.5)
    with pytest.raises(ValueError, match=r"filters need a scene with one tree, or one of instances; make wrt\.Scene"):
        wrt.moving.FuzzyScene(np.asarray(SQUARE.vertices)[None], SQUARE.faces).filtered(alpha=True)
    chosen = scene.filtered(ignore=[True, False])
    for call in (chosen.contains, lambda points: wrt.analysis.signed_distance(chosen, points)):
        with pytest.raises(
            ValueError, match=r"needs all triangles, and rays of this scene pass through some; use scene\.filtered\(\)"
        ):
            call([[0.0, 0, 0]])
    masked = wrt.Scene(leaf()).filtered(alpha=True)
    with pytest.raises(
        ValueError, match=r"'packet' does not answer the query 'closest' by alpha masks; choose from auto, single"
    ):
        masked.intersect([0.0, 0, 1], DOWN, traversal="packet")
    for options in ({"skip": [0]}, {"precise": True}):
        with pytest.raises(ValueError, match="does not look at alpha masks"):
            masked.intersect([[0.0, 0, 1]], DOWN, **options)
    with pytest.raises(ValueError, match="a handle does not look at alpha masks"):
        masked.handle()
    with pytest.raises(ValueError, match="a query of points does not look at alpha masks"):
        masked.closest_point([[0.0, 0, 0]])


def test_cuda(tmp_path, monkeypatch):
    monkeypatch.setattr(wp.config, "optimization_level", 1)  # what is asked is whether it compiles
    config = TraversalConfig("woop", 2, variant=MASKED)
    assert ".entry" in compile_to_ptx(TRAVERSALS["single"].kernels["bvh"](config).module, tmp_path)


@pytest.mark.parametrize("alphas", [(0.4, 0.4), (0.6, 0.6), (0.4, 0.6)])
def test_masks_and_alpha_of_vertices(tmp_path, alphas):
    """The product with the material's alpha, 0.9, is cut at 0.5; alpha that differs from corner to corner is a warning."""
    writer, corners = GltfWriter(), np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    colors = np.float32([[1.0, 0.5, 0.5, alphas[0]], [1.0, 0.5, 0.5, alphas[1]], [1.0, 0.5, 0.5, alphas[1]]])
    primitive = writer.primitive(corners, [[0, 1, 2]], attributes={"COLOR_0": writer.accessor(colors, "VEC4")}, material=0)
    mask = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.9]}}
    (tmp_path / "a.glb").write_bytes(writer.glb(primitive, materials=[mask]))
    if alphas[0] == alphas[1]:
        mesh = wrt.TriangleMesh.load(tmp_path / "a.glb")
    else:
        with pytest.warns(UserWarning, match=r"COLOR_0 of .* has alpha from 0.4 to 0.6"):
            mesh = wrt.TriangleMesh.load(tmp_path / "a.glb")
    scene = wrt.Scene(mesh, device="cpu")
    assert scene.intersect([0.2, 0.2, 1.0], DOWN).is_hit
    assert scene.filtered(alpha=True).intersect([0.2, 0.2, 1.0], DOWN).is_hit == (alphas != (0.4, 0.4))
