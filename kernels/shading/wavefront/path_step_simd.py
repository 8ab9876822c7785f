"""A step of path tracing for W simple rays at once, on the CPU.

Most rays of most pictures hit a matte surface in air. Shading one takes a thousand instructions, nearly without branches, so W
of them are shaded in lanes. So are those that hit a mirror or smooth glass, and paths that end: in the last generation, and
where nothing is hit under a sky of one colour. A ray is simple if its surface has no image, no colours of corners and emits
nothing, if nothing is absorbed on its way, if it enters glass from air, and if the light that it chooses is one of those below.
Each simple ray gets the bits that `path_step` gives it. The others, and whole groups of W without a simple ray, are left to it.

Lights: points, directions, flat and round lights, emissive triangles, and a sky of one colour. Scenes with many lights have no
simple rays.

The C++ is in `kernels/native`: `path_step.h`, and what it includes.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.query.spawn import INSET
from wrt.kernels.runtime import native
from wrt.kernels.shading.bsdf.ggx import MIN_ALPHA
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
from wrt.kernels.shading.wavefront.pixel_samples import FIRST_BOUNCE, PER_BOUNCE, RANDOM, SOBOL
from wrt.kernels.shading.wavefront.ray_at_hit import StepArrays
from wrt.kernels.shading.wavefront.ray_queue import RayQueue
from wrt.kernels.shading.wavefront.scene_light import LitScene

SURFACES = same(OFFSET=OFFSET, INSET=INSET, MIN_ALPHA=MIN_ALPHA, DIFFUSE=DIFFUSE, MIRROR=MIRROR, DIELECTRIC=DIELECTRIC)
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

ARRAYS = "wrt::StepArrays{scene, arrays.source, arrays.wave, arrays.queue, arrays.hits, arrays.rays}"
"""C++: the scene and the `StepArrays` of a step."""


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
    """whether lights are sampled; without, light is found by scattering only."""


@cache
def make_path_step_simd(width: int) -> Any:
    """`path_step_simd` for the given number of lanes."""
    call = f"wrt::shade_paths<{width}>({ARRAYS}, step, first, wrt::InPlace{{following, is_alive, arrays.rays}})"

    @native.func_native("path_step.h", in_lanes(call, SURFACES, LIGHTS, SAMPLES))
    def path_step_simd(
        first: int,
        step: PathStep,
        scene: LitScene,
        arrays: StepArrays,
        following: RayQueue,
        is_alive: wp.array(dtype=int),
    ) -> wp.uint32:
        """Does the step of the simple ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. What it writes for the others is to be overwritten.
        """

    return path_step_simd


WIDTH = wp.constant(lane_width())
path_step_simd = make_path_step_simd(lane_width())
