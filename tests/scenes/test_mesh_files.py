"""Files that are valid and that readers get wrong, with what is in them; files that are refused, with the true reason."""

from __future__ import annotations

import json
import os
import warnings
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from support.hostile_files import FILES, POSITION, SIDES, obj, off, ply, stl, stl_text
from support.hostile_gltf import GLTF_FILES
from support.hostile_shapes import ANGLE, CORNERS, CUBE, MIXED, TRIANGLES
from support.written_gltf import GltfWriter

import wrt
from wrt import TriangleMesh
from wrt.meshes.instance import as_instances

ALL = [*FILES, *GLTF_FILES]


def volume(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("file", ALL, ids=lambda file: file.name)
def test_what_is_in_the_file(tmp_path, file):
    path = tmp_path / file.name
    file.write(path)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mesh = TriangleMesh.load(path)
    assert mesh.triangle_count == file.triangles
    assert volume(mesh) == pytest.approx(file.volume, rel=1e-6, abs=1e-9)
    if file.area is not None:
        assert mesh.surface_area == pytest.approx(file.area, rel=1e-6)
    if file.bounds is not None:
        np.testing.assert_allclose(mesh.bounds, file.bounds, atol=1e-5)
    assert len(told) == (file.warns is not None), [str(one.message) for one in told]
    assert file.warns is None or file.warns in str(told[0].message)


def test_there_are_many_of_them():
    assert len(ALL) >= 60
    assert len({file.name for file in ALL}) == len(ALL)


@pytest.mark.parametrize("suffix", ["ply", "obj", "off"])
def test_triangles_are_in_the_order_of_the_faces(tmp_path, suffix):
    """Labels of faces belong to triangles; trimesh put all triangles before all quads."""
    path = tmp_path / f"mixed.{suffix}"
    path.write_bytes({"ply": ply, "obj": lambda s: obj(s).encode(), "off": lambda s: off(s).encode()}[suffix](MIXED))
    expected = [t for one in MIXED.polygons for t in [(one[0], b, c) for b, c in pairwise(one[1:])]]
    np.testing.assert_array_equal(TriangleMesh.load(path).faces, expected)


def broken_gltf(change):
    """The text of a glTF cube after a change."""
    g = GltfWriter()
    document = g.document(g.primitive(CORNERS, TRIANGLES))
    change(document)
    return json.dumps(document)


def set_to(*path_and_value):
    *path, last, value = path_and_value

    def change(document):
        for key in path:
            document = document[key]
        document[last] = value

    return change


SIGNED = ply(CUBE, "<", length="b", face="property list char int v\n")
ZEROS = {"count": 1 << 40, "type": "VEC3", "componentType": 5126, "sparse": {}}

REFUSED = {
    "cut_in_a_facet.stl": (stl(SIDES)[:-20], "announces 12 triangles, and it holds 11 and 30 bytes of another"),
    "cut_binary_facet.stl": (stl(SIDES, b"solid facet")[:-20], "announces 12 triangles, and it holds 11 and 30 bytes"),
    "cut_text.stl": (stl_text(SIDES)[:-60], "ends within a facet: 12 begin, and 11 are complete"),
    "four_corners.stl": (stl_text(SIDES).replace("    endloop", "vertex 1 1 1\nendloop", 1), "facet 0 has 4 corners"),
    "word.stl": (stl_text(SIDES).replace("vertex 1.0", "vertex one", 1), "'one', which is no number"),
    "cut.ply": (ply(MIXED, "<")[:-1], "ends before the last of 8 rows of the element 'face'"),
    "cut_text.ply": (ply(CUBE)[:-6], "ends before the last of 6 rows of the element 'face'"),
    "cloud.ply": (f"ply\nformat ascii 1.0\nelement vertex 1\n{POSITION}end_header\n0 0 0\n", "no triangles .* cloud of points"),
    "no_z.ply": (ply(CUBE).replace(b"float z", b"float w"), "properties x, y and z"),
    "outside.ply": (ply(MIXED, "<").replace(bytes([4, 4, 0, 0, 0]), bytes([4, 9, 0, 0, 0])), "vertex 9, .* 8 vertices"),
    "fraction.ply": (ply(CUBE).replace(b"4 0 1 3 2", b"4 0 1.5 3 2"), "holds 1.5, which is no index"),
    "form.ply": (ply(CUBE).replace(b"ascii", b"EBCDIC"), "'format EBCDIC'"),
    "negative_length.ply": (SIGNED.replace(b"\x04\0\0\0\0", b"\xff\0\0\0\0", 1),
                            "has the length -1"),
    "before_the_first.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n", "index -4 of a vertex, and 3 are before"),
    "zero.obj": (obj(CUBE, first=0), "index 0 of a vertex; those of OBJ files count from 1"),
    "word.obj": (obj(CUBE).replace("f 1", "f one"), "'one', which is no number"),
    "two_coordinates.obj": ("v 0 0\n" + obj(CUBE), "vertex 0 has 2 coordinates"),
    "curves.obj": ("v 0 0 0\ncstype bezier\ncurv 0 1 1\nend\n", "no triangles in it: it has no faces"),
    "four.off": (off(CUBE, "4OFF\n", " 1"), "four coordinates"),
    "binary.off": (off(CUBE, "OFF BINARY\n"), "binary numbers"),
    "short.off": (off(CUBE)[:-12], "face 5 announces 4 corners|8 vertices and 6 faces, and has 13 lines"),
    "no_word.off": ("8 6 0\n", "not with the word OFF"),
    "draco.gltf": (broken_gltf(set_to("extensionsRequired", ["KHR_draco_mesh_compression"])), "draco.* without Draco"),
    "unheard.gltf": (broken_gltf(set_to("extensionsRequired", ["EXT_unheard"])), "requires the extension EXT_unheard"),
    "old.gltf": (broken_gltf(set_to("asset", {"version": "1.0"})), "version '1.0'"),
    "no_data.gltf": (broken_gltf(lambda d: d["accessors"][0].pop("bufferView")), "has no data; an extension"),
    "circle.gltf": (broken_gltf(set_to("nodes", [{"mesh": 0, "children": [0]}])), "below itself"),
    "two_parents.gltf": (broken_gltf(set_to("nodes", [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}])), "two parents"),
    "index.gltf": (broken_gltf(set_to("accessors", 1, "byteOffset", 2)), "reaches out of its buffer view"),
    "not_affine.gltf": (broken_gltf(set_to("nodes", 0, "matrix", [1.0] * 16)), "not affine"),
    "no_mesh.gltf": (broken_gltf(set_to("nodes", [{}])), "no triangles in it: its default scene"),
    "structure.gltf": (broken_gltf(set_to("meshes", 0, "primitives", [3])), "structure is broken"),
    "large_zeros.gltf": (broken_gltf(set_to("accessors", 0, ZEROS)),
                         "rows without data"),
    "missing_buffer.gltf": (broken_gltf(set_to("buffers", 0, "uri", "none.bin")), "there is no file .*none.bin"),
    "web.gltf": (broken_gltf(set_to("buffers", 0, "uri", "https://localhost/a.bin")), "no path of a file"),
    "cut.glb": (GltfWriter().glb()[:-8], "bytes that its header announces"),
    "text.gltf": ("{", "JSON cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_files_are_refused_for_the_true_reason(tmp_path, name):
    content, reason = REFUSED[name]
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(ValueError, match=reason) as caught:
        TriangleMesh.load(tmp_path / name)
    assert name in str(caught.value)


def test_compressed_primitives_without_a_fallback_are_refused(tmp_path):
    """All vertices were 0: the accessor has no data but what a decoder would give it."""
    g = GltfWriter()
    primitive = g.primitive(CORNERS, TRIANGLES, extensions={"KHR_draco_mesh_compression": {"bufferView": 0}})
    del g.accessors[0]["bufferView"]
    g.save(tmp_path / "draco.gltf", primitive)
    with pytest.raises(ValueError, match="compressed by KHR_draco_mesh_compression, which is not supported"):
        TriangleMesh.load(tmp_path / "draco.gltf")


def test_concave_polygons_of_any_size():
    """A star of 4,000 corners is cut; one of more than 10,000 is refused before it takes minutes."""
    from wrt.meshes.files.triangulation import triangulate

    for count, fits in ((4000, True), (10_002, False)):
        angle = 2 * np.pi * np.arange(count) / count
        radius = np.where(np.arange(count) % 2, 1.0, 2.0)
        star = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
        if not fits:
            with pytest.raises(ValueError, match="10002 corners"):
                triangulate(star, np.arange(count), np.array([count]))
            continue
        places, _ = triangulate(star, np.arange(count), np.array([count]))
        a, b, c = np.moveaxis(star[places], 1, 0)
        areas = np.cross(b - a, c - a)[:, 2] / 2
        assert areas.min() > 0.0
        assert areas.sum() == pytest.approx(count * np.sin(2 * np.pi / count), rel=1e-9)


@pytest.mark.parametrize(
    ("first", "behind"), [("CNOFF", " 0 0 1 255 0 10"), ("NCOFF", " 255 0 10 255 0 0 1"), ("COFF", " 255 0 10")]
)
def test_colours_of_off_files_are_where_the_first_word_says(tmp_path, first, behind):
    (tmp_path / "cube.off").write_text(off(CUBE, f"{first}\n", behind))
    colors = TriangleMesh.load(tmp_path / "cube.off").materials.corner_color
    np.testing.assert_allclose(colors, np.broadcast_to([1.0, 0.0, 0.00303527], (12, 3, 3)), rtol=1e-5)


def test_faces_of_two_corners_are_left_out_with_a_warning(tmp_path):
    (tmp_path / "edges.obj").write_text(obj(CUBE) + "f 1 2\n")
    with pytest.warns(UserWarning, match="1 faces of fewer than three corners"):
        assert TriangleMesh.load(tmp_path / "edges.obj").triangle_count == 12


# -- what a file may refer to ------------------------------------------------------------------------------------------


def textured(folder, uri, **material):
    """A glTF square with an image."""
    g = GltfWriter()
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    uv = g.accessor(np.array([[0, 2], [1, 2], [1, -1], [0, -1]], "f4"), "VEC2")
    primitive = g.primitive(points, [0, 1, 2, 0, 2, 3], attributes={"TEXCOORD_0": uv}, material=0)
    made = {"name": "wood", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}} | material
    g.save(folder / "square.gltf", primitive, materials=[made], textures=[{"source": 0}], images=[{"uri": uri}])
    return folder / "square.gltf"


