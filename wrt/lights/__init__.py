"""Lights, and how much of them a point sees.

    sun = wrt.lights.DirectionalLight((-1.0, -2.0, -3.0), (3.0, 2.9, 2.7))
    image = wrt.render(scene, camera, integrator="path", lights=[sun, wrt.lights.Sky(0.6)])

What `lights` of `wrt.render` and `wrt.pictures.Rendering` takes: `PointLight`, `SpotLight`, `DirectionalLight`, `AreaLight`
and `Sky`. Lights are arguments of a picture, not part of a scene: `save_lights` and `load_lights` keep them in a file beside
that of `wrt.Scene.save`. Visibility without pictures: `LightBuffer` (of a point) and `AreaLightVisibility` (of a polygon).
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "AreaLight": "wrt.lights.light_sources",
    "AreaLightVisibility": "wrt.shadows.area_light_visibility",
    "DirectionalLight": "wrt.lights.light_sources",
    "LightBuffer": "wrt.shadows.light_buffer",
    "PointLight": "wrt.lights.light_sources",
    "Sky": "wrt.lights.sky_image",
    "SpotLight": "wrt.lights.light_sources",
    "load_lights": "wrt.lights.stored_lights",
    "save_lights": "wrt.lights.stored_lights",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
