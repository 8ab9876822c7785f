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

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "BrownConrady": "wrt.sensors.lens_models",
    "Camera": "wrt.sensors.image_sensor",
    "CameraImages": "wrt.sensors.outputs.captured_images",
    "DoubleSphere": "wrt.sensors.lens_models",
    "Equirectangular": "wrt.sensors.lens_models",
    "FTheta": "wrt.sensors.lens_models",
    "KannalaBrandt": "wrt.sensors.lens_models",
    "LIDARS": "wrt.sensors.lidar_presets",
    "LensModel": "wrt.sensors.lens_models",
    "Lidar": "wrt.sensors.lidar",
    "LidarPattern": "wrt.sensors.lidar_pattern",
    "LidarScan": "wrt.sensors.lidar_scan",
    "Orthographic": "wrt.sensors.lens_models",
    "PointCloud": "wrt.clouds.point_cloud",
    "POINT_TYPE": "wrt.sensors.lidar_scan",
    "Rig": "wrt.sensors.rigs.rig",
    "Trajectory": "wrt.sensors.trajectory",
    "deskew": "wrt.sensors.trajectory",
    "look_at": "wrt.sensors.camera_poses",
    "pose_from_extrinsics": "wrt.sensors.camera_poses",
    "pose_from_opengl": "wrt.sensors.camera_poses",
    "read_points": "wrt.sensors.files.point_reading",
    "write_bag": "wrt.sensors.files.bag_files",
    "write_points": "wrt.sensors.files.point_files",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
