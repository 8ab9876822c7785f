"""Valid arguments of `wrt.sensors`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import wrt
from support.call_objects import Call, camera, instances, lidar, pattern, pose, scene, seen, trajectory

FOCUS = {"fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 1.0}


def sensor_calls() -> Iterator[Call]:
    sensors = wrt.sensors
    ranges = {"min_range": 0.5, "max_range": 40.0, "divergence": 0.5, "range_resolution": 0.5, "range_exponent": 2.0}
    noise = {
        "reference_range": 8.0,
        "extinction": 0.5,
        "threshold": 0.5,
        "range_noise": 0.5,
        "angle_noise": 0.5,
        "dropout": 0.5,
    }
    yield Call("Lidar", lambda **o: sensors.Lidar(pattern=pattern(), **o), {**ranges, **noise, "bundle": 4, "returns": 2})
    scan = {"time": 2.0, "slices": 1, "reflectance": 0.5, "seed": 1, "mask": 1, "environment": 1, "to_warp": False}
    yield Call("Lidar.scan", lambda **o: seen(lidar().scan(instances(), pose(), **o)), scan)
    yield Call("LidarScan.to_structured", lambda **o: lidar().scan(scene(), pose()).to_structured(**o), {"organized": True})
    yield Call("LidarScan.deskewed", lambda **o: lidar().scan(scene(), trajectory()).deskewed(**o), {"time": 2.0})
    raster = {"rows": 2, "columns": 3, "horizontal": 8.0, "vertical": 4.0, "rate": 8.0, "tilt": 2.0}
    yield Call("LidarPattern.raster", lambda **o: drawn(sensors.LidarPattern.raster(**o)), raster)
    rosette = {"count": 4, "half_angle": 8.0, "speeds": (8.0, -4.0), "point_rate": 8.0, "first": 1}
    yield Call("LidarPattern.rosette", lambda **o: drawn(sensors.LidarPattern.rosette(**o)), rosette)
    turning = {"elevations": [0.0, 8.0], "columns": 3, "rate": 8.0, "clockwise": False, "radius": 0.5}
    turning |= {"azimuth_offsets": [0.0, 1.0], "firing_times": [0.0, 0.5]}
    yield Call("LidarPattern.spinning", lambda **o: drawn(sensors.LidarPattern.spinning(**o)), turning)
    yield Call("Camera", lambda **o: sensors.Camera(lens=camera().lens, **o), {"width": 4, "height": 3, "line_delay": 0.5})
    image = {"time": 2.0, "slices": 1, "miss": 64.0, "albedo": True, "flow": 0.5, "to_warp": False, "mask": 1, "environment": 1}
    yield Call("Camera.capture", lambda **o: seen(camera().capture(instances(), pose(), **o)), image)
    yield Call(
        "CameraImages.to_structured",
        lambda **o: camera().capture(scene(), pose(), albedo=True).to_structured(**o),
        {"organized": True},
    )
    yield Call("Camera.render", lambda **o: camera().render(scene(), pose(), samples=1, **o).linear, {"time": 2.0})
    rig = lambda **o: seen(sensors.Rig({"top": (lidar(), np.eye(4))}).measure(instances(), pose(), **o)["top"])  # noqa: E731
    yield Call("Rig.measure", rig, {"time": 2.0, "seed": 1})
    yield Call("BrownConrady", sensors.BrownConrady, {**FOCUS, "distortion": (0.5, 0.0, 0.0, 0.0), "skew": 0.5})
    yield Call("KannalaBrandt", sensors.KannalaBrandt, {**FOCUS, "distortion": (0.5, 0.0), "max_angle": 2.0, "skew": 0.5})
    matrix = [(4.0, 0.5, 2.0), (0.0, 4.0, 1.0), (0.0, 0.0, 1.0)]
    yield Call(
        "BrownConrady.from_matrix", sensors.BrownConrady.from_matrix, {"matrix": matrix, "distortion": (0.5, 0.0, 0.0, 0.0)}
    )
    yield Call("KannalaBrandt.from_matrix", sensors.KannalaBrandt.from_matrix, {"matrix": matrix, "max_angle": 2.0})
    yield Call("DoubleSphere", sensors.DoubleSphere, {**FOCUS, "xi": 0.5, "alpha": 0.5})
    yield Call("Equirectangular", sensors.Equirectangular, {"width": 4, "height": 2})
    yield Call("FTheta", sensors.FTheta, {"cx": 2.0, "cy": 1.0, "coefficients": (4.0, 0.5), "max_angle": 2.0})
    yield Call("Orthographic", sensors.Orthographic, FOCUS)
    points = np.zeros((2, 3))
    yield Call("deskew", lambda **o: sensors.deskew(points, trajectory=trajectory(), **o), {"times": [0.0, 4.0], "time": 2.0})
    three = np.eye(3)
    settings = {"radius": 0.5, "num_threads": 2, "boxes": True}
    yield Call("PointCloud", lambda **o: sensors.PointCloud(three, device="cpu", **o).bounds, settings)
    cloud, ray = sensors.PointCloud(three, 0.5, device="cpu"), ((-2.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    judge = {"brute_force": False}
    yield Call("PointCloud.intersect", lambda **o: cloud.intersect(*ray, **o).t, judge)
    yield Call("PointCloud.occluded", lambda **o: cloud.occluded(*ray, **o), judge)
    yield Call("PointCloud.count", lambda **o: cloud.count(*ray, **o), judge)
    yield Call("PointCloud.intersect_all", lambda **o: cloud.intersect_all(*ray, **o).t, judge | {"max_hits": 2})
    yield Call("look_at", sensors.look_at, {"position": (0.0, -9.0, 4.0), "target": (0.0, 0.0, 1.0), "up": (0.0, 0.0, 1.0)})
    yield Call("Trajectory.at", lambda **o: trajectory().at(**o), {"times": [0.0, 4.0]})
    moving = {"times": [0.0, 8.0], "positions": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]}
    yield Call("Trajectory", lambda **o: sensors.Trajectory(**o).matrices, moving)


def drawn(made: wrt.sensors.LidarPattern) -> tuple[np.ndarray, ...]:
    return made.directions, made.times, made.rings, made.offsets