def write_image(path, size=(2, 2), color=(255, 0, 0)):
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", size, color).save(path)


def test_references_stay_below_the_folder(tmp_path):
    """A file from a stranger read any file of the user's as an image or a buffer; so did symbolic links."""
    folder = tmp_path / "model"
    folder.mkdir()
    write_image(tmp_path / "secret" / "a.png")
    write_image(folder / "images" / "b.png")
    for uri in ("images/b.png", "images%2Fb.png", "images\\b.png", "../model/images/b.png"):
        assert TriangleMesh.load(textured(folder, uri)).materials.materials[0].color_texture is not None
    os.symlink(tmp_path / "secret", folder / "link")
    for uri in ("../secret/a.png", str(tmp_path / "secret" / "a.png"), "link/a.png", "images/../../secret/a.png"):
        path = textured(folder, uri)
        with pytest.raises(ValueError, match=r"outside of the mesh's folder.* pass outside=True"):
            TriangleMesh.load(path)
        assert TriangleMesh.load(path, materials=False).triangle_count == 2
        assert TriangleMesh.load(path, outside=True).materials.materials[0].color_texture is not None
    (folder / "lib.obj").write_text("mtllib ../secret/a.mtl\nusemtl a\n" + obj(CUBE))
    with pytest.raises(ValueError, match=r"a material library is '../secret/a\.mtl', outside"):
        TriangleMesh.load(folder / "lib.obj", materials=True)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_pipes_are_refused(tmp_path):
    """Opening a pipe that nobody writes to waited for ever."""
    os.mkfifo(tmp_path / "pipe.png")
    os.mkfifo(tmp_path / "pipe.ply")
    os.mkfifo(tmp_path / "pipe.3mf")
    for name in ("pipe.ply", "pipe.3mf"):
        with pytest.raises(ValueError, match=r"is a pipe"):
            TriangleMesh.load(tmp_path / name)
    with pytest.raises(ValueError, match=r"the image of material 'wood'\) is a pipe"):
        TriangleMesh.load(textured(tmp_path, "pipe.png"))


