"""Mistakes of users: type checkers must find each marked line, and no other; `test_types.py` runs mypy over it."""

from __future__ import annotations

import numpy as np
import warp as wp

import wrt


def mistakes(mesh: wrt.TriangleMesh, scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray, buffer: wp.array) -> None:
    scene.intersect(origins, directions, t_maxx=1.0)  # mistake: call-overload
    scene.occluded(origins, directions, maks=1)  # mistake: call-overload
    scene.intersect(origins)  # mistake: call-overload
    scene.count("origins", directions)  # mistake: call-overload
    scene.intersect(origins, directions, cull_backfaces="yes")  # mistake: call-overload
    scene.explain(origins, directions, query="nearest")  # mistake: arg-type
    scene.explain(origins, directions, samples=1)  # mistake: call-arg
    wrt.Scene(mesh, acelerator="bvh")  # mistake: call-arg
    wrt.Scene(mesh, accelerator="bhv")  # mistake: arg-type
    scene.update(0, vertices=origins, rebuild="sometimes")  # mistake: arg-type
    wrt.pictures.RenderSettings(samples="four")  # mistake: arg-type
    camera = wrt.PinholeCamera(640, 480, position=(0, -3, 1), look_at=(0, 0, 0))
    wrt.render(scene, camera, samples="four")  # mistake: arg-type
    wrt.render(scene, camera, smaples=4)  # mistake: call-arg
    wrt.pictures.Rendering(scene, camera, dept=4)  # mistake: call-arg
    wrt.PinholeCamera(640, 480, position=(0, -3, 1), lookat=(0, 0, 0))  # mistake: call-arg
    wrt.Scenee(mesh)  # mistake: attr-defined
    print(wrt.sensors.Lidarr)  # mistake: attr-defined
    print(wrt.lights.PointLigth)  # mistake: attr-defined
    print(wrt.PointLight)  # mistake: attr-defined
    wrt.lights.PointLight((0, 0, 1), intensiti=1.0)  # mistake: call-arg
    wrt.device.differentiable_hit(scene)  # mistake: attr-defined
    print(scene.device_mesh)  # mistake: attr-defined
    hits = scene.intersect(origins, directions)
    print(hits.nonexistent)  # mistake: attr-defined
    hits.spawn(directions, side="top")  # mistake: call-overload
    hits.t.numpy()  # mistake: attr-defined
    scene.occluded(buffer, buffer).any()  # mistake: attr-defined
    wrt.save_image(3, origins)  # mistake: arg-type
    scene.contains(origins, rule="parrity")  # mistake: call-overload
    scene.closest_point(origins, maxdistance=1.0)  # mistake: call-arg
    scene.closest_point(origins, precise="yes")  # mistake: arg-type
    print(scene.closest_point(origins).distanse)  # mistake: attr-defined
    wrt.analysis.signed_distance(scene, origins, sign="normals")  # mistake: call-overload
    wrt.analysis.distance_grid(scene, 64, sign="normals")  # mistake: arg-type
    wrt.analysis.exposure(scene, hits, directions, wieghts=origins)  # mistake: call-arg
    wrt.analysis.exposure(scene, origins, directions)  # mistake: arg-type
    print(wrt.analysis.exposures)  # mistake: attr-defined
    cloud = wrt.sensors.PointCloud(origins)  # mistake: call-arg
    cloud.intersect(origins, directions, precise=True)  # mistake: call-arg
    cloud.closest_point(origins)  # mistake: attr-defined
    rig = wrt.sensors.Rig([wrt.sensors.Lidar.preset("velodyne_vlp_16")])  # mistake: arg-type
    rig.measure(scene, origins, seed="one")  # mistake: arg-type
    wrt.TriangleMesh.from_heightmap(origins, spaceing=1.0)  # mistake: call-arg
    wrt.PinholeCamera(640, 480, position="front", look_at=(0, 0, 0))  # mistake: arg-type
    wrt.PinholeCamera.framing(mesh, 640, 480, up="z")  # mistake: arg-type
    wrt.lights.PointLight((0, 0, 1), intensity="bright")  # mistake: arg-type
    wrt.analysis.exposure(scene, hits, "sun")  # mistake: arg-type
    wrt.sensors.look_at((0, 0, 1), camera)  # mistake: arg-type
    wrt.Scene("bunny.ply")  # mistake: arg-type
    wrt.Scene(origins)  # mistake: arg-type
    wrt.Instance("bunny.ply", origins)  # mistake: arg-type
    wrt.TriangleMesh("bunny.ply", origins)  # mistake: arg-type
    mesh.transformed("x")  # mistake: arg-type
    scene.move(origins)  # mistake: arg-type
    scene.remove("all")  # mistake: arg-type
    scene.intersect_blocks(origins, directions, executor=4)  # mistake: arg-type
    scene.occluded_blocks(origins, directions, reduce=3)  # mistake: arg-type
    scene.count_blocks(origins, directions, axis="rays")  # mistake: arg-type
    wrt.render(scene, camera, integrator="path", lights=[1.0])  # mistake: list-item
    wrt.render(scene, camera, albedo="red")  # mistake: arg-type
    wrt.pictures.Rendering(scene, camera, materials="glass")  # mistake: arg-type
    wrt.save_image("image.png", scene)  # mistake: arg-type
    lidar = wrt.sensors.Lidar.preset("velodyne_vlp_16")
    lidar.scan(scene, scene)  # mistake: arg-type
    lidar.scan(scene, origins, labels="road")  # mistake: arg-type
    lidar.scan(origins, origins)  # mistake: arg-type
    wrt.sensors.Camera(64, 48, wrt.sensors.Equirectangular(64, 48)).render(scene, origins, smaples=2)  # mistake: call-arg
    wrt.sensors.Trajectory("0", origins)  # mistake: arg-type
    wrt.lights.LightBuffer(scene, (0, 0, 9)).occluded("origins")  # mistake: call-overload
    wrt.lights.Sky("blue")  # mistake: arg-type
    wrt.device.differentiable_hits(scene, hits, origins, directions, mesh)  # mistake: arg-type
    wrt.moving.GroupedScene(mesh, "bhv")  # mistake: arg-type
    wrt.view(origins)  # mistake: arg-type
