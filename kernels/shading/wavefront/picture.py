"""From samples to pictures: the film, its noise, layers of the first hits, and tone mapping.

The film holds, for each pixel, the sum of its samples' radiance, and of the squares of their luminance. The mean's standard
error follows from both.

References: reinhard-2002; narkowicz-2016 (a fit to the curve of the Academy).
"""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.bsdf.scattering import luminance
from wrt.kernels.shading.film import display
from wrt.kernels.shading.shading_point import shading_point
from wrt.kernels.shading.wavefront.ray_queue import RayQueue, Wave, pixel_of
from wrt.kernels.shading.wavefront.scene_light import LitScene, material_at_point

TONE_MAPPINGS = ("linear", "srgb", "reinhard", "aces")
LINEAR, SRGB, REINHARD, ACES = (wp.constant(number) for number in range(4))


@native.func_native("ray_queues.h", "wrt::add_samples(radiance.data + first, samples, limit, total, squares);")
def add_samples(
    radiance: wp.array(dtype=wp.vec3),
    first: int,
    samples: int,
    limit: float,
    total: wp.ref[wp.vec3],
    squares: wp.ref[float],
):
    """Adds samples from number `first` on to a sum, and the squares of their luminance to another."""


@wp.struct
class Film:
    """What pixels have collected so far."""

    sums: wp.array(dtype=wp.vec3)
    """(P,) sums of the samples' radiance."""
    squares: wp.array(dtype=float)
    """(P,) sums of the squares of their luminance."""
    limit: float
    """Greatest component of a sample; larger ones are dimmed to it."""


@wp.func
def develop_pixel(wave: Wave, i: int, radiance: wp.array(dtype=wp.vec3), film: Film):
    """Adds the samples of pixel i of a wave to it, in order."""
    pixel = wave.order[wave.first_pixel + i]
    total = wp.vec3(film.sums[pixel])
    square = float(film.squares[pixel])
    add_samples(radiance, i * wave.samples, wave.samples, film.limit, total, square)
    film.sums[pixel] = total
    film.squares[pixel] = square


@exact_kernel
def develop_wave(first: int, wave: Wave, radiance: wp.array(dtype=wp.vec3), film: Film):
    """Adds the samples of a wave to their pixel. Item: a pixel of the wave."""
    develop_pixel(wave, first + wp.tid(), radiance, film)


@exact_kernel
def mean_of_samples(first: int, film: wp.array(dtype=wp.vec3), samples: int, mean: wp.array(dtype=wp.vec3)):
    """Writes the mean of a pixel's samples. Item: a pixel."""
    i = first + wp.tid()
    mean[i] = film[i] / float(samples)


@exact_kernel
def standard_errors(
    first: int, film: wp.array(dtype=wp.vec3), squares: wp.array(dtype=float), samples: int, errors: wp.array(dtype=float)
):
    """Writes the standard error of the luminance of a pixel's mean. Item: a pixel."""
    i = first + wp.tid()
    count = float(samples)
    mean = luminance(film[i]) / count
    variance = wp.max(0.0, squares[i] / count - mean * mean)
    errors[i] = wp.sqrt(variance / wp.max(count - 1.0, 1.0))


@wp.func
def toned(x: float, mapping: int):
    """A linear value for display in sRGB."""
    result = x
    if mapping == SRGB:
        result = display(x)
    if mapping == REINHARD:
        result = display(x / (1.0 + x))
    if mapping == ACES:
        result = display(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))
    return result


@exact_kernel
def map_tones(
    first: int,
    film: wp.array(dtype=wp.vec3),
    samples: int,
    exposure: float,
    mapping: int,
    image: wp.array(dtype=wp.vec3),
):
    """Writes the colour for display of the mean of a pixel's samples. Item: a pixel."""
    i = first + wp.tid()
    value = exposure * (film[i] / float(samples))
    image[i] = wp.vec3(toned(value[0], mapping), toned(value[1], mapping), toned(value[2], mapping))


@wp.struct
class Layers:
    """What the first sample of each pixel sees."""

    depth: wp.array(dtype=float)
    """(P,) distances along the rays; inf for a miss."""
    normal: wp.array(dtype=wp.vec3)
    albedo: wp.array(dtype=wp.vec3)
    primitive_id: wp.array(dtype=int)
    geometry_id: wp.array(dtype=int)
    instance_id: wp.array(dtype=int)
    material_id: wp.array(dtype=int)


@wp.func
def geometry_in(mesh: SceneMesh, instance: int):
    """Index of the geometry of an instance, or the same number in a scene without instances."""
    geometry = int(instance)
    if mesh.placements.shape[0] > 0:
        geometry = mesh.placements[instance].geometry
    return geometry


@exact_kernel
def write_layers(first: int, start: int, scene: LitScene, wave: Wave, queue: RayQueue, hits: HitBatch, layers: Layers):
    """Writes what a camera ray sees. Item: a ray of a wave of one sample a pixel, from `start` on."""
    i = start + first + wp.tid()
    pixel = pixel_of(wave, i)
    primitive = hits.primitive[i]
    normal = wp.vec3()
    albedo = wp.vec3()
    instance = int(-1)
    geometry = int(-1)
    local = int(-1)
    number = int(-1)
    if primitive >= 0:
        point = shading_point(scene.shaded, primitive, hits.uv[i], queue.direction[i])
        material = material_at_point(scene, point)
        normal = point.normal
        albedo = material.color
        mesh = scene.shaded.mesh
        instance = geometry_of(mesh, primitive)
        geometry = geometry_in(mesh, instance)
        local = primitive - mesh.geometry_first[instance]
        number = material.number
    layers.depth[pixel] = hits.t[i]
    layers.normal[pixel] = normal
    layers.albedo[pixel] = albedo
    layers.primitive_id[pixel] = local
    layers.geometry_id[pixel] = geometry
    layers.instance_id[pixel] = instance
    layers.material_id[pixel] = number