def test_large_images_are_refused_before_they_are_decoded(tmp_path, monkeypatch):
    """A PNG of 13,000 x 13,000 pixels has 600 KB and takes a gigabyte."""
    from wrt.meshes.files import file_images

    assert 8192**2 <= file_images.MAX_PIXELS < 13_000**2
    monkeypatch.setattr(file_images, "MAX_PIXELS", 100)
    write_image(tmp_path / "fits.png", (10, 10))
    write_image(tmp_path / "large.png", (10, 11))
    assert TriangleMesh.load(textured(tmp_path, "fits.png")).materials.materials[0].color_texture is not None
    with pytest.raises(ValueError, match=r"'large.png' of material 'wood' has 10 x 11 pixels.*materials=False"):
        TriangleMesh.load(textured(tmp_path, "large.png"))


def test_images_that_pillow_takes_for_bombs_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 4)
    write_image(tmp_path / "large.png", (10, 11))
    with pytest.raises(ValueError, match="has more pixels than can be read"):
        TriangleMesh.load(textured(tmp_path, "large.png"))


# -- looks that are left out -------------------------------------------------------------------------------------------


def test_missing_and_broken_images_are_named(tmp_path):
    """Surfaces became plain without a word."""
    with pytest.warns(UserWarning, match=r"square.gltf': there is no file 'none.png', the image of material 'wood'"):
        mesh = TriangleMesh.load(textured(tmp_path, "none.png"))
    assert mesh.materials.materials[0].color_texture is None
    (tmp_path / "broken.png").write_bytes(b"\x89PNG no more")
    with pytest.warns(UserWarning, match=r"the image 'broken.png' of material 'wood' cannot be read"):
        TriangleMesh.load(textured(tmp_path, "broken.png"))
    (tmp_path / "paint.mtl").write_text("newmtl red\nKd nan 0 0\nmap_Kd -clamp on gone.png\n")
    coordinates = obj(CUBE, "{}/1").replace("v ", "vt 0 0\nv ", 1)
    (tmp_path / "paint.obj").write_text("mtllib paint.mtl other.mtl\nusemtl red\n" + coordinates + "usemtl blue\nf 1 2 3\n")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mesh = TriangleMesh.load(tmp_path / "paint.obj", materials=True)
    said = " ".join(str(one.message) for one in told)
    for part in (
        "'other.mtl', a material library",
        "colour of the material 'red' is 'nan 0 0'",
        "'gone.png'",
        "material 'blue' is not",
    ):
        assert part in said
    assert len(told) == 4
    assert mesh.materials.of_face.tolist() == [0] * 12 + [1]


