"""Lights in files, beside those of scenes: lights are arguments of pictures, so `wrt.Scene.save` has none to write.

A file is an .npz archive of plain arrays with a checksum, as those of scenes; nothing in it is executed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.lights.device_lights import Light, check_lights
from wrt.lights.light_sources import AreaLight, DirectionalLight, PointLight, SpotLight
from wrt.lights.sky_image import Sky
from wrt.scene.archives import check_format, checked_reading, read_archive, write_archive

if TYPE_CHECKING:
    from wrt.lights.device_lights import Lights

FORMAT = 1

FIELDS: dict[type, tuple[str, ...]] = {
    PointLight: ("position", "intensity"),
    SpotLight: ("position", "direction", "intensity", "angle", "inner"),
    DirectionalLight: ("direction", "irradiance"),
    AreaLight: ("shape", "position", "edge1", "edge2", "radius", "radiance", "two_sided"),
    Sky: ("texels", "up", "east"),
}
"""Attributes by which a light of a kind is written."""

KINDS = {kind.__name__: kind for kind in FIELDS}


def save_lights(path: str | Path, lights: Lights) -> None:
    """Writes lights to a file that `load_lights` reads.

        scene.save("court.npz")
        wrt.lights.save_lights("court_lights.npz", lights)
        ...
        scene, lights = wrt.Scene.load("court.npz"), wrt.lights.load_lights("court_lights.npz")
        image = wrt.render(scene, camera, integrator="path", lights=lights)

    Surfaces that emit are part of the scene's file. An existing file is replaced only once the new one is complete.

    Args:
        path: of the file, an .npz archive of plain arrays, whatever its name.
        lights: as in `wrt.pictures.Rendering`: a light, or a sequence of lights with at most one `Sky`.

    Raises:
        TypeError: something else than lights.
        ValueError: more than one sky; `path` is a device, a pipe or a folder.
        OSError: the file cannot be written.
    """
    listed, arrays = [], {}
    for number, light in enumerate(check_lights(lights)):
        if type(light) not in FIELDS:
            raise TypeError(f"a light of type {type(light).__name__} cannot be saved; make it one of {', '.join(KINDS)}")
        values = {name: getattr(light, name) for name in FIELDS[type(light)]}
        listed.append({"kind": type(light).__name__})
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                arrays[f"{number}.{name}"] = value
            else:
                listed[-1][name] = value
    arrays["lights"] = np.array(json.dumps({"format": FORMAT, "lights": listed}))
    write_archive(Path(path), arrays)


def load_lights(path: str | Path) -> tuple[Light, ...]:
    """Reads lights that `save_lights` wrote; pictures with them are the same bit for bit.

    Args:
        path: of the file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds no lights, or it is damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no file of lights at '{path}': check the path (now in '{Path.cwd()}')")
    with checked_reading(path, "a file of lights that wrt saved", "save it again"):
        arrays = read_archive(path)
        header = json.loads(str(arrays["lights"]))
        check_format(header["format"], FORMAT)
        made = tuple(_light(number, dict(one), arrays) for number, one in enumerate(header["lights"]))
        return check_lights(made)


def _light(number: int, values: dict[str, Any], arrays: Mapping[str, np.ndarray]) -> Light:
    """A light by the checks of its constructor, with the values of the file.

    Raises:
        KeyError, TypeError, ValueError: the values are not those of a light.
    """
    kind = KINDS[values.pop("kind")]
    values |= {name: arrays[f"{number}.{name}"] for name in FIELDS[kind] if name not in values}
    if kind is Sky:
        light: Any = Sky.image(values["texels"], up=values["up"], east=values["east"])
    elif kind is AreaLight and values["shape"] == "sphere":
        return AreaLight.sphere(values["position"], values["radius"], values["radiance"])
    elif kind is AreaLight:
        if values["shape"] not in ("rectangle", "triangle"):
            raise ValueError(f"a light has the shape {values['shape']!r}")
        edges = (values[name] for name in ("position", "edge1", "edge2", "radiance", "two_sided"))
        return AreaLight._flat(values["shape"], *edges)
    elif kind is SpotLight:
        aim = values["position"] + values["direction"]
        light = SpotLight(values["position"], aim, values["intensity"], angle=values["angle"], inner=values["inner"])
    else:
        light = kind(*(values[name] for name in FIELDS[kind]))
    for name in ("direction", "up", "east"):  # unit vectors, which another normalisation would round again
        if name in values:
            unit = np.asarray(values[name], dtype=np.float64)
            if unit.shape != (3,) or not np.isclose(unit @ unit, 1.0, rtol=0.0, atol=1e-9):
                raise ValueError(f"{name} of a light is no unit vector")
            setattr(light, name, unit)
    return light
