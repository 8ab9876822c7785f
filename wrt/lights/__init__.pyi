# Written by `python -m tests.typed.stubs` from the table of names in wrt/lights/__init__.py.
from wrt.lights.light_sources import AreaLight as AreaLight
from wrt.lights.light_sources import DirectionalLight as DirectionalLight
from wrt.lights.light_sources import PointLight as PointLight
from wrt.lights.light_sources import SpotLight as SpotLight
from wrt.lights.sky_image import Sky as Sky
from wrt.lights.stored_lights import load_lights as load_lights
from wrt.lights.stored_lights import save_lights as save_lights
from wrt.shadows.area_light_visibility import AreaLightVisibility as AreaLightVisibility
from wrt.shadows.light_buffer import LightBuffer as LightBuffer

__all__ = [
    "AreaLight",
    "AreaLightVisibility",
    "DirectionalLight",
    "LightBuffer",
    "PointLight",
    "Sky",
    "SpotLight",
    "load_lights",
    "save_lights",
]