def test_images_that_nothing_places_are_named(tmp_path):
    """Surfaces became plain without a word."""
    write_image(tmp_path / "wood.png")
    (tmp_path / "cube.ply").write_bytes(ply(CUBE, head="comment TextureFile wood.png\n"))
    with pytest.warns(UserWarning, match=r"no texture coordinates to place the image 'wood.png'"):
        assert TriangleMesh.load(tmp_path / "cube.ply").materials is None
    (tmp_path / "wood.mtl").write_text("newmtl wood\nmap_Kd wood.png\n")
    (tmp_path / "cube.obj").write_text("mtllib wood.mtl\nusemtl wood\n" + obj(CUBE))
    with pytest.warns(UserWarning, match=r"the material 'wood' has an image, and the mesh has no texture coordinates"):
        assert TriangleMesh.load(tmp_path / "cube.obj", materials=True).materials.materials[0].color_texture is None


def test_colours_and_coordinates_that_are_nan_are_named(tmp_path):
    vertex = POSITION + "property float red\nproperty float green\nproperty float blue\n"
    text = ply(CUBE, vertex=vertex).decode()
    head, body = text.split("end_header\n")
    rows = body.splitlines()
    rows[:8] = [row + (" nan 0 0" if k == 3 else " 0.5 0.25 1") for k, row in enumerate(rows[:8])]
    (tmp_path / "colours.ply").write_text(head + "end_header\n" + "\n".join(rows))
    with pytest.warns(UserWarning, match="1 of 8 colours of the element 'vertex' are NaN or infinite; they are white"):
        colors = TriangleMesh.load(tmp_path / "colours.ply").materials.corner_color
    assert np.isfinite(colors).all()
    with pytest.warns(UserWarning, match="baseColorFactor of material 'wood' is"):
        mesh = TriangleMesh.load(textured(tmp_path, "a.png", pbrMetallicRoughness={"baseColorFactor": [float("nan"), 0, 0, 1]}))
    assert mesh.materials.materials[0].color == (1.0, 1.0, 1.0)


