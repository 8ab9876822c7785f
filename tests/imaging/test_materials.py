"""Materials of meshes: assigned, kept by what makes new meshes, read by trimesh, and looked up at hits."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import trimesh
from PIL import Image

import wrt
from wrt.kernels.images import image_footprint
from wrt.materials.material import WRAPS
from wrt.scenes.shapes import boxes, plane

RED, BLUE = wrt.Material(color=(0.9, 0.1, 0.1)), wrt.Material("glossy", color=(0.1, 0.1, 0.9), roughness=0.3)


def albedo(scene, size=4.0, pixels=32, **options):
    """Colours seen from straight above, (pixels, pixels, 3); row 0 is at the largest y."""
    camera = wrt.OrthographicCamera(pixels, pixels, view_height=size, position=(0, 0, 9), look_at=(0, 0, 0), up=(0, 1, 0))
    return wrt.pictures.Rendering(scene, camera, integrator="path", samples=1, **options).advance().layers["albedo"]


def checked():
    """A quad of two materials, with coordinates and colours."""
    quad = plane((-1, -1), (1, 1))
    uv = (quad.vertices[:, :2] + 1) / 2
    return quad.with_materials([RED, BLUE], [0, 1], uv=uv, colors=np.linspace(0, 1, 12).reshape(4, 3))


def test_each_triangle_has_its_material():
    found = albedo(wrt.Scene(plane((-1, -1), (1, 1)).with_materials([RED, BLUE], [0, 1])), 2.0)
    assert np.allclose(found[30, 1], found[1, 1]) != np.allclose(found[30, 1], found[30, 30])
    colors = {tuple(np.round(c, 3).tolist()) for c in found.reshape(-1, 3)}
    assert colors == {(0.9, 0.1, 0.1), (0.1, 0.1, 0.9)} or len(colors) == 2


def test_new_meshes_keep_materials():
    mesh = checked()
    assert pickle.loads(pickle.dumps(mesh)).materials.materials == (RED, BLUE)
    for kept in (mesh.welded(), mesh.transformed(np.eye(4)), copy.copy(mesh)):
        np.testing.assert_array_equal(kept.materials.corner_uv, mesh.materials.corner_uv)
        np.testing.assert_array_equal(kept.materials.of_face, [0, 1])
    mirrored = mesh.transformed(np.diag([-1.0, 1, 1, 1]))
    np.testing.assert_array_equal(mirrored.materials.corner_uv, mesh.materials.corner_uv[:, [0, 2, 1]])
    corners = mirrored.vertices[mirrored.faces] * (-1, 1, 1)
    np.testing.assert_allclose((corners[..., :2] + 1) / 2, mirrored.materials.corner_uv, atol=1e-6)
    joined = wrt.TriangleMesh.concatenate([boxes((0, 0, 0), (1, 1, 1)), mesh, mesh])
    assert joined.materials.materials == (wrt.Material(), RED, BLUE)
    assert joined.materials.of_face.tolist() == [0] * 12 + [1, 2] * 2
    assert (joined.materials.corner_color[:12] == 1.0).all()
    assert (joined.materials.corner_uv[:12] == 0.0).all()
    assert boxes((0, 0, 0), (1, 1, 1)).materials is None
    scene = wrt.Scene(mesh)
    scene.update(0, vertices=mesh.vertices + 0.25)
    assert scene.meshes[0].materials is mesh.materials


def test_vertex_colours_are_interpolated():
    quad = plane((-2, -2), (2, 2))
    colors = np.clip((quad.vertices + 2) / 4, 0, 1)
    found = albedo(wrt.Scene(quad.with_materials(wrt.Material(color=1.0), colors=colors)))
    x = (np.arange(32) + 0.5) / 32
    np.testing.assert_allclose(found[..., 0], np.tile(x, (32, 1)), atol=1e-5)
    np.testing.assert_allclose(found[..., 1], np.tile(x[::-1, None], (1, 32)), atol=1e-5)


@pytest.mark.parametrize("repeat", [1.0, 2.5])
def test_textures_are_interpolated_and_repeat(repeat):
    """Bilinear interpolation of linear values between the centres of texels; v grows upward, row 0 of the image is at v = 1."""
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    quad = plane((-2, -2), (2, 2))
    uv = repeat * (quad.vertices[:, :2] + 2) / 4 - 0.3
    found = albedo(wrt.Scene(quad.with_materials(wrt.Material(color=0.5, color_texture=wrt.Texture(pixels)), uv=uv)))
    level = pixels / 255.0
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    at = repeat * (np.arange(32) + 0.5) / 32 - 0.3
    x, y = at * 7 - 0.5, (1 - at[::-1]) * 5 - 0.5
    c, r = np.floor(x).astype(int), np.floor(y).astype(int)
    f, g = (x - c)[None, :, None], (y - r)[:, None, None]
    row = [linear[np.ix_((r + i) % 5, (c + j) % 7)] for i in (0, 1) for j in (0, 1)]
    expected = (1 - g) * ((1 - f) * row[0] + f * row[1]) + g * ((1 - f) * row[2] + f * row[3])
    np.testing.assert_allclose(found, 0.5 * expected, atol=2e-4)


@pytest.mark.parametrize("memory", [None, 1 << 18])
def test_textures_that_do_not_repeat(memory):
    """Clamped in u, mirrored in v: images always repeated, whatever a file said. Whole, and tile by tile."""
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (70, 130, 3), dtype=np.uint8) // 64 * 64
    texture = wrt.Texture(pixels, wrap=("clamp", "mirror"))
    quad = plane((-2, -2), (2, 2))
    mesh = quad.with_materials(wrt.Material(color=0.5, color_texture=texture), uv=3.0 * (quad.vertices[:, :2] + 2) / 4 - 1.0)
    found = albedo(wrt.Scene(mesh), texture_memory=memory)
    level = pixels / 255.0
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    at = 3.0 * (np.arange(32) + 0.5) / 32 - 1.0
    x, y = at * 130 - 0.5, (1 - at[::-1]) * 70 - 0.5
    c, r = np.floor(x).astype(int), np.floor(y).astype(int)
    f, g = (x - c)[None, :, None], (y - r)[:, None, None]
    columns = [np.clip(c + j, 0, 129) for j in (0, 1)]
    mirrored = np.concatenate([np.arange(70), np.arange(69, -1, -1)])
    rows = [mirrored[(r + i) % 140] for i in (0, 1)]
    corner = [linear[np.ix_(rows[i], columns[j])] for i in (0, 1) for j in (0, 1)]
    expected = (1 - g) * ((1 - f) * corner[0] + f * corner[1]) + g * ((1 - f) * corner[2] + f * corner[3])
    np.testing.assert_allclose(found, 0.5 * expected, atol=2e-3)


def test_coordinates_beyond_an_image():
    """What the kernels' functions make of them, called from Python: nothing is compiled."""
    coordinates = [-1.25, -0.25, 0.0, 0.25, 1.0, 1.25, 2.75]
    expected = {
        "repeat": [0.75, 0.75, 0.0, 0.25, 0.0, 0.25, 0.75],
        "clamp": [0.0, 0.0, 0.0, 0.25, 1.0, 1.0, 1.0],
        "mirror": [0.75, 0.25, 0.0, 0.25, 1.0, 0.75, 0.75],
    }
    for number, wrap in enumerate(WRAPS):
        found = [image_footprint.folded.func(coordinate, number) for coordinate in coordinates]
        assert found == pytest.approx(expected[wrap]), wrap


