# Written by `python -m tests.typed.stubs` from the table of names in wrt/sensors/__init__.py.
from wrt.clouds.point_cloud import PointCloud as PointCloud
from wrt.sensors.camera_poses import look_at as look_at
from wrt.sensors.camera_poses import pose_from_extrinsics as pose_from_extrinsics
from wrt.sensors.camera_poses import pose_from_opengl as pose_from_opengl
from wrt.sensors.files.bag_files import write_bag as write_bag
from wrt.sensors.files.point_files import write_points as write_points
from wrt.sensors.files.point_reading import read_points as read_points
from wrt.sensors.image_sensor import Camera as Camera
from wrt.sensors.lens_models import BrownConrady as BrownConrady
from wrt.sensors.lens_models import DoubleSphere as DoubleSphere
from wrt.sensors.lens_models import Equirectangular as Equirectangular
from wrt.sensors.lens_models import FTheta as FTheta
from wrt.sensors.lens_models import KannalaBrandt as KannalaBrandt
from wrt.sensors.lens_models import LensModel as LensModel
from wrt.sensors.lens_models import Orthographic as Orthographic
from wrt.sensors.lidar import Lidar as Lidar
from wrt.sensors.lidar_pattern import LidarPattern as LidarPattern
from wrt.sensors.lidar_presets import LIDARS as LIDARS
from wrt.sensors.lidar_scan import POINT_TYPE as POINT_TYPE
from wrt.sensors.lidar_scan import LidarScan as LidarScan
from wrt.sensors.outputs.captured_images import CameraImages as CameraImages
from wrt.sensors.rigs.rig import Rig as Rig
from wrt.sensors.trajectory import Trajectory as Trajectory
from wrt.sensors.trajectory import deskew as deskew

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
    "PointCloud",
    "Rig",
    "Trajectory",
    "deskew",
    "look_at",
    "pose_from_extrinsics",
    "pose_from_opengl",
    "read_points",
    "write_bag",
    "write_points",
]
