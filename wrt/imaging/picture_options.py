"""Options of pictures by keyword, for type checkers; `wrt.render` and `wrt.pictures.RenderSettings` explain them."""

from __future__ import annotations

from typing import Any, TypedDict

__all__ = ["AmbientOptions", "PictureOptions", "SettingOptions"]


class SharedOptions(TypedDict, total=False):
    """Of all integrators."""

    samples: int | None
    smooth: bool
    crease_angle: float
    seed: int
    traversal: str
    triangle_test: str


class AmbientOptions(SharedOptions, total=False):
    """Of "ambient": keywords of `wrt.pictures.AmbientRendering`."""

    light: Any
    light_color: Any
    shadows: bool
    ambient_samples: int
    ambient_distance: float | None
    ambient_radius: int
    ambient_color: Any
    albedo: Any
    background: Any
    tile_pixels: int | None


class SettingOptions(SharedOptions, total=False):
    """Of the others: fields of `wrt.pictures.RenderSettings`."""

    depth: int
    sampler: str
    pixel_filter: str
    lens_radius: float
    focus_distance: float | None
    fresnel: str
    threshold: float
    roulette: bool
    sample_lights: bool
    ambient: Any
    max_radiance: float
    exposure: float
    tone_mapping: str
    wave: int
    texture_memory: int | None


class PictureOptions(AmbientOptions, SettingOptions, total=False):
    """Of any integrator."""