@pytest.mark.parametrize("wrap", ["tile", ("repeat",), ("clamp", 1), 3, None])
def test_unknown_wraps_are_refused(wrap):
    with pytest.raises(ValueError, match="wrap must be one of 'repeat', 'clamp', 'mirror'"):
        wrt.Texture(np.zeros((2, 2)), wrap=wrap)


def test_materials_of_a_gltf_file(tmp_path):
    """Base colour, image, roughness, metallic share and emission; each node's mesh in its place."""
    image = Image.fromarray(np.uint8([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]]))
    quad = plane((-1, -1), (1, 1))
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 128, 255, 255],
        baseColorTexture=image,
        roughnessFactor=0.25,
        metallicFactor=0.5,
        alphaMode="MASK",
        alphaCutoff=0.4,
    )
    visual = trimesh.visual.TextureVisuals(uv=(quad.vertices[:, :2] + 1) / 2, material=material)
    textured = trimesh.Trimesh(quad.vertices, quad.faces, visual=visual, process=False)
    glow = trimesh.visual.material.PBRMaterial(emissiveFactor=[1.0, 0.5, 0.0], metallicFactor=0.0, roughnessFactor=1.0)
    lamp = trimesh.creation.box((0.2, 0.2, 0.2))
    lamp.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(lamp.vertices), 2)), material=glow)
    graph = trimesh.Scene()
    graph.add_geometry(textured)
    graph.add_geometry(lamp, transform=trimesh.transformations.translation_matrix((0, 0, 3)))
    graph.export(tmp_path / "model.glb")
    mesh = wrt.TriangleMesh.load(tmp_path / "model.glb")
    kinds = {one.emits: one for one in mesh.materials.materials}
    assert kinds[False].roughness == pytest.approx(0.25)
    assert kinds[False].metallic == pytest.approx(0.5)
    assert kinds[False].color == pytest.approx((1.0, 128 / 255, 1.0), abs=0.01)
    assert kinds[False].color_texture.pixels.shape == (2, 2, 3)
    assert kinds[True].emission == pytest.approx((1.0, 0.5, 0.0))
    found = albedo(wrt.Scene(mesh), 2.0, 2)  # at the centres of the texels
    np.testing.assert_allclose(found[0], [(1.0, 0.0, 0.0), (0.0, 128 / 255, 0.0)], atol=0.01)
    np.testing.assert_allclose(found[1, 0], (0.0, 0.0, 1.0), atol=0.01)
    assert wrt.TriangleMesh.load(tmp_path / "model.glb", materials=False).materials is None
    parts = wrt.Scene(trimesh.load(tmp_path / "model.glb"))  # each node an instance
    for meshes in ([mesh], parts.meshes):
        assert 0.4 in [one.alpha_cutoff for each in meshes for one in each.materials.materials]
    np.testing.assert_allclose(albedo(parts, 2.0, 2), found, atol=1e-5)


