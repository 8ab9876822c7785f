"""Scene files keep the materials of meshes."""

from __future__ import annotations

import json
import pickle

import numpy as np

import wrt
from wrt.scene.archives import read_archive, write_archive


def test_materials_are_kept(tmp_path):
    """They were lost: a saved scene came back grey."""
    grid = np.random.default_rng(0).random((4, 5, 4))
    image = wrt.Texture(grid, wrap=("mirror", "clamp"))
    listed = [
        wrt.Material(
            "glossy", color=(0.2, 0.4, 0.6), roughness=0.3, color_texture=image, surface_texture=image, alpha_cutoff=0.7
        ),
        wrt.Material("dielectric", index=1.3, absorption=(1, 2, 3), priority=2, color=1.0),
        wrt.Material(emission=(4, 5, 6), two_sided=False, translucency=0.25),
    ]
    plain = wrt.scenes.build("teapot", level=2)
    of_face = np.arange(plain.triangle_count) % 3
    colors = np.random.default_rng(1).random((plain.vertex_count, 3))
    painted = plain.with_materials(listed, of_face, uv=plain.vertices[:, :2], colors=colors)
    wrt.Scene([plain, painted, plain.with_materials(listed[1])], device="cpu").save(tmp_path / "a.npz")
    first, second, third = wrt.Scene.load(tmp_path / "a.npz", device="cpu").meshes
    assert first.materials is None
    assert third.materials.materials == (listed[1],)
    for name in ("of_face", "corner_uv", "corner_color"):
        np.testing.assert_array_equal(getattr(second.materials, name), getattr(painted.materials, name))
    one, two, three = second.materials.materials
    assert (two, three) == (listed[1], listed[2])
    assert one.color_texture is one.surface_texture
    np.testing.assert_array_equal(one.color_texture.pixels, image.pixels)
    np.testing.assert_array_equal(one.color_texture.alpha, image.alpha)
    assert (one.alpha_cutoff, two.alpha_cutoff) == (0.7, None)
    assert one.color_texture.wrap == pickle.loads(pickle.dumps(image)).wrap == ("mirror", "clamp")
    assert (one.roughness, one.color) == (0.3, (0.2, 0.4, 0.6))


def test_files_without_materials_are_read(tmp_path):
    """As written before meshes had any."""
    path = tmp_path / "a.npz"
    wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu").save(path)
    arrays = read_archive(path)
    header = json.loads(str(arrays["wrt"]))
    del header["materials"]
    write_archive(path, arrays | {"wrt": np.array(json.dumps(header))})
    assert wrt.Scene.load(path, device="cpu").meshes[0].materials is None
