"""How a picture is made: one object for all integrators; and all options of pictures by keyword, for type checkers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from wrt.engine.facts.query_kinds import AUTO
from wrt.imaging.integrators import INTEGRATORS
from wrt.imaging.integrators.texture_tiles import MIN_BUDGET
from wrt.kernels.shading.wavefront.camera_rays import FILTERS
from wrt.kernels.shading.wavefront.picture import TONE_MAPPINGS
from wrt.kernels.shading.wavefront.pixel_samples import SAMPLERS
from wrt.kernels.validation import as_int, convert_fields
from wrt.materials.material import as_color
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers

__all__ = ["INTEGRATORS", "RenderSettings"]

FRESNEL = ("exact", "schlick")

DEFAULT_SAMPLES = {"whitted": 1, "distribution": 16, "path": 16}


OF_TREES = {"integrators": ("whitted", "distribution")}
OF_PATHS = {"integrators": ("path",)}
"""Metadata of fields that only some integrators read."""


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """How a picture is made by "whitted", "distribution" or "path".

    Args:
        samples: per pixel; None for 1 with "whitted", and 16 with the others.
        depth: greatest number of rays in a row, from the camera: 1 shows what the camera sees of lights, 2 what they light.
        sampler: "regular", "random", "jittered", "halton" or "sobol" (`wrt.kernels.shading.wavefront.pixel_samples`).
        pixel_filter: "box", "tent" or "gaussian".
        lens_radius: of the camera's thin lens, in scene units; 0 for a pinhole.
        focus_distance: from the camera to what is sharp, along the viewing direction; None: to `camera.look_at`.
        fresnel: "exact", or "schlick" for Schlick's approximation.
        threshold: weight below which rays of "whitted" and "distribution" end; 0: they reach `depth`.
        roulette: whether rays that would end may go on, weighted up. Of "path": whether paths may end after four rays.
        sample_lights: of "path": whether lights are sampled at each point; without, light is only found by scattering.
        ambient: of "whitted" and "distribution": radiance of a constant ambient light, a number or (3,); None: the mean of the
            sky for "whitted", none for "distribution".
        max_radiance: largest component of a sample, which bounds rare bright pixels and makes the picture a little darker.
        smooth, crease_angle: smooth normals, as in `wrt.render`.
        exposure: factor of the linear picture before tone mapping.
        tone_mapping: "srgb" (clipped), "reinhard", "aces", or "linear" for no encoding.
        seed: of the random numbers. Pixel p of the seed s + 1 has those of pixel p + 1 of the seed s, counted row by row; for
            pictures that are independent, take seeds that are further apart than the number of pixels.
        wave: number of samples that are traced together; it bounds memory and does not change the picture.
        texture_memory: bytes of device memory for the images of textures, at least 131072; None: they are there as a whole. If
            they take more, tiles of 64 x 64 texels are loaded as rays need them. It does not change the picture.
        traversal, triangle_test: as in `Scene.intersect`.

    Raises:
        TypeError, ValueError: a value of a wrong type, out of range, or an unknown name.
    """

    samples: int | None = None
    depth: int = 8
    sampler: str = "sobol"
    pixel_filter: str = "box"
    lens_radius: float = 0.0
    focus_distance: float | None = None
    fresnel: str = "exact"
    threshold: float = field(default=1.0 / 256.0, metadata=OF_TREES)
    roulette: bool = True
    sample_lights: bool = field(default=True, metadata=OF_PATHS)
    ambient: Any = field(default=None, metadata=OF_TREES)
    max_radiance: float = np.inf
    smooth: bool = True
    crease_angle: float = 60.0
    exposure: float = 1.0
    tone_mapping: str = "srgb"
    seed: int = 0
    wave: int = 1 << 20
    texture_memory: int | None = None
    traversal: str = AUTO
    triangle_test: str = AUTO

    def __post_init__(self) -> None:
        convert_fields(self)
        for name, minimum in (("samples", 1), ("depth", 1), ("seed", 0), ("wave", 1), ("texture_memory", MIN_BUDGET)):
            if getattr(self, name) is not None:
                as_int(name, getattr(self, name), minimum)
        choices = {"sampler": SAMPLERS, "pixel_filter": FILTERS, "fresnel": FRESNEL, "tone_mapping": TONE_MAPPINGS}
        for name, known in choices.items():
            one_of(known, getattr(self, name), name)
        for name in ("lens_radius", "threshold", "max_radiance", "exposure"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must not be negative")
        if self.focus_distance is not None and not (0.0 < self.focus_distance < np.inf):
            raise ValueError(f"focus_distance is {self.focus_distance}; it must be above 0 and finite")
        if not 0.0 < self.crease_angle < 90.0:
            raise ValueError(
                f"crease_angle is {self.crease_angle}; it must be between 0 and 90 degrees (smooth=False for flat shading)"
            )
        if self.ambient is not None:
            object.__setattr__(self, "ambient", as_color("ambient", self.ambient))

    def samples_of(self, integrator: str) -> int:
        """Samples per pixel of an integrator."""
        return DEFAULT_SAMPLES[integrator] if self.samples is None else self.samples

    def with_options(self, integrator: str, options: Mapping[str, Any]) -> RenderSettings:
        """The same with some values replaced.

        Args:
            integrator: that reads them.
            options: values by name.

        Raises:
            TypeError: an option that this integrator does not have.
        """
        known = [one.name for one in fields(self) if integrator in one.metadata.get("integrators", INTEGRATORS)]
        unknown = [name for name in options if name not in known]
        if unknown:
            raise TypeError(f"integrator {integrator!r} has no option {unknown[0]!r}; its options are {', '.join(known)}")
        return replace(self, **options)


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

    light: ArrayLike | None
    light_color: Numbers
    shadows: bool
    ambient_samples: int
    ambient_distance: float | None
    ambient_radius: int
    ambient_color: Numbers
    albedo: Numbers
    background: Numbers
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
    ambient: Numbers | None
    max_radiance: float
    exposure: float
    tone_mapping: str
    wave: int
    texture_memory: int | None


class PictureOptions(AmbientOptions, SettingOptions, total=False):
    """Of any integrator."""
