"""Camera rays: through a pixel filter and, for depth of field, a thin lens.

**Filter.** A sample's place is drawn with a density proportional to the filter, so that the mean of the samples is the filtered
picture (Shirley 1991). The box has the width of a pixel. The tent is two pixels wide. The Gaussian has a standard deviation of
half a pixel and ends at 1.5.

**Thin lens.** Rays from all points of a lens meet in the plane of focus, which is orthogonal to the viewing direction. A point
at depth z is a disc in that plane, of radius r |z - f| / z for a lens of radius r focused at f (Potmesil and Chakravarty 1981,
Cook 1984). The lens is a disc; the map from the square keeps areas (Shirley and Chiu 1997).

References: potmesil-chakravarty-1981; cook-1984; shirley-1991; shirley-chiu-1997.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.pixel_rays import View
from wrt.kernels.shading.wavefront.lane_code import in_lanes, same
from wrt.kernels.shading.wavefront.pixel_samples import FILTER, LENS, RANDOM, SOBOL, PixelSamples, pixel_hash, pixel_point
from wrt.kernels.shading.wavefront.ray_queue import RayQueue, Wave, pixel_of

FILTERS = ("box", "tent", "gaussian")
BOX, TENT, GAUSSIAN = (wp.constant(number) for number in range(3))

GAUSSIAN_END = wp.constant(0.011108996538242306)
"""exp(-1.5^2 / (2 0.5^2)): what a Gaussian filter cuts off."""


@wp.struct
class CameraModel:
    """A camera with a lens and a pixel filter."""

    view: View
    center: wp.vec3d
    """The scene's; rays are relative to it."""
    is_perspective: bool
    filter: int
    at_center: bool
    """Whether all rays pass through the pixel's centre: one sample, and a box filter."""
    lens_right: wp.vec3d
    """Radius of the lens, in scene units, along the image's axes; 0 for a pinhole."""
    lens_up: wp.vec3d
    focus: wp.float64
    """Distance from the lens to the plane of focus, along the viewing direction."""


@wp.func
def tent(x: float):
    """Maps [0, 1) to (-1, 1) with a density that falls linearly from 0."""
    result = wp.sqrt(2.0 * wp.min(x, 0.5)) - 1.0
    if x >= 0.5:
        result = 1.0 - wp.sqrt(2.0 - 2.0 * x)
    return result


@wp.func
def filter_offset(filter: int, point: wp.vec2):
    """Place of a sample relative to the pixel's centre, in pixels."""
    result = point - wp.vec2(0.5, 0.5)
    if filter == TENT:
        result = wp.vec2(tent(point[0]), tent(point[1]))
    if filter == GAUSSIAN:
        # a Gaussian in the plane by polar coordinates (Box and Muller 1958), cut off at a radius of 1.5
        radius = 0.5 * wp.sqrt(-2.0 * wp.log(1.0 - point[0] * (1.0 - GAUSSIAN_END)))
        angle = 6.283185307179586 * point[1]
        result = radius * wp.vec2(wp.cos(angle), wp.sin(angle))
    return result


@wp.func
def on_disc(point: wp.vec2):
    """Maps [0, 1)^2 to the unit disc, areas to areas, squares to rings (Shirley and Chiu 1997)."""
    x = 2.0 * point[0] - 1.0
    y = 2.0 * point[1] - 1.0
    result = wp.vec2()
    if wp.abs(x) > wp.abs(y):
        angle = 0.7853981633974483 * y / x
        result = x * wp.vec2(wp.cos(angle), wp.sin(angle))
    elif wp.abs(y) > 0.0:
        angle = 1.5707963267948966 - 0.7853981633974483 * x / y
        result = y * wp.vec2(wp.cos(angle), wp.sin(angle))
    return result


@wp.func
def start_ray(
    i: int,
    camera: CameraModel,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    radiance: wp.array(dtype=wp.vec3),
):
    """Writes the camera ray of sample i, and clears its radiance."""
    pixel = pixel_of(wave, i)
    sample = wave.first_sample + i % wave.samples
    own = pixel_hash(source, pixel)
    place = wp.vec2()
    if not camera.at_center:
        place = filter_offset(camera.filter, pixel_point(source, own, sample, FILTER))
    one = wp.float64(1.0)
    half = wp.float64(0.5)
    two = wp.float64(2.0)
    column = wp.float64(pixel % camera.view.width) + half + wp.float64(place[0])
    row = wp.float64(pixel / camera.view.width) + half + wp.float64(place[1])
    x = two * column / wp.float64(camera.view.width) - one
    y = one - two * row / wp.float64(camera.view.height)
    on_picture = x * camera.view.right + y * camera.view.up
    origin = camera.view.position - camera.center
    direction = camera.view.forward
    if camera.is_perspective:
        direction = direction + on_picture
        if wp.length_sq(camera.lens_right) > wp.float64(0.0):
            lens = on_disc(pixel_point(source, own, sample, LENS))
            shift = wp.float64(lens[0]) * camera.lens_right + wp.float64(lens[1]) * camera.lens_up
            origin = origin + shift
            direction = camera.focus * direction - shift
    else:
        origin = origin + on_picture
    queue.origin[i] = wp.vec3(origin)
    queue.direction[i] = wp.vec3(wp.normalize(direction))
    queue.weight[i] = wp.vec3(1.0, 1.0, 1.0)
    queue.density[i] = 0.0
    queue.slot[i] = i
    queue.media[i] = wp.uint64(0)
    radiance[i] = wp.vec3()


@cache
def make_start_lanes(width: int) -> Any:
    """`start_lanes` for the given number of lanes."""
    call = f"wrt::start_rays<{width}>(first, camera, source, wave, queue, radiance)"

    @native.func_native("camera_rays.h", in_lanes(call, same(BOX=BOX, FILTER=FILTER, SOBOL=SOBOL, RANDOM=RANDOM)))
    def start_lanes(
        first: int,
        camera: CameraModel,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        radiance: wp.array(dtype=wp.vec3),
    ) -> int:
        """`start_ray` for the samples first .. first + width - 1, if the camera is a pinhole with a box filter; returns how
        many are done, none or all. The bits are those of `start_ray`."""

    return start_lanes


WIDTH = wp.constant(lane_width())
start_lanes = make_start_lanes(lane_width())


@exact_kernel
def start_rays(
    first: int,
    stop: int,
    group: int,
    camera: CameraModel,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    radiance: wp.array(dtype=wp.vec3),
):
    """Writes camera rays, and clears the radiance of their samples. Item: a group of the samples 0 .. stop - 1."""
    here = (first + wp.tid()) * group
    end = wp.min(here + group, stop)
    while here < end:
        done = int(0)
        if here + WIDTH <= end:
            done = start_lanes(here, camera, source, wave, queue, radiance)
        if done == 0:
            start_ray(here, camera, source, wave, queue, radiance)
            done = 1
        here += done
