"""Images of a camera: from the hits of its rays to distance, depth, normals and ids, each when it is asked for."""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, hit_normal
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.lidar_beams import Beams, beam_at, place_of
from wrt.kernels.sensors.lidar_returns import Traced
from wrt.kernels.sensors.pose_paths import PosePath, pose_of
from wrt.kernels.sensors.surface_ids import SurfaceIds, surface_ids, write_ids


@wp.struct
class Images:
    """Images, pixel by pixel, row by row; (0,) for those that are not asked for."""

    distance: wp.array(dtype=float)
    depth: wp.array(dtype=float)
    position: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3)
    camera_normal: wp.array(dtype=wp.vec3)
    instance: wp.array(dtype=int)
    geometry: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    semantic: wp.array(dtype=int)


BEAMS = "const int* order = beams.order.shape[0] > 0 ? beams.order.data : nullptr;"


@native.func_native(
    "sensor_rays.h",
    f"""{BEAMS}
    wrt::write_depths(
        traced.t.data, traced.primitive.data, beams.directions.data, order, traced.place, beams.directions.shape[0], miss,
        begin, end, images.distance.data, images.depth.data);""",
)
def write_depths(beams: Beams, traced: Traced, miss: float, images: Images, begin: int, end: int):
    """Writes distance and depth of the pixels of rays begin .. end - 1, those that are asked for."""


@native.func_native(
    "sensor_rays.h",
    f"""{BEAMS}
    wrt::write_positions(
        traced.t.data, traced.primitive.data, traced.directions.data, origins.data, origins.shape[0] == 1, order, traced.place,
        begin, end, images.position.data);""",
)
def write_positions(beams: Beams, traced: Traced, origins: wp.array(dtype=wp.vec3d), images: Images, begin: int, end: int):
    """Writes the points that the pixels of rays begin .. end - 1 see."""


@exact_kernel
def fill_depths(first: int, block: int, count: int, beams: Beams, traced: Traced, miss: float, images: Images):
    """Writes distance and depth of pixels. Item: a block of rays, in the order of tracing."""
    begin = (first + wp.tid()) * block
    write_depths(beams, traced, miss, images, begin, wp.min(begin + block, count))


@exact_kernel
def fill_positions(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    traced: Traced,
    origins: wp.array(dtype=wp.vec3d),
    images: Images,
):
    """Writes the points that pixels see. Item: a block of rays, in the order of tracing."""
    begin = (first + wp.tid()) * block
    write_positions(beams, traced, origins, images, begin, wp.min(begin + block, count))


@exact_kernel
def fill_image_normals(
    first: int, block: int, count: int, beams: Beams, path: PosePath, traced: Traced, mesh: SceneMesh, images: Images
):
    """Writes the normals of pixels. Item: a block of rays, in the order of tracing."""
    begin = (first + wp.tid()) * block
    before = int(-1)
    normal = wp.vec3()
    for i in range(begin, wp.min(begin + block, count)):
        pixel = beam_at(beams, traced.place + i)
        primitive = traced.primitive[i]
        if primitive != before:  # neighbours often see one triangle
            normal = hit_normal(mesh, primitive)
            before = primitive
        if pixel < images.normal.shape[0]:
            images.normal[pixel] = normal
        if pixel < images.camera_normal.shape[0]:
            turned = wp.vec3()
            if primitive >= 0:
                place = place_of(beams, pixel)
                pose = pose_of(path, place.sensor, beams.start + beams.times[place.beam])
                turned = wp.vec3(wp.quat_rotate_inv(pose.rotation, wp.vec3d(normal)))
            images.camera_normal[pixel] = turned


@exact_kernel
def fill_image_ids(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    traced: Traced,
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    images: Images,
):
    """Writes what pixels see. Item: a block of rays, in the order of tracing. `labels`: (I,) of each instance, or (0,)."""
    begin = (first + wp.tid()) * block
    ids = SurfaceIds()
    for i in range(begin, wp.min(begin + block, count)):
        pixel = beam_at(beams, traced.place + i)
        ids = surface_ids(mesh, ids, traced.primitive[i])
        write_ids(images, pixel, labels, ids)
