"""What the tests of types and of graph capture call: small scenes, rays, cameras and sensors, each made once."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import warp as wp

import wrt


class Call(NamedTuple):
    """A public callable.

    Attributes:
        name: its qualified name within its module.
        function: called with all of `arguments`, or some of them of another type; what it returns is compared.
        arguments: a valid value of each argument to try.
    """

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Any]


@cache
def mesh() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=2)


@cache
def scene() -> wrt.Scene:
    return wrt.Scene(mesh(), device="cpu")


@cache
def instances() -> wrt.Scene:
    return wrt.Scene([wrt.Instance(mesh()), wrt.Instance(mesh())], device="cpu")


@cache
def rays() -> tuple[np.ndarray, np.ndarray]:
    origins = mesh().center + mesh().extent * np.random.default_rng(0).normal(size=(8, 3))
    return origins.astype(np.float32), (mesh().center - origins).astype(np.float32)


@cache
def hits() -> wrt.Hits:
    return scene().intersect(*rays())


@cache
def area() -> wrt.known_rays.PlaneInfluenceArea:
    return wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=20, height=20, depth=20)


@cache
def known_scene() -> wrt.Scene:
    return wrt.Scene(mesh(), wrt.known_rays.RayAwareBvh(areas=[area()]), device="cpu")


@cache
def open3d() -> wrt.compat.RaycastingScene:
    caster = wrt.compat.RaycastingScene(device="cpu")
    caster.add_triangles(mesh().vertices, mesh().faces)
    return caster


@cache
def trimesh_rays() -> wrt.compat.RayMeshIntersector:
    return wrt.compat.RayMeshIntersector(trimesh.Trimesh(mesh().vertices, mesh().faces, process=False), device="cpu")


@cache
def pinhole() -> wrt.PinholeCamera:
    return wrt.PinholeCamera(4, 3, position=(0, -9, 4), look_at=(0, 0, 1))


@cache
def rendering() -> wrt.pictures.Rendering:
    return wrt.pictures.Rendering(scene(), pinhole(), samples=2).advance(1)


@cache
def area_light() -> wrt.lights.AreaLightVisibility:
    return wrt.lights.AreaLightVisibility.rectangle(scene(), (0, 0, 9), (1, 0, 0), (0, 1, 0))


@cache
def skeleton() -> wrt.moving.Skeleton:
    return wrt.moving.Skeleton([-1], [(0, 0, 0)], [[(-10, 10)] * 3])


@cache
def cloth() -> wrt.scenes.Animation:
    return wrt.scenes.waving_cloth(frames=2, cells=1)


@cache
def fuzzy() -> wrt.moving.FuzzyScene:
    return wrt.moving.FuzzyScene(cloth().frames, cloth().faces, clusters=1, device="cpu")


@cache
def pattern() -> wrt.sensors.LidarPattern:
    return wrt.sensors.LidarPattern.raster(1, 2, horizontal=4, vertical=0)


@cache
def lidar() -> wrt.sensors.Lidar:
    return wrt.sensors.Lidar(pattern=pattern(), range_noise=0.25)


@cache
def camera() -> wrt.sensors.Camera:
    return wrt.sensors.Camera(4, 3, wrt.sensors.BrownConrady(4, 4, 2, 1))


@cache
def pose() -> np.ndarray:
    return wrt.sensors.look_at((0, -9, 4), (0, 0, 1))


@cache
def trajectory() -> wrt.sensors.Trajectory:
    return wrt.sensors.Trajectory([0, 8], [(0, 0, 0), (1, 0, 0)])


@cache
def folder() -> Path:
    """With a saved scene, a scene of parts and a mesh."""
    path = Path(tempfile.mkdtemp())
    scene().save(path / "scene.npz")
    mesh().save(path / "mesh.ply")
    wrt.disk.PartitionedScene.build(mesh(), path / "parts", device="cpu")
    return path


@cache
def parts() -> wrt.disk.PartitionedScene:
    return wrt.disk.PartitionedScene(folder() / "parts", device="cpu")


AIM = {"position": (0.0, 0.0, 9.0), "direction": (0.0, 0.0, -1.0), "up": (0.0, 1.0, 0.0)}


def seen(found: Any) -> list[np.ndarray]:
    """What a scan, an image or a batch of hits holds."""
    names = ("t", "primitive_id", "uv", "range", "intensity", "distance", "albedo", "flow", "position")
    values = [getattr(found, name, None) for name in names]
    return [value.numpy() if isinstance(value, wp.array) else value for value in values if value is not None]
