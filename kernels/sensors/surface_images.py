"""Images of a camera beside what its rays measure: colours of surfaces, optical flow, and rays for integrators."""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.camera_images import Images
from wrt.kernels.sensors.lenses import Lens, project, unproject
from wrt.kernels.sensors.lidar_beams import Beams, beam_at
from wrt.kernels.sensors.lidar_returns import Traced
from wrt.kernels.sensors.pose_paths import PosePath, pose_of
from wrt.kernels.shading.shading_point import shading_point
from wrt.kernels.shading.wavefront.camera_rays import CameraModel, filter_offset
from wrt.kernels.shading.wavefront.pixel_samples import FILTER, PixelSamples, pixel_hash, pixel_point
from wrt.kernels.shading.wavefront.ray_queue import RayQueue, Wave, pixel_of
from wrt.kernels.shading.wavefront.scene_light import LitScene, material_at_point


@exact_kernel
def fill_albedo(
    first: int,
    beams: Beams,
    traced: Traced,
    uv: wp.array(dtype=wp.vec2),
    scene: LitScene,
    albedo: wp.array(dtype=wp.vec3),
):
    """Writes the colour of the surface, linear; 0 for a miss. Item: a ray, in the order of tracing."""
    i = first + wp.tid()
    color = wp.vec3()
    if traced.primitive[i] >= 0:
        point = shading_point(scene.shaded, traced.primitive[i], uv[i], traced.directions[i])
        material = material_at_point(scene, point)
        color = material.color
    albedo[beam_at(beams, traced.place + i)] = color


@wp.struct
class Later:
    """Where everything is some time after the exposure."""

    duration: wp.float64
    carried: wp.array(dtype=int)
    """(I,) place of each instance in `carries`; -1 for those at rest."""
    carries: wp.array(dtype=wp.mat44d)
    """(M,) from where a body is at the exposure to where it will be."""


@exact_kernel
def fill_flow(
    first: int,
    beams: Beams,
    path: PosePath,
    place: int,
    lens: Lens,
    columns: int,
    images: Images,
    later: Later,
    flow: wp.array(dtype=wp.vec2),
):
    """Writes the motion of a surface point in the image, in pixels; NaN for a miss, and where it leaves the lens's view.

    Item: a ray, in the order of tracing.
    """
    pixel = beam_at(beams, place + first + wp.tid())
    moved = wp.vec2(wp.nan, wp.nan)
    instance = images.instance[pixel]
    if instance >= 0:
        own = pixel % beams.directions.shape[0]
        point = images.position[pixel]
        if later.carried.shape[0] > 0:
            body = later.carried[instance]
            if body >= 0:
                point = wp.transform_point(later.carries[body], point)
        pose = pose_of(path, pixel / beams.directions.shape[0], beams.start + beams.times[own] + later.duration)
        seen = project(lens, wp.quat_rotate_inv(pose.rotation, point - pose.position))
        here = wp.vec2d(wp.float64(own % columns), wp.float64(own / columns))
        moved = wp.vec2(seen - here)
    flow[pixel] = moved


@exact_kernel
def start_lens_rays(
    first: int,
    lens: Lens,
    path: PosePath,
    start: wp.float64,
    line_delay: wp.float64,
    camera: CameraModel,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
):
    """Replaces the camera rays of `wrt.kernels.shading.wavefront.camera_rays` by those through a lens. Item: a sample.

    A place without a ray looks along the axis with weight 0, and stays black.
    """
    i = first + wp.tid()
    pixel = pixel_of(wave, i)
    place = wp.vec2()
    if not camera.at_center:
        sample = wave.first_sample + i % wave.samples
        place = filter_offset(camera.filter, pixel_point(source, pixel_hash(source, pixel), sample, FILTER))
    row = pixel / camera.view.width
    at = wp.vec2d(wp.float64(pixel % camera.view.width) + wp.float64(place[0]), wp.float64(row) + wp.float64(place[1]))
    ray = unproject(lens, at)
    pose = pose_of(path, 0, start + line_delay * wp.float64(row))
    if ray.direction[0] == ray.direction[0]:
        queue.direction[i] = wp.vec3(wp.quat_rotate(pose.rotation, ray.direction))
        queue.origin[i] = wp.vec3(pose.position + wp.quat_rotate(pose.rotation, ray.origin) - camera.center)
    else:
        queue.direction[i] = wp.vec3(wp.quat_rotate(pose.rotation, wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))))
        queue.origin[i] = wp.vec3(pose.position - camera.center)
        queue.weight[i] = wp.vec3()