def test_materials_of_an_obj_file_on_request(tmp_path):
    quad = plane((-1, -1), (1, 1))
    Image.fromarray(np.full((2, 2, 3), (0, 255, 0), np.uint8)).save(tmp_path / "green.png")
    visual = trimesh.visual.TextureVisuals(uv=(quad.vertices[:, :2] + 1) / 2, image=Image.open(tmp_path / "green.png"))
    trimesh.Trimesh(quad.vertices, quad.faces, visual=visual, process=False).export(tmp_path / "model.obj")
    assert wrt.TriangleMesh.load(tmp_path / "model.obj").materials is None
    mesh = wrt.TriangleMesh.load(tmp_path / "model.obj", materials=True)
    np.testing.assert_allclose(albedo(wrt.Scene(mesh), 2.0)[9, 9], (0, 1, 0), atol=0.01)


def test_colours_of_a_ply_file(tmp_path):
    quad = plane((-1, -1), (1, 1))
    colors = np.uint8([[255, 0, 0, 255]] * 4)
    trimesh.Trimesh(quad.vertices, quad.faces, vertex_colors=colors, process=False).export(tmp_path / "model.ply")
    found = albedo(wrt.Scene(wrt.TriangleMesh.load(tmp_path / "model.ply")), 2.0)
    np.testing.assert_allclose(found[9, 9], (1, 0, 0), atol=1e-5)


def test_coordinates_of_trimesh_that_are_nan_are_named():
    quad = plane((-1, -1), (1, 1))
    visual = trimesh.visual.TextureVisuals(uv=np.full((4, 2), np.nan), image=Image.new("RGB", (2, 2)))
    with pytest.warns(UserWarning, match="coordinates and images are left out"):
        mesh = wrt.TriangleMesh.from_trimesh(trimesh.Trimesh(quad.vertices, quad.faces, visual=visual, process=False))
    assert mesh.materials.materials[0].color_texture is None


def test_bad_materials():
    quad = plane((-1, -1), (1, 1))
    for options, match in (
        ({"of_face": [0, 2]}, "from 0 to 1"),
        ({"of_face": [0]}, "of_face"),
        ({"uv": np.zeros((3, 2))}, "uv must have shape"),
        ({"colors": np.full((4, 3), np.nan)}, "finite"),
    ):
        with pytest.raises(ValueError, match=match):
            quad.with_materials([RED, BLUE], **options)
    with pytest.raises(TypeError, match="materials must be"):
        quad.with_materials([])
