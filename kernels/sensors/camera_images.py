"""Images of a camera: from the hits of its rays to distance, depth, normals and ids."""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of, hit_normal
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.sensors.lidar_beams import Beams, beam_at
from wrt.kernels.sensors.lidar_returns import Traced
from wrt.kernels.sensors.pose_paths import PosePath, pose_of

exact_module(__name__)


@wp.struct
class Images:
    """Images, pixel by pixel, row by row."""

    distance: wp.array(dtype=float)
    depth: wp.array(dtype=float)
    position: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3)
    camera_normal: wp.array(dtype=wp.vec3)
    instance: wp.array(dtype=int)
    geometry: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    semantic: wp.array(dtype=int)


@wp.kernel
def fill_images(
    first: int,
    beams: Beams,
    path: PosePath,
    traced: Traced,
    origins: wp.array(dtype=wp.vec3d),
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    miss: float,
    images: Images,
):
    """Writes a pixel of all images. Item: a ray, in the order of tracing. `labels`: (I,) of each instance, or (0,)."""
    i = first + wp.tid()
    pixel = beam_at(beams, traced.place + i)
    primitive = traced.primitive[i]
    normal = hit_normal(mesh, primitive)
    nan = wp.float64(wp.nan)
    distance = float(miss)
    depth = float(miss)
    point = wp.vec3d(nan, nan, nan)
    turned = wp.vec3()
    instance = int(-1)
    geometry = int(-1)
    local = int(-1)
    semantic = int(-1)
    if primitive >= 0:
        own = pixel % beams.directions.shape[0]
        pose = pose_of(path, pixel / beams.directions.shape[0], beams.start + beams.times[own])
        distance = traced.t[i]
        depth = distance * beams.directions[own][2]
        origin = origins[0]
        if origins.shape[0] > 1:
            origin = origins[i]
        point = origin + wp.float64(distance) * wp.vec3d(traced.directions[i])
        turned = wp.vec3(wp.quat_rotate_inv(pose.rotation, wp.vec3d(normal)))
        instance = geometry_of(mesh, primitive)
        geometry = instance
        if mesh.placements.shape[0] > 0:
            geometry = mesh.placements[instance].geometry
        local = primitive - mesh.geometry_first[instance]
        if labels.shape[0] > 0:
            semantic = labels[instance]
    images.distance[pixel] = distance
    images.depth[pixel] = depth
    images.position[pixel] = point
    images.normal[pixel] = normal
    images.camera_normal[pixel] = turned
    images.instance[pixel] = instance
    images.geometry[pixel] = geometry
    images.primitive[pixel] = local
    images.semantic[pixel] = semantic