def test_wrapping_and_transform_of_images(tmp_path):
    """How images go on beyond their edges was always "repeat"; `KHR_texture_transform` was not looked at."""
    write_image(tmp_path / "a.png")
    path = textured(tmp_path, "a.png")
    document = json.loads(path.read_text())
    plain = TriangleMesh.load(path).materials
    document["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    document["textures"][0]["sampler"] = 0
    turned = {"offset": [0.25, 0.5], "rotation": np.pi / 2, "scale": [2, 3]}
    texture = document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    texture["extensions"] = {"KHR_texture_transform": turned}
    path.write_text(json.dumps(document))
    found = TriangleMesh.load(path).materials
    assert found.materials[0].color_texture.wrap == ("clamp", "mirror")
    u, v = plain.corner_uv[..., 0], 1.0 - plain.corner_uv[..., 1]
    expected = np.stack([3 * v + 0.25, 1.0 - (-2 * u + 0.5)], axis=-1)  # a quarter turn takes u to -v
    np.testing.assert_allclose(found.corner_uv, expected, atol=1e-5)
    assert found.materials[0].alpha_cutoff is None
    for values, factor, cutoff in (({}, 1.0, 0.5), ({"alphaCutoff": 0.3}, 0.6, 0.5), ({"alphaCutoff": 0.8}, 0.4, 2.0)):
        document["materials"][0] |= {"alphaMode": "MASK"} | values
        document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = [1, 1, 1, factor]
        path.write_text(json.dumps(document))
        assert TriangleMesh.load(path).materials.materials[0].alpha_cutoff == pytest.approx(cutoff)
    assert found.materials[0].color_texture.alpha is None
    Image.new("RGBA", (2, 2), (9, 8, 7, 128)).save(tmp_path / "a.png")
    texture = TriangleMesh.load(path).materials.materials[0].color_texture
    assert (texture.alpha == 128).all()
    assert (texture.pixels == (9, 8, 7)).all()
    document["samplers"] = [{"wrapS": 4711}]
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match="material 'wood' has wrapS, wrapT = 4711"):
        TriangleMesh.load(path)


def test_deep_graphs_of_trimesh(tmp_path):
    """trimesh orders the products of a path of 3,000 nodes for hours; `wrt.Scene(trimesh.load(...))` did not return."""
    import trimesh

    file = next(one for one in GLTF_FILES if one.name == "chain_of_3000_nodes.gltf")
    file.write(tmp_path / file.name)
    graph = trimesh.load(tmp_path / file.name, process=False)
    np.testing.assert_allclose(TriangleMesh.from_trimesh(graph).bounds, file.bounds)
    (instance,) = as_instances(graph)
    np.testing.assert_allclose(instance.transform[:3, 3], file.bounds[0])


# -- up ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["ply", "obj", "off", "stl", "glb", "gltf"])
@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.0, -0.8)])
def test_saved_meshes_keep_their_upward_direction(tmp_path, suffix, up):
    """The first page of the guide saved a teapot whose z axis points up, and its first lines showed it fallen over."""
    mesh = TriangleMesh(ANGLE.points, TRIANGLES, up=up)
    mesh.save(tmp_path / f"a.{suffix}")
    loaded = TriangleMesh.load(tmp_path / f"a.{suffix}")
    assert (loaded.up or (0.0, 0.0, 1.0)) == pytest.approx(up)
    np.testing.assert_allclose(loaded.vertices[loaded.faces], mesh.vertices[mesh.faces], atol=1e-6)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.0, -1.0, 0.0)])
def test_other_programs_see_a_saved_glb_upright(tmp_path, up):
    import trimesh

    TriangleMesh(CORNERS, TRIANGLES, up=up).save(tmp_path / "a.glb")
    found = trimesh.util.concatenate(list(trimesh.load(tmp_path / "a.glb", process=False).dump()))
    moved = found.vertices - found.vertices[0]
    np.testing.assert_allclose(moved[:, 1], (CORNERS - CORNERS[0]) @ up, atol=1e-6)
    assert found.volume == pytest.approx(1.0)


def test_built_in_scenes_state_that_z_is_up():
    assert wrt.scenes.build("teapot", level=2, ground=False).up == (0.0, 0.0, 1.0)
