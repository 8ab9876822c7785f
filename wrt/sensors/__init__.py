"""Sensors: lidars with beams of their own time, and cameras with lenses, in scenes that move.

    lidar = wrt.sensors.Lidar.preset("ouster_os1_64")
    scan = lidar.scan(scene, trajectory, time=0.0, motions={3: body}, slices=16, seed=1)
    scan.range, scan.point, scan.position, scan.intensity, scan.instance_id, scan.radial_velocity
    scan.deskewed(), scan.to_structured()

    lens = wrt.sensors.BrownConrady.from_matrix(K, distortion)
    images = wrt.sensors.Camera(1280, 720, lens, line_delay=2e-5).capture(scene, trajectory)
    images.depth, images.distance, images.normal, images.instance_id

**Frames.** The world is that of the scene. A lidar looks along x; y points to the left and z up (REP 103). Units are metres,
seconds and radians where nothing else is said. A camera looks along z of its optical
frame; x points to the right and y down, in the image, too (OpenCV). A pose maps the sensor's frame to the world.
"""

from wrt.sensors.files.bag_files import write_bag
from wrt.sensors.files.point_files import write_points
from wrt.sensors.image_sensor import Camera, CameraImages, look_at, pose_from_extrinsics
from wrt.sensors.lens_models import (
    BrownConrady,
    DoubleSphere,
    Equirectangular,
    FTheta,
    KannalaBrandt,
    LensModel,
    Orthographic,
)
from wrt.sensors.lidar import Lidar
from wrt.sensors.lidar_pattern import LidarPattern
from wrt.sensors.lidar_presets import LIDARS
from wrt.sensors.lidar_scan import POINT_TYPE, LidarScan
from wrt.sensors.trajectory import Trajectory, deskew

__all__ = [
    "LIDARS",
    "POINT_TYPE",
    "BrownConrady",
    "Camera",
    "CameraImages",
    "DoubleSphere",
    "Equirectangular",
    "FTheta",
    "KannalaBrandt",
    "LensModel",
    "Lidar",
    "LidarPattern",
    "LidarScan",
    "Orthographic",
    "Trajectory",
    "deskew",
    "look_at",
    "pose_from_extrinsics",
    "write_bag",
    "write_points",
]
