"""Lights in files: a scene and its lights, read again, give the same picture; other files are refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

import wrt
from wrt.scene.archives import read_archive, write_archive
from wrt.scenes.shapes import boxes, plane

CAMERA = wrt.PinholeCamera(16, 12, position=(2, -6, 4), look_at=(0, 0, 0.5))
LIGHTS = (
    wrt.lights.PointLight((1.0, -2.0, 3.1), (5.0, 6.0, 7.3)),
    wrt.lights.SpotLight((0.3, 0.1, 5.0), (0.7, -0.2, 0.0), 30.0, angle=33.3, inner=11.1),
    wrt.lights.DirectionalLight((0.4, 0.3, -1.0), (1.0, 0.9, 0.7)),
    wrt.lights.AreaLight.rectangle((-4.0, 2.0, 1.0), (2.0, 2.5, 0.1), (0.0, 0.3, 3.0), 1.7, two_sided=True),
    wrt.lights.AreaLight.triangle((3.0, 2.0, 1.0), (3.5, 2.1, 2.0), (2.5, 1.9, 2.2), (9.0, 8.0, 7.0)),
    wrt.lights.AreaLight.sphere((0.0, -3.0, 2.2), 0.35, 4.0),
    wrt.lights.Sky.image(np.random.default_rng(0).random((5, 7, 3)), up=(0.1, 0.2, 1.0), east=(0.9, -0.3, 0.1)),
)


def values_of(light: object) -> dict[str, object]:
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(light).items()}


@pytest.mark.parametrize("light", [*LIGHTS, wrt.lights.Sky(0.4), wrt.lights.Sky.gradient(0.8, (0.2, 0.4, 0.9), 0.1)])
def test_every_kind_of_light(tmp_path, light):
    wrt.lights.save_lights(tmp_path / "lights.npz", light)
    (again,) = wrt.lights.load_lights(tmp_path / "lights.npz")
    assert type(again) is type(light)
    assert json.dumps(values_of(again)) == json.dumps(values_of(light)), "to the last bit"


def test_a_scene_and_its_lights_give_the_same_picture(tmp_path):
    """Lights that are materials are in the scene's file, the others in theirs."""
    lamp = plane((-1, -1), (1, 1), z=4.0).with_materials(wrt.Material(color=0.0, emission=(3.0, 2.0, 1.0), two_sided=True))
    floor = plane((-5, -5), (5, 5)).with_materials(wrt.Material(color=0.8))
    scene = wrt.Scene([boxes((-1, -1, 0.0), (1, 1, 1.5)), floor, lamp], device="cpu")
    scene.save(tmp_path / "scene.npz")
    wrt.lights.save_lights(tmp_path / "lights.npz", LIGHTS)
    again, lights = wrt.Scene.load(tmp_path / "scene.npz", device="cpu"), wrt.lights.load_lights(tmp_path / "lights.npz")
    options = {"integrator": "path", "samples": 2, "depth": 4}
    expected = wrt.render(scene, CAMERA, lights=LIGHTS, **options)
    np.testing.assert_array_equal(wrt.render(again, CAMERA, lights=lights, **options), expected)
    only_lamp = wrt.render(scene, CAMERA, **options)
    np.testing.assert_array_equal(wrt.render(again, CAMERA, **options), only_lamp)
    assert only_lamp.mean() < expected.mean()


def test_what_is_no_light_is_not_written(tmp_path):
    class Flickering(wrt.lights.PointLight):
        pass

    for lights, said in (
        ("sun", "lights must be a sequence of"),
        ([LIGHTS[0], 1.0], "lights must be a sequence of"),
        (Flickering((0, 0, 1)), "a light of type Flickering cannot be saved"),
    ):
        with pytest.raises(TypeError, match=said):
            wrt.lights.save_lights(tmp_path / "lights.npz", lights)
    with pytest.raises(ValueError, match="more than one"):
        wrt.lights.save_lights(tmp_path / "lights.npz", [wrt.lights.Sky(), wrt.lights.Sky()])
    assert not list(tmp_path.iterdir())


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "lights.npz"
    with pytest.raises(FileNotFoundError, match="no file of lights at"):
        wrt.lights.load_lights(path)
    wrt.Scene(plane((-1, -1), (1, 1)), device="cpu").save(tmp_path / "scene.npz")
    with pytest.raises(ValueError, match="is not a file of lights that wrt saved"):
        wrt.lights.load_lights(tmp_path / "scene.npz")
    wrt.lights.save_lights(path, LIGHTS)
    with pytest.raises(ValueError, match="is not a scene that wrt saved"):
        wrt.Scene.load(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    with pytest.raises(ValueError, match="save it again"):
        wrt.lights.load_lights(path)
    path.write_bytes(whole.replace(*(text.encode("utf-32-le") for text in ("PointLight", "PointLigth")), 1))
    with pytest.raises(ValueError, match="or it is damaged"):
        wrt.lights.load_lights(path)


@pytest.mark.parametrize(
    ("number", "name", "value"),
    [
        (0, "position", np.array([0.0, np.nan, 0.0])),
        (0, "kind", "Scene"),
        (1, "angle", 95.0),
        (2, "direction", np.array([1.0, 1.0, 0.0])),
        (3, "shape", "disc"),
        (5, "radius", -1.0),
        (6, "texels", np.full((2, 2, 3), -1.0)),
    ],
)
def test_forged_values_are_checked(tmp_path, number, name, value):
    """Values that no constructor takes, under a checksum that fits."""
    path = tmp_path / "lights.npz"
    wrt.lights.save_lights(path, LIGHTS)
    arrays = read_archive(path)
    if isinstance(value, np.ndarray):
        arrays[f"{number}.{name}"] = value
    else:
        header = json.loads(str(arrays["lights"]))
        header["lights"][number][name] = value
        arrays["lights"] = np.array(json.dumps(header))
    write_archive(path, arrays)
    with pytest.raises(ValueError, match="is not a file of lights that wrt saved, or it is damaged"):
        wrt.lights.load_lights(path)
