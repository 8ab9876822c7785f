"""From light to colour: samples are summed in linear light, then converted to sRGB.

References: iec-61966-1999.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.surface import Surface


@wp.struct
class Lighting:
    """Linear colours of the light sources and the background."""

    light: wp.vec3
    ambient: wp.vec3
    background_low: wp.vec3
    """At the lower edge of the image. The background blends linearly with height to `background_high`."""
    background_high: wp.vec3


@wp.struct
class Received:
    """Visibility of the light and the sky from N points."""

    shadows: bool
    in_shadow: wp.array(dtype=wp.bool)
    """(N,) if `shadows`."""
    ambient_samples: int
    """Ambient rays per point; 0: the whole sky reaches every point."""
    open_rays: wp.array(dtype=int)
    """(N,) number of ambient rays that are not occluded."""


@exact_kernel
def expose(
    first: int,
    surface: Surface,
    received: Received,
    lighting: Lighting,
    first_pixel: int,
    film: wp.array2d(dtype=wp.vec3),
):
    """Item: a camera ray. Adds its linear colour to its pixel."""
    i = first + wp.tid()
    row = (first_pixel + i) / film.shape[1]
    column = (first_pixel + i) % film.shape[1]
    height = 1.0 - (float(row) + 0.5) / float(film.shape[0])
    color = lighting.background_low + height * (lighting.background_high - lighting.background_low)
    if wp.length_sq(surface.face_normal[i]) > 0.0:
        direct = surface.cosine[i]
        if received.shadows:  # noqa: SIM102 - in a kernel, `and` evaluates both sides, and the array may be missing
            if received.in_shadow[i]:
                direct = 0.0
        openness = float(1.0)
        if received.ambient_samples > 0:
            openness = float(received.open_rays[i]) / float(received.ambient_samples)
        color = wp.cw_mul(surface.albedo[i], direct * lighting.light + openness * lighting.ambient)
    film[row, column] += color


@wp.func
def display(linear: float):
    """Linear to sRGB, clipped to [0, 1]."""
    x = wp.clamp(linear, 0.0, 1.0)
    result = float(1.0)  # rounding must not dim white
    if x < 1.0:
        result = 1.055 * wp.pow(x, 1.0 / 2.4) - 0.055
    if x <= 0.0031308:
        result = 12.92 * x
    return result


@exact_kernel
def develop(first: int, film: wp.array(dtype=wp.vec3), samples: int, image: wp.array(dtype=wp.vec3)):
    """Item: a pixel. Writes the display colour of the mean of its samples."""
    i = first + wp.tid()
    mean = film[i] / float(samples)
    image[i] = wp.vec3(display(mean[0]), display(mean[1]), display(mean[2]))
