"""A step of path tracing for W plain rays at once, on the CPU.

Most rays of most pictures hit a matte surface in air. Shading one takes a thousand instructions, nearly without branches, so W
of them are shaded in lanes. So are those that hit a mirror or smooth glass, and paths that end: in the last generation, and
where nothing is hit under a sky of one colour. A ray is plain if its surface has no image, no colours of corners and emits
nothing, if nothing is absorbed on its way, if it enters glass from air, and if the lamp that it chooses is one of those below.
Each plain ray gets the bits that `path_step` gives it. The others, and whole groups of W without a plain ray, are left to it.

Lamps: points, directions, flat and round lamps, emissive triangles, and a sky of one colour. Scenes with many lamps have no
plain rays.

The C++ is in `kernels/native`: `path_step.h`, and what it includes.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.spawn import INSET
from wrt.kernels.runtime import native
from wrt.kernels.shading.bsdf.ggx import SMALLEST_ALPHA
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, DIFFUSE, MIRROR
from wrt.kernels.shading.emitters.light_table import (
    DIRECTIONAL,
    PARALLELOGRAM,
    POINT,
    SKY,
    SPHERE,
    TRIANGLE,
    TRIANGLES,
)
from wrt.kernels.shading.surface import OFFSET
from wrt.kernels.shading.wavefront.lane_code import in_lanes, same
from wrt.kernels.shading.wavefront.pixel_samples import FIRST_BOUNCE, PER_BOUNCE, RANDOM, SOBOL, PixelSamples
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene

SURFACES = same(
    OFFSET=OFFSET, INSET=INSET, SMALLEST_ALPHA=SMALLEST_ALPHA, DIFFUSE=DIFFUSE, MIRROR=MIRROR, DIELECTRIC=DIELECTRIC
)
"""C++: the constants of `surfaces.h` are those of Python."""

LIGHTS = same(
    POINT=POINT,
    DIRECTIONAL=DIRECTIONAL,
    PARALLELOGRAM=PARALLELOGRAM,
    TRIANGLE=TRIANGLE,
    SPHERE=SPHERE,
    TRIANGLES=TRIANGLES,
    SKY=SKY,
)
"""C++: those of `light_sampling.h`."""

SAMPLES = same(SOBOL=SOBOL, RANDOM=RANDOM, FIRST_BOUNCE=FIRST_BOUNCE, PER_BOUNCE=PER_BOUNCE)
"""C++: those of `random_numbers.h`."""

ARRAYS = "wrt::StepArrays{scene, source, wave, queue, hits, rays}"
"""C++: what a step reads and writes."""


@wp.struct
class PathStep:
    """The step of a generation."""

    generation: int
    """0 for camera rays."""
    is_last: bool
    """Whether paths end here, and only collect what the surface emits."""
    roulette: int
    """First generation whose rays may end by Russian roulette."""
    samples_lights: bool
    """whether lamps are sampled; without, light is found by scattering only."""


@cache
def make_shade_plain(width: int) -> Any:
    """`shade_plain` for so many lanes."""
    call = f"wrt::shade_paths<{width}>({ARRAYS}, step, first, wrt::InPlace{{following, goes_on, rays}})"

    @native.func_native("path_step.h", in_lanes(call, SURFACES, LIGHTS, SAMPLES))
    def shade_plain(
        first: int,
        step: PathStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        following: RayQueue,
        goes_on: wp.array(dtype=int),
    ) -> wp.uint32:
        """Does the step of the plain ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. What it writes for the others is to be overwritten.
        """
        ...

    return shade_plain


WIDTH = wp.constant(lane_width())
shade_plain = make_shade_plain(lane_width())
