"""Valid arguments of cameras, lights, materials and pictures."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

import wrt
from support.call_objects import Call, area_light, mesh, pinhole, rendering, scene

POSE = {"position": (0.0, -4.0, 2.0), "look_at": (0.0, 0.0, 1.0), "up": (0.0, 0.0, 1.0)}


def picture_calls() -> Iterator[Call]:
    axes = {"least_quality": 0.5, "acceptable": 1.25, "excellent": 0.75}
    yield Call("AxisChoice", wrt.known_rays.AxisChoice, axes)
    yield Call("PinholeCamera", wrt.PinholeCamera, {"width": 4, "height": 3, "fov": 32.0, **POSE})
    yield Call("OrthographicCamera", wrt.OrthographicCamera, {"width": 4, "height": 3, "view_height": 2.0, **POSE})
    options = {"width": 4, "height": 3, "fov": 32.0, "margin": 0.25, "towards": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
    for kind in ("from_opencv", "from_opengl"):
        at_pose = partial(getattr(wrt.PinholeCamera, kind), pose=np.eye(4))
        yield Call(f"_Camera.{kind}", at_pose, {"width": 4, "height": 3})
    blender = partial(wrt.PinholeCamera.from_blender, matrix_world=np.eye(4))
    yield Call("PinholeCamera.from_blender", blender, {"width": 4, "height": 3, "angle": 0.5})
    blender = partial(wrt.OrthographicCamera.from_blender, matrix_world=np.eye(4))
    yield Call("OrthographicCamera.from_blender", blender, {"width": 4, "height": 3, "ortho_scale": 2.0})
    yield Call("PinholeCamera.framing", lambda **o: wrt.PinholeCamera.framing(mesh(), **o), options)
    yield Call("_Camera.rays", lambda **o: pinhole().rays(**o), {"sample": 1, "samples": 2, "seed": 1})
    light = {"position": (0.0, 0.0, 9.0), "intensity": (2.0, 2.0, 2.0)}
    yield Call("PointLight", wrt.lights.PointLight, light)
    yield Call("SpotLight", wrt.lights.SpotLight, {**light, "look_at": (0.0, 0.0, 0.0), "angle": 32.0, "inner": 16.0})
    yield Call("DirectionalLight", wrt.lights.DirectionalLight, {"direction": (0.0, 0.0, -1.0), "irradiance": 2.0})
    yield Call("AreaLight.sphere", wrt.lights.AreaLight.sphere, {"center": (0.0, 0.0, 9.0), "radius": 2.0, "radiance": 2.0})
    edges = {"corner": (0.0, 0.0, 9.0), "edge1": (1.0, 0.0, 0.0), "edge2": (0.0, 1.0, 0.0)}
    yield Call("AreaLight.rectangle", wrt.lights.AreaLight.rectangle, {**edges, "two_sided": False})
    corners = {"a": (0.0, 0.0, 9.0), "b": (1.0, 0.0, 9.0), "c": (0.0, 1.0, 9.0)}
    yield Call("AreaLight.triangle", wrt.lights.AreaLight.triangle, {**corners, "two_sided": False})
    yield Call("Sky", wrt.lights.Sky, {"radiance": 2.0})
    yield Call("Sky.gradient", wrt.lights.Sky.gradient, {"horizon": 2.0, "zenith": 1.0, "ground": 0.5, "up": (0.0, 0.0, 1.0)})
    image = np.ones((2, 2, 3))
    yield Call(
        "Sky.image",
        lambda **o: wrt.lights.Sky.image(image, **o),
        {"scale": 2.0, "up": (0.0, 0.0, 1.0), "east": (1.0, 0.0, 0.0)},
    )
    shares = {"color": 0.5, "roughness": 0.5, "metallic": 0.5, "index": 1.5, "absorption": 1.0, "translucency": 0.5}
    shares |= {"priority": 1, "emission": (2.0, 2.0, 2.0), "two_sided": False, "alpha_cutoff": 0.5}
    yield Call("Material", wrt.Material, shares)
    numbers = {"samples": 2, "depth": 4, "seed": 1, "wave": 64, "texture_memory": 1 << 17}
    factors = {"lens_radius": 0.5, "focus_distance": 2.0, "threshold": 0.5, "max_radiance": 4.0, "crease_angle": 32.0}
    flags = {"roulette": False, "sample_lights": False, "smooth": False}
    yield Call("RenderSettings", wrt.pictures.RenderSettings, {**numbers, **factors, **flags, "exposure": 2.0, "ambient": 0.5})
    yield Call("SampledPicture.advance", lambda **o: rendering().advance(**o).samples, {"samples": 1})
    yield Call("Rendering.image", lambda **o: rendering().image(**o), {"exposure": 2.0})
    adapted = lambda **o: wrt.pictures.AdaptiveRendering(scene(), pinhole(), **o).advance().linear  # noqa: E731
    yield Call("AdaptiveRendering", adapted, {"samples": 8, "unbiased": False, "pilot": 4, "rounds": 1, "most": 16})
    adapted = lambda **o: wrt.pictures.AdaptiveRendering(scene(), pinhole(), samples=8).advance().image(**o)  # noqa: E731
    yield Call("AdaptiveRendering.image", adapted, {"exposure": 2.0})
    yield Call("Rendering.developed", lambda **o: rendering().developed(**o), {"exposure": 2.0})
    options = {"samples": 1, "ambient_samples": 1, "ambient_distance": 4.0, "crease_angle": 32.0, "seed": 1, "tile_pixels": 12}
    options |= {"light": (0.0, 0.0, 9.0), "shadows": True, "smooth": True, "albedo": 0.5, "ambient_color": 0.5}
    yield Call("render", lambda **o: wrt.render(scene(), pinhole(), **o), options)
    options = options | {"ambient_radius": 1}
    yield Call("AmbientRendering", lambda **o: ambient(**o).advance().image(), options)
    yield Call("SampledPicture.advance", lambda **o: ambient().advance(**o).done, {"samples": 1})
    options = {"position": (0.0, 1.0, 9.0), "resolution": 4, "cull_backfaces": False, "max_bytes": 1 << 20}
    yield Call("LightBuffer", lambda **o: wrt.lights.LightBuffer(scene(), **o).bytes, options)
    flat = {"corner": (0.0, 0.0, 9.0), "edge_u": (1.0, 0.0, 0.0), "edge_v": (0.0, 1.0, 0.0)}
    options = {**flat, "samples": 4, "patterns": 2, "seed": 1}
    yield Call(
        "AreaLightVisibility.rectangle", lambda **o: wrt.lights.AreaLightVisibility.rectangle(scene(), **o).positions, options
    )
    yield Call("AreaLightVisibility.patterns_of", lambda **o: area_light().patterns_of(**o), {"count": 4})


def ambient(**options: Any) -> wrt.pictures.AmbientRendering:
    return wrt.pictures.AmbientRendering(scene(), pinhole(), **options)
