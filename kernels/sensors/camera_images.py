"""Images of a camera: from the hits of its rays to distance, depth, normals and ids, each when it is asked for."""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, hit_normal
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.lidar_beams import Beams, beam_at, place_of
from wrt.kernels.sensors.lidar_returns import Traced
from wrt.kernels.sensors.pose_paths import PosePath, pose_of
from wrt.kernels.sensors.surface_ids import SurfaceIds, label_of, surface_ids


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


@native.func_native(
    "sensor_rays.h",
    """wrt::write_ids(
        mesh, labels, traced.primitive.data, nullptr, begin, end, traced.place,
        {images.instance.data, images.geometry.data, images.primitive.data, images.semantic.data});""",
)
def write_ids(traced: Traced, mesh: SceneMesh, labels: wp.array(dtype=int), images: Images, begin: int, end: int):
    """Writes what the pixels of rays begin .. end - 1 see, those images that are asked for; not by an order."""


@wp.func
def ids_by_order(
    beams: Beams, traced: Traced, mesh: SceneMesh, labels: wp.array(dtype=int), images: Images, begin: int, end: int
):
    """Writes what the pixels of rays begin .. end - 1 see, in the order of tracing."""
    ids = SurfaceIds()
    for i in range(begin, end):
        pixel = beam_at(beams, traced.place + i)
        ids = surface_ids(mesh, ids, traced.primitive[i])
        if pixel < images.instance.shape[0]:
            images.instance[pixel] = ids.instance
        if pixel < images.geometry.shape[0]:
            images.geometry[pixel] = ids.geometry
        if pixel < images.primitive.shape[0]:
            images.primitive[pixel] = ids.primitive
        if pixel < images.semantic.shape[0]:
            images.semantic[pixel] = label_of(labels, ids)


@exact_kernel
def fill_images(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    traced: Traced,
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    origins: wp.array(dtype=wp.vec3d),
    miss: float,
    images: Images,
):
    """Writes distance, depth, points and what is seen, those images that are asked for.

    Item: a block of rays, in the order of tracing. `labels`: (I,) of each instance, or (0,).
    """
    begin = (first + wp.tid()) * block
    end = wp.min(begin + block, count)
    if images.distance.shape[0] + images.depth.shape[0] > 0:
        write_depths(beams, traced, miss, images, begin, end)
    if images.position.shape[0] > 0:
        write_positions(beams, traced, origins, images, begin, end)
    if images.instance.shape[0] + images.geometry.shape[0] + images.primitive.shape[0] + images.semantic.shape[0] > 0:
        if beams.order.shape[0] == 0:
            write_ids(traced, mesh, labels, images, begin, end)
        else:
            ids_by_order(beams, traced, mesh, labels, images, begin, end)


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
