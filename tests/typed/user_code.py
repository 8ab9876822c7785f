"""Code of users, as type checkers must let it pass; `test_types.py` runs mypy over it. It is not executed."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
import warp as wp

import wrt

if TYPE_CHECKING:
    from typing_extensions import assert_type


def numpy_in_numpy_out(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray) -> None:
    hits = scene.intersect(origins, directions, t_max=10.0, traversal="single", cull_backfaces=True)
    nearest = hits.t.min() if hits.is_hit.any() else np.inf
    assert_type(hits.position, np.ndarray)
    assert_type(hits.spawn(directions, side="front"), np.ndarray)
    assert_type(scene.occluded(origins, (0.0, 0.0, 1.0), t_max=np.full(len(origins), nearest)), np.ndarray)
    assert_type(scene.count([[0.0, 0.0, 0.0]], [0, 0, 1], skip=hits), np.ndarray)
    assert_type(scene.intersect_all(origins, directions, max_hits=3).offsets, np.ndarray)
    assert_type(scene.contains(origins), np.ndarray)
    assert_type(scene.visible(origins[:, None], origins), np.ndarray)
    assert_type(hits.interpolate(np.ones(10)), np.ndarray)
    print(hits.shape, scene.explain(origins, directions, query="any").traversal, scene.verify(samples=100).ok)


def one_ray(scene: wrt.Scene) -> float:
    hit = scene.intersect([0.0, 0.0, 5.0], [0.0, 0.0, -1.0], precise=True)
    return float(hit.t) if hit.is_hit else float("inf")


def warp_in_warp_out(scene: wrt.Scene, origins: wp.array, directions: wp.array) -> None:
    hits = scene.intersect(origins, directions, mask=1)
    assert_type(hits.t, wp.array)
    assert_type(scene.intersect(origins, np.ones(3)).normal, wp.array)
    assert_type(scene.occluded(hits.spawn(directions), directions), wp.array)
    assert_type(scene.contains(origins), wp.array)
    found = wrt.device.differentiable_hits(scene, hits, origins, directions)
    wp.launch(hits_kernel, dim=hits.t.shape, inputs=[found.t, hits.primitive_id])


@wp.kernel
def hits_kernel(t: wp.array(dtype=float), triangle: wp.array(dtype=int)):  # type: ignore[valid-type]
    pass


class Tensor:
    """Of a library that hands out its arrays by DLPack."""

    def __dlpack__(self, stream: int | None = None) -> Any:
        raise NotImplementedError

    def __dlpack_device__(self) -> tuple[Enum, int]:
        raise NotImplementedError


def other_libraries(scene: wrt.Scene, origins: Tensor, directions: Tensor) -> None:
    assert_type(scene.intersect(origins, directions).t, wp.array)


def rays_in_one_object(scene: wrt.Scene, origins: np.ndarray, buffer: wp.array, unknown: wrt.Rays) -> None:
    assert_type(scene.intersect(wrt.Rays(origins, [0.0, 0.0, 1.0], t_max=5.0)).uv, np.ndarray)
    assert_type(scene.occluded(wrt.Rays(buffer, buffer)), wp.array)
    hits = scene.intersect(unknown)
    print(hits.t.shape, hits.plan)


def scenes(path: str) -> wrt.Scene:
    mesh = wrt.TriangleMesh.load(path)
    scene = wrt.Scene(mesh, accelerator="kdtree", device="cpu", num_threads=2)
    scene.update(0, vertices=mesh.vertices + 1.0, rebuild=wrt.moving.UpdatePolicy(when="never"))
    scene.save("scene.npz")
    forest = wrt.Scene([wrt.Instance(mesh, np.eye(4)), wrt.Instance(mesh, np.eye(4))], wrt.Bvh())
    print(forest.instances[0].mesh.triangle_count, scene.bounds.shape, scene.statistics())
    return wrt.Scene.load("scene.npz", num_threads=None)


def pictures(scene: wrt.Scene) -> None:
    camera = wrt.PinholeCamera(640, 480, position=(0, -3, 1), look_at=(0, 0, 0))
    depth = scene.intersect(camera.rays()).t
    assert_type(depth, np.ndarray)
    settings = wrt.pictures.RenderSettings(samples=4)
    image = wrt.render(scene, camera, integrator="path", settings=settings, depth=4)
    print(wrt.render(scene, camera, samples=2, ambient_distance=None, albedo=(0.5, 0.4, 0.3)).shape)
    wrt.save_image("image.png", image.clip(0.0, 1.0))
    wrt.save_image("linear.exr", wrt.pictures.Rendering(scene, camera, settings=settings).advance(1).linear)


def sensors(scene: wrt.Scene) -> None:
    scan = wrt.sensors.Lidar.preset("ouster_os1_64").scan(scene, np.eye(4), seed=1)
    print(scan.range, scan.to_structured())
    images = wrt.sensors.Camera(64, 48, wrt.sensors.Equirectangular(64, 48)).capture(scene, np.eye(4))
    print(images.depth, wrt.get_num_threads())


def points(scene: wrt.Scene, samples: np.ndarray, buffer: wp.array) -> None:
    near = scene.closest_point(samples, max_distance=np.full(len(samples), 0.5), k=3)
    print(near.distance.max(), near.feature, scene.closest_point(samples, precise=True).position)
    print(scene.within(samples, 0.1).offsets)
    assert_type(scene.contains(samples, rule="union"), np.ndarray)
    assert_type(wrt.analysis.signed_distance(scene, samples, sign="pseudonormal", max_distance=0.1), np.ndarray)
    assert_type(wrt.analysis.signed_distance(scene, buffer), wp.array)
    assert_type(wrt.analysis.winding_number(scene, samples, accuracy=0.01), np.ndarray)
    grid = wrt.analysis.distance_grid(scene, 64, band=0.05, sign=wrt.analysis.sign_rule(scene))
    assert_type(grid.values, np.ndarray)
    pair = wrt.analysis.clearance(scene, [0, 2])
    print(pair.distance, wrt.analysis.overlapping_triangles(scene, 0, 1).shape)
    for rows, found in scene.closest_point_blocks(samples, reduce={"t": "max"}):
        print(rows.start, found)


def light(scene: wrt.Scene, sun: np.ndarray) -> None:
    floor = wrt.analysis.sample_surface(scene, radius=0.5)
    hours = wrt.analysis.exposure(scene, floor, sun, weights=np.full(len(sun), 0.25), cosine=True)
    assert_type(hours, np.ndarray)
    assert_type(wrt.analysis.exposure(scene, scene.points_on([0, 1]), wrt.analysis.sky_directions(64)), np.ndarray)
    print(wrt.analysis.thickness(scene, floor).min(), wrt.analysis.ambient_occlusion(scene, floor, rays=16))


def terrain(heights: np.ndarray) -> wrt.TriangleMesh:
    mesh = wrt.TriangleMesh.from_heightmap(heights, spacing=(2.0, 2.0), origin=(4.5e5, 5.4e6, 0.0))
    seen = wrt.analysis.viewshed(wrt.Scene(mesh), (4.5e5, 5.4e6, 300.0), mesh.vertices)
    assert_type(seen, np.ndarray)
    return mesh


def clouds_and_rigs(scene: wrt.Scene, measured: np.ndarray, on_roof: np.ndarray) -> None:
    cloud = wrt.sensors.PointCloud(measured, radius=0.05, normals=None, device="cpu")
    hits = cloud.intersect(measured, (0.0, 0.0, 1.0), brute_force=True)
    print(hits.primitive_id, cloud.intersect_all(measured, (0, 0, 1), max_hits=2).t, cloud.bounds.shape)
    lidar, camera = wrt.sensors.Lidar.preset("velodyne_vlp_16"), wrt.sensors.Camera(64, 48, wrt.sensors.Equirectangular(64, 48))
    rig = wrt.sensors.Rig({"roof": (lidar, on_roof), "front": (camera, np.eye(4))})
    seen = rig.measure(scene, np.eye(4), seed=1, each={"front": {"layers": ("depth",)}})
    roof = seen["roof"]
    if isinstance(roof, wrt.sensors.LidarScan):
        print(roof.range, lidar.scan(cloud, np.eye(4)).position)


def doors(scene: wrt.Scene, rays: wrt.Rays, path: str) -> None:
    camera = wrt.PinholeCamera(64, 48, position=(0, -3, 1), look_at=(0, 0, 0))
    assert_type(wrt.lights.PointLight((0.0, 0.0, 3.0)), wrt.lights.PointLight)
    assert_type(wrt.known_rays.break_even(scene, rays).unassigned_share, float)
    assert_type(wrt.disk.PartitionedScene(path).occluded(np.zeros(3), [0.0, 0.0, 1.0]), np.ndarray)
    assert_type(wrt.moving.SkinnedScene, type[wrt.moving.SkinnedScene])
    job = wrt.cluster.Job(path, scene.occluded_blocks(rays, reduce={"t": wrt.batches.Histogram(np.arange(3.0))}))
    print(camera, job, wrt.classics.FanScene, wrt.compat.RaycastingScene, wrt.results.Plan, wrt.pictures.draw_tree)


def blocks(scene: wrt.Scene, origins: np.memmap, nearest: np.ndarray) -> None:
    for rows, hits in scene.intersect_blocks(origins, (0.0, 0.0, 1.0), memory="1 GB", progress=True):
        nearest[rows] = hits.t
    scene.occluded_blocks(origins, (0.0, 0.0, 1.0), reduce="sum", axis=0).result()
    with ThreadPoolExecutor(2) as pool:
        spread = scene.intersect_blocks(
            wrt.Rays(origins, origins), executor=pool, reduce={"t": "min", "is_hit": np.sum}, axis=(0, 1)
        )
    generated = wrt.batches.GeneratedRays(lambda first, count: (origins[first : first + count], (0, 0, 1)), 10**6)
    print(
        spread.result(),
        scene.count_blocks(generated, executor=wrt.cluster.Workers(pool), reduce=wrt.batches.Histogram(nearest)),
    )
    scene.count_blocks([(origins, nearest)]).write(nearest)


def meshes(path: str, vertices: np.ndarray, faces: list[tuple[int, int, int]], bodies: list[wrt.TriangleMesh]) -> None:
    mesh = (
        wrt.TriangleMesh(vertices, faces, up=(0, 0, 1))
        .transformed(np.eye(4))
        .with_materials(wrt.Material(), uv=vertices[:, :2])
    )
    loaded = wrt.Scene(trimesh.load(path))
    loaded.move({"shoulder": np.eye(4)})
    scene = wrt.Scene([bodies, [mesh]])
    scene.update({1: vertices, 4: wp.array(vertices)}, rebuild="never")
    with scene.updating(0, vertices=vertices):
        print(scene.filtered(ignore={0: [True, False]}, alpha=True))
    forest = wrt.Scene([wrt.Instance(mesh), wrt.Instance(trimesh.load_mesh(path), wp.array(np.eye(4)))])
    forest.update(range(2), transform=np.stack([np.eye(4)] * 2))
    forest.remove(forest.add(wrt.Instance(mesh, mask=3)))
    moving = wrt.moving.GroupedScene(bodies, "kdtree", accelerators={0: wrt.KdTree()})
    print(moving, wrt.moving.InstancedScene(trimesh.load_scene(path), wrt.Bvh(), device=wp.get_device("cpu"), cache=path))
    print(wrt.moving.Motion(vertices={0: (vertices, vertices)}), wrt.analysis.clearance(forest, {0, 1}).distance)


def moving_sensors(scene: wrt.Scene, track: np.ndarray, poses: wp.array) -> None:
    path = wrt.sensors.Trajectory([0.0, 0.1], [[0, 0, 1.8], [1, 0, 1.8]], rotations=None)
    lidar = wrt.sensors.Lidar(pattern=wrt.sensors.LidarPattern.spinning([-1.0, 1.0], 360, azimuth_offsets=0.5))
    lidar.scan(scene, path, motions={0: wrt.sensors.Trajectory.from_matrices((0.0, 1.0), track)}, labels=[1, 2], mask=3)
    assert_type(wrt.sensors.deskew(track[:, 3], 0.0, path, 0.1), np.ndarray)
    lens = wrt.sensors.BrownConrady.from_matrix([[500, 0, 32], [0, 500, 24], [0, 0, 1]], (0.1, 0.0, 0.0, 0.0))
    assert_type(lens.project([[0.0, 0.0, 1.0]]), np.ndarray)
    assert_type(lens.unproject(wp.zeros(3, dtype=wp.vec2d))[1], wp.array)
    camera = wrt.sensors.Camera(64, 48, lens)
    lights = [wrt.lights.Sky(1.0), wrt.lights.Sky.gradient((0.1, 0.2, 0.3), 2.0, up=[0, 0, 1])]
    picture = camera.render(scene, np.eye(4), lights=lights, materials=wrt.Material(), samples=64)
    images = camera.capture(scene, poses, albedo=True, materials=[wrt.Material()], environment=[0, 1])
    print(picture.linear, images.flow, camera.to_camera(np.eye(4)).position)


def shadows(scene: wrt.Scene, points: np.ndarray, buffer: wp.array) -> None:
    light = wrt.lights.LightBuffer(scene, (0, 0, 9))
    assert_type(light.occluded(points, skip=scene.closest_point(points)), np.ndarray)
    assert_type(light.occluded(buffer), wp.array)
    area = wrt.lights.AreaLightVisibility.rectangle(scene, (0, 0, 9), (1, 0, 0), (0, 1, 0), samples=4)
    assert_type(area.visible(points, t_max=np.ones(len(points))), np.ndarray)
    print(area.occluded(buffer), scene.occluded(light.shadow_rays(points)))


def fronts(mesh: trimesh.Trimesh, rays: np.ndarray) -> None:
    intersector = wrt.compat.RayMeshIntersector(mesh)
    print(intersector.intersects_any(rays[:, :3], rays[:, 3:]), wrt.compat.ProximityQuery(mesh).signed_distance(rays[:, :3]))
    scene = wrt.compat.RaycastingScene(device="cpu")
    print(scene.cast_rays(rays)["t_hit"], scene.compute_signed_distance(rays[:, :3]))
    wrt.lights.save_lights("lights.npz", wrt.lights.PointLight((0, 0, 1)))
    wrt.view(
        wrt.TriangleMesh.from_trimesh(mesh), up=(0, 0, 1), animate=lambda scene, frame: scene.update(0, vertices=rays)
    ).close()
