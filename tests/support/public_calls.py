"""Valid arguments of every public callable that takes a number, a switch or a few numbers: what the tests of types vary.

Each row of `CALLS` has the name of the callable, a function of the arguments to try that returns something to compare, and the
plain values of these arguments. `FOR_THE_LIBRARY` lists what has such parameters, too, but is called by wrt itself.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import trimesh
import warp as wp

import wrt
from wrt.known_rays import influence_areas

LEAST = {"t": "min"}

MESH_FILE = {"materials": False, "outside": False}
"""Options of `TriangleMesh.load`."""


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
def executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)


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


@wrt.device.kernel
def count_up(first: int, out: wp.array(dtype=int)):
    """Writes the number of each item."""
    out[first + wp.tid()] = first + wp.tid() + 1


def launched(**options: Any) -> np.ndarray:
    out = wp.zeros(4, dtype=int, device="cpu")
    wrt.device.launch(count_up, inputs=[out], device="cpu", **options)
    return out.numpy()


def threads_of(make: Callable[..., Any]) -> Callable[..., int | None]:
    """The number of threads of a scene that `make` makes."""
    return lambda **options: make(device="cpu", **options).num_threads


def seen(found: Any) -> list[np.ndarray]:
    """What a scan, an image or a batch of hits holds."""
    names = ("t", "primitive_id", "uv", "range", "intensity", "distance", "albedo", "flow", "position")
    values = [getattr(found, name, None) for name in names]
    return [value.numpy() if isinstance(value, wp.array) else value for value in values if value is not None]


def updated(**options: Any) -> list[tuple[int, int]]:
    moved = instances().__copy__()
    moved.update(0, **options)
    return [(one.mask, one.environment) for one in moved.instances]


def updated_beside(threads: Any) -> np.ndarray:
    moved = scene().__copy__()
    with moved.updating(0, vertices=mesh().vertices + 1, threads=threads):
        pass
    return moved.bounds


def shown(frame: Any) -> int:
    fuzzy().show(frame)
    return fuzzy().frame


def built(**options: Any) -> int:
    with tempfile.TemporaryDirectory() as path:
        return wrt.disk.PartitionedScene.build(cloth().mesh(0), Path(path) / "scene", device="cpu", **options).triangle_count


def with_threads(count: Any) -> int:
    before = wrt.get_num_threads()
    try:
        wrt.set_num_threads(count)
        return wrt.get_num_threads()
    finally:
        wrt.set_num_threads(before)


def with_shown(show: Any) -> None:
    try:
        wrt.device.show_compiling(show)
    finally:
        wrt.device.show_compiling(None)


def run_job(most: Any) -> int:
    with tempfile.TemporaryDirectory() as path:
        job = wrt.cluster.Job(Path(path) / "job", scene().occluded_blocks(*rays(), memory=1))
        return job.run(most).status.done


def pool(**options: Any) -> str:
    with wrt.cluster.ProcessPool(**options) as made:
        return repr(made)


POSE = {"position": (0.0, -4.0, 2.0), "look_at": (0.0, 0.0, 1.0), "up": (0.0, 0.0, 1.0)}
AIM = {"position": (0.0, 0.0, 9.0), "direction": (0.0, 0.0, -1.0), "up": (0.0, 1.0, 0.0)}
FOCUS = {"fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 1.0}


def calls() -> Iterator[Call]:
    """All rows. Numbers of two and of four are exact in every type of float."""
    yield from scene_calls()
    yield from query_calls()
    yield from tree_calls()
    yield from known_ray_calls()
    yield from picture_calls()
    yield from sensor_calls()
    yield from other_calls()


def scene_calls() -> Iterator[Call]:
    frames, faces = cloth().frames, cloth().faces
    weights = np.ones((mesh().vertex_count, 1))
    yield Call("Scene", threads_of(lambda **o: wrt.Scene(mesh(), **o)), {"num_threads": 2})
    yield Call("Scene.load", threads_of(lambda **o: wrt.Scene.load(folder() / "scene.npz", **o)), {"num_threads": 2})
    yield Call("Scene.handle", lambda **o: instances().handle(**o) is not None, {"mask": 2, "environment": 1})
    yield Call("Scene.update", updated, {"mask": 2, "environment": 1})
    yield Call("Scene.updating", updated_beside, {"threads": 1})
    yield Call("FanScene", threads_of(lambda **o: wrt.classics.FanScene(mesh(), **o)), {"num_threads": 2})
    yield Call("GroupedScene", threads_of(lambda **o: wrt.moving.GroupedScene([mesh()], **o)), {"num_threads": 2})
    yield Call(
        "InstancedScene", threads_of(lambda **o: wrt.moving.InstancedScene([wrt.Instance(mesh())], **o)), {"num_threads": 2}
    )
    yield Call("Instance", lambda **o: pair(wrt.Instance(mesh(), **o)), {"mask": 2, "environment": 1})
    options = {"clusters": 1, "rest": 1, "num_threads": 2}
    yield Call("FuzzyScene", lambda **o: labels(wrt.moving.FuzzyScene(frames, faces, device="cpu", **o)), options)
    yield Call("FuzzyScene.show", shown, {"frame": 1})
    yield Call(
        "SkinnedScene",
        lambda **o: labels(wrt.moving.SkinnedScene(mesh().vertices, mesh().faces, weights, skeleton(), device="cpu", **o)),
        {"samples": 2, "seed": 1, "num_threads": 2},
    )
    yield Call("Skeleton.sample", lambda **o: skeleton().sample(**o), {"count": 4, "seed": 1})
    options = {"part_triangles": 64, "store_records": True, "memory": 1 << 26, "num_threads": 2, "progress": False}
    yield Call("PartitionedScene.build", built, options)
    yield Call(
        "PartitionedScene",
        threads_of(lambda **o: wrt.disk.PartitionedScene(folder() / "parts", **o)),
        {"memory": 1 << 26, "num_threads": 2},
    )
    yield Call("TriangleMesh.load", lambda **o: wrt.TriangleMesh.load(folder() / "mesh.ply", **o).faces, MESH_FILE)
    yield Call(
        "TriangleMesh.from_trimesh",
        lambda **o: wrt.TriangleMesh.from_trimesh(trimesh_rays().mesh, **o).faces,
        {"materials": False},
    )
    yield Call("UpdatePolicy", wrt.moving.UpdatePolicy, {"tolerance": 2.0, "subtrees": False})


def pair(instance: wrt.Instance) -> tuple[Any, Any]:
    return instance.mask, instance.environment


def labels(made: Any) -> tuple[Any, Any]:
    return made.labels, made.num_threads


def query_calls() -> Iterator[Call]:
    bounds = {"t_min": 0.5, "t_max": 64.0}
    seen_by = {"mask": 1, "environment": 1}
    flags = {"cull_backfaces": False, "counters": False, "precise": False}
    yield Call("Queries.intersect", lambda **o: seen(scene().intersect(*rays(), **o)), {**bounds, **flags})
    yield Call(
        "Queries.occluded", lambda **o: instances().occluded(*rays(), **o), {**bounds, **seen_by, "cull_backfaces": False}
    )
    yield Call("Queries.count", lambda **o: scene().count(*rays(), **o), {**bounds, "cull_backfaces": False})
    yield Call("Queries.explain", lambda **o: scene().explain(*rays(), **o), {**bounds, "cull_backfaces": False})
    options = {**bounds, "cull_backfaces": False, "max_hits": 2}
    yield Call("Queries.intersect_all", lambda **o: seen(scene().intersect_all(*rays(), **o)), options)
    options = {**seen_by, "max_distance": 64.0}
    yield Call("PointQueries.closest_point", lambda **o: seen(instances().closest_point(rays()[0], **o)), {**options, "k": 2})
    yield Call("PointQueries.closest_point", lambda **o: counted(scene().closest_point(rays()[0], **o)), {"counters": True})
    yield Call("PointQueries.closest_point", lambda **o: seen(scene().closest_point(rays()[0], **o)), {"precise": True})
    options = {**seen_by, "radius": 64.0}
    yield Call("PointQueries.within", lambda **o: seen(instances().within(rays()[0], **o)), options)
    yield Call("PointQueries.verify", lambda **o: scene().verify(**o), {"samples": 4, "seed": 1})
    blocks = {**bounds, "memory": 1 << 16, "progress": False}
    nearest = {**blocks, "precise": False}
    yield Call(
        "BlockQueries.intersect_blocks", lambda **o: scene().intersect_blocks(*rays(), reduce=LEAST, **o).result(), nearest
    )
    yield Call("BlockQueries.occluded_blocks", lambda **o: scene().occluded_blocks(*rays(), **o).result(), blocks)
    yield Call("BlockQueries.count_blocks", lambda **o: scene().count_blocks(*rays(), **o).result(), blocks)
    options = {"max_distance": 64.0, "memory": 1 << 16, "progress": False, "precise": False}
    yield Call(
        "BlockQueries.closest_point_blocks",
        lambda **o: scene().closest_point_blocks(rays()[0], reduce=LEAST, **o).result(),
        options,
    )
    for name in ("intersect", "occluded", "count"):
        yield Call(f"PartQueries.{name}", lambda name=name, **o: of_parts(name, o), {**bounds, "cull_backfaces": False})
    yield Call("Hits.smooth_normal", lambda **o: hits().smooth_normal(**o), {"crease_angle": 32.0})
    yield Call("GeneratedRays", lambda **o: wrt.batches.GeneratedRays(len, **o), {"shape": 4, **bounds})
    yield Call("launch", launched, {"count": 4, "num_threads": 2, "chunk": 2})
    yield Call("Members.node_transform", lambda **o: graph().node_transform("part", **o), {"to_parent": False})
    options = {"multiple_hits": True, "max_hits": 2, "return_locations": False}
    yield Call(
        "RayMeshIntersector",
        lambda **o: wrt.compat.RayMeshIntersector(trimesh_rays().mesh, device="cpu", **o).scene.num_threads,
        {"num_threads": 2},
    )
    yield Call("RayMeshIntersector.intersects_id", lambda **o: trimesh_rays().intersects_id(*rays(), **o), options)
    options = {"multiple_hits": True, "max_hits": 2}
    yield Call("RayMeshIntersector.intersects_location", lambda **o: trimesh_rays().intersects_location(*rays(), **o), options)
    yield Call("RaycastingScene", lambda **o: vars(wrt.compat.RaycastingScene(**o)), {"nthreads": 2})
    six = np.concatenate(rays(), axis=1)
    for name in ("cast_rays", "count_intersections", "list_intersections"):
        yield Call(f"RaycastingScene.{name}", lambda name=name, **o: getattr(open3d(), name)(six, **o), {"nthreads": 2})
    for name, options in DISTANCES.items():
        query = getattr(open3d(), name)
        yield Call(f"DistanceQueries.{name}", lambda query=query, **o: query(rays()[0], **o), options)
    yield Call(
        "ProximityQuery",
        lambda **o: wrt.compat.ProximityQuery(trimesh_rays().mesh, device="cpu", **o).scene.num_threads,
        {"num_threads": 2},
    )
    yield Call("for_all_meshes", threads_for_all, {"num_threads": 2})
    options = {"tnear": 0.5, "tfar": 64.0, "nthreads": 2}
    yield Call("RaycastingScene.test_occlusions", lambda **o: open3d().test_occlusions(six, **o), options)
    options = {
        "fov_deg": 64.0,
        "center": [0.0, 0.0, 1.0],
        "eye": [0.0, -4.0, 2.0],
        "up": [0.0, 0.0, 1.0],
        "width_px": 4,
        "height_px": 3,
    }
    yield Call("RaycastingScene.create_rays_pinhole", wrt.compat.RaycastingScene.create_rays_pinhole, options)


DISTANCES = {
    "compute_closest_points": {"nthreads": 2},
    "compute_distance": {"nthreads": 2},
    "compute_signed_distance": {"nthreads": 2, "nsamples": 3},
    "compute_occupancy": {"nthreads": 2, "nsamples": 3},
}
"""Queries of points in Open3D's interface."""


def counted(found: wrt.Hits) -> tuple[Any, Any]:
    return seen(found), found.counters


def threads_for_all(**options: Any) -> int | None:
    with wrt.compat.for_all_meshes(device="cpu", **options):
        return trimesh.Trimesh(mesh().vertices, mesh().faces, process=False).nearest.scene.num_threads


@cache
def graph() -> wrt.Scene:
    made = trimesh.Scene()
    made.add_geometry(trimesh_rays().mesh, node_name="part")
    return wrt.Scene(made, device="cpu")


def of_parts(name: str, options: dict[str, Any]) -> Any:
    found = getattr(parts(), name)(*rays(), **options)
    return seen(found) if name == "intersect" else found


def tree_calls() -> Iterator[Call]:
    costs = {"width": 8, "traversal_cost": 1.0, "block_cost": 0.5}
    bvh = {**costs, "bins": 16, "max_leaf_triangles": 8, "reinsertion": 1, "subset": 0.5}
    yield Call("Bvh", wrt.Bvh, bvh)
    kdtree = {**costs, "empty_factor": 0.5, "max_depth": 8, "bad_splits": 1, "leaf_triangles": 2, "least_size": 0.25}
    flags = {"mailbox": False, "split_clipping": False, "resamplings": 1, "median_levels": 0}
    yield Call("KdTree", wrt.KdTree, {**kdtree, **flags})
    projected = {**costs, "others": 0.5, "bins": 16, "max_leaf_triangles": 8, "leaf_cost": 0.5, "leaf_area": 0.5}
    projected |= {
        "leaf_probability": 0.5,
        "max_depth": 8,
        "aware_depth": 4,
        "subset": 1.0,
        "spatial_splits": 1.0,
        "shares": (1.0,),
    }
    yield Call("ProjectedBvh", lambda **o: wrt.known_rays.ProjectedBvh(areas=area(), **o), projected)
    yield Call("ProjectedBvh", lambda **o: wrt.known_rays.ProjectedBvh(areas=area(), **o), {"triangle_cost": 0.5})
    yield Call("RayAwareBvh", lambda **o: wrt.known_rays.RayAwareBvh(areas=[area()], **o), {"tolerance": 1.0, "depth": 4})


def known_ray_calls() -> Iterator[Call]:
    origins, directions = rays()
    plane = {**AIM, "width": 4.0, "height": 2.0, "depth": 8.0}
    yield Call("PlaneInfluenceArea", wrt.known_rays.PlaneInfluenceArea, plane)
    point = {**AIM, "fov": (64.0, 32.0), "near": 1.0, "far": 8.0}
    yield Call("PointInfluenceArea", wrt.known_rays.PointInfluenceArea, point)
    radial = wrt.known_rays.PointInfluenceArea(**point)
    for one in (area(), radial):
        yield Call(
            f"{type(one).__name__}.affine", lambda one=one, **o: one.affine(origins, directions, **o), {"tolerance": 2.0}
        )
    yield Call("PlaneCaster", wrt.known_rays.PlaneCaster, {**AIM, "width": 4.0, "height": 2.0, "tolerance": 2.0})
    yield Call("PlaneCaster.of", lambda **o: wrt.known_rays.PlaneCaster.of(area(), **o), {"tolerance": 2.0})
    yield Call("CircularCapCaster", wrt.known_rays.CircularCapCaster, {**AIM, "angle": 32.0})
    yield Call("SquareCapCaster", wrt.known_rays.SquareCapCaster, {**AIM, "fov": (64.0, 32.0)})
    casters = (
        wrt.known_rays.PlaneCaster.of(area()),
        wrt.known_rays.SquareCapCaster.of(radial),
        wrt.known_rays.CircularCapCaster(**AIM, angle=32),
    )
    for one in casters:
        yield Call(f"{type(one).__name__}.rays", lambda one=one, **o: one.rays(**o), {"count": 4, "seed": 1})
    options = {"bounds": [(-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)], "tolerance": 2.0, "least_share": 0.5, "samples": 20, "seed": 1}
    lines = np.zeros((30, 3)), np.random.default_rng(0).normal(size=(30, 3))
    yield Call("InfluenceAreas.from_rays", lambda **o: found_areas(lines, o), options)
    costs = {"box_cost": 1.0, "triangle_cost": 2.0}
    yield Call("analyse", lambda **o: wrt.known_rays.analyse(scene(), **o).expected_cost, costs)
    yield Call(
        "analyse_areas", lambda **o: [one.expected_cost for one in wrt.known_rays.analyse_areas(known_scene(), **o)], costs
    )
    yield Call("break_even", lambda **o: wrt.known_rays.break_even(known_scene(), origins, directions, **o), {"samples": 4})
    yield Call(
        "directional_shadow_rays",
        lambda **o: wrt.known_rays.directional_shadow_rays(hits(), **o),
        {"direction": (0.0, 1.0, -1.0)},
    )
    yield Call("point_shadow_rays", lambda **o: wrt.known_rays.point_shadow_rays(hits(), **o), {"position": (0.0, 1.0, 9.0)})


def found_areas(lines: tuple[np.ndarray, np.ndarray], options: dict[str, Any]) -> str:
    with mock.patch.object(influence_areas, "PAIRS", 50):  # whose clusters take most of the time
        return repr(wrt.known_rays.InfluenceAreas.from_rays(*lines, **options))


def ambient(**options: Any) -> wrt.pictures.AmbientRendering:
    return wrt.pictures.AmbientRendering(scene(), pinhole(), **options)


def picture_calls() -> Iterator[Call]:
    axes = {"least_quality": 0.5, "acceptable": 1.25, "excellent": 0.75}
    yield Call("AxisChoice", wrt.known_rays.AxisChoice, axes)
    yield Call("PinholeCamera", wrt.PinholeCamera, {"width": 4, "height": 3, "fov": 32.0, **POSE})
    yield Call("OrthographicCamera", wrt.OrthographicCamera, {"width": 4, "height": 3, "view_height": 2.0, **POSE})
    options = {"width": 4, "height": 3, "fov": 32.0, "margin": 0.25, "towards": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}
    for kind in ("from_opencv", "from_opengl"):
        at_pose = partial(getattr(wrt.PinholeCamera, kind), pose=np.eye(4))
        yield Call(f"_Camera.{kind}", at_pose, {"width": 4, "height": 3})
    blender = partial(wrt.PinholeCamera.from_blender, matrix_world=np.eye(4))
    yield Call("PinholeCamera.from_blender", blender, {"width": 4, "height": 3, "angle": 0.5})
    blender = partial(wrt.OrthographicCamera.from_blender, matrix_world=np.eye(4))
    yield Call("OrthographicCamera.from_blender", blender, {"width": 4, "height": 3, "ortho_scale": 2.0})
    yield Call("PinholeCamera.framing", lambda **o: wrt.PinholeCamera.framing(mesh(), **o), options)
    yield Call("_Camera.rays", lambda **o: pinhole().rays(**o), {"sample": 1, "samples": 2, "seed": 1})
    light = {"position": (0.0, 0.0, 9.0), "intensity": (2.0, 2.0, 2.0)}
    yield Call("PointLight", wrt.lights.PointLight, light)
    yield Call("SpotLight", wrt.lights.SpotLight, {**light, "look_at": (0.0, 0.0, 0.0), "angle": 32.0, "inner": 16.0})
    yield Call("DirectionalLight", wrt.lights.DirectionalLight, {"direction": (0.0, 0.0, -1.0), "irradiance": 2.0})
    yield Call("AreaLight.sphere", wrt.lights.AreaLight.sphere, {"center": (0.0, 0.0, 9.0), "radius": 2.0, "radiance": 2.0})
    edges = {"corner": (0.0, 0.0, 9.0), "edge1": (1.0, 0.0, 0.0), "edge2": (0.0, 1.0, 0.0)}
    yield Call("AreaLight.rectangle", wrt.lights.AreaLight.rectangle, {**edges, "two_sided": False})
    corners = {"a": (0.0, 0.0, 9.0), "b": (1.0, 0.0, 9.0), "c": (0.0, 1.0, 9.0)}
    yield Call("AreaLight.triangle", wrt.lights.AreaLight.triangle, {**corners, "two_sided": False})
    yield Call("Sky", wrt.lights.Sky, {"radiance": 2.0})
    yield Call("Sky.gradient", wrt.lights.Sky.gradient, {"horizon": 2.0, "zenith": 1.0, "ground": 0.5, "up": (0.0, 0.0, 1.0)})
    image = np.ones((2, 2, 3))
    yield Call(
        "Sky.image",
        lambda **o: wrt.lights.Sky.image(image, **o),
        {"scale": 2.0, "up": (0.0, 0.0, 1.0), "east": (1.0, 0.0, 0.0)},
    )
    shares = {"color": 0.5, "roughness": 0.5, "metallic": 0.5, "index": 1.5, "absorption": 1.0, "translucency": 0.5}
    yield Call("Material", wrt.Material, {**shares, "priority": 1, "emission": (2.0, 2.0, 2.0), "two_sided": False})
    numbers = {"samples": 2, "depth": 4, "seed": 1, "wave": 64, "texture_memory": 1 << 17}
    factors = {"lens_radius": 0.5, "focus_distance": 2.0, "threshold": 0.5, "max_radiance": 4.0, "crease_angle": 32.0}
    flags = {"roulette": False, "sample_lights": False, "smooth": False}
    yield Call("RenderSettings", wrt.pictures.RenderSettings, {**numbers, **factors, **flags, "exposure": 2.0, "ambient": 0.5})
    yield Call("Rendering.advance", lambda **o: rendering().advance(**o).samples, {"samples": 1})
    yield Call("Rendering.image", lambda **o: rendering().image(**o), {"exposure": 2.0})
    options = {"samples": 1, "ambient_samples": 1, "ambient_distance": 4.0, "crease_angle": 32.0, "seed": 1, "tile_pixels": 12}
    options |= {"light": (0.0, 0.0, 9.0), "shadows": True, "smooth": True, "albedo": 0.5, "ambient_color": 0.5}
    yield Call("render", lambda **o: wrt.render(scene(), pinhole(), **o), options)
    options = options | {"ambient_radius": 1}
    yield Call("AmbientRendering", lambda **o: ambient(**o).advance().image(), options)
    yield Call("AmbientRendering.advance", lambda **o: ambient().advance(**o).done, {"samples": 1})
    options = {"position": (0.0, 1.0, 9.0), "resolution": 4, "cull_backfaces": False, "max_bytes": 1 << 20}
    yield Call("LightBuffer", lambda **o: wrt.lights.LightBuffer(scene(), **o).bytes, options)
    flat = {"corner": (0.0, 0.0, 9.0), "edge_u": (1.0, 0.0, 0.0), "edge_v": (0.0, 1.0, 0.0)}
    options = {**flat, "samples": 4, "patterns": 2, "seed": 1}
    yield Call(
        "AreaLightVisibility.rectangle", lambda **o: wrt.lights.AreaLightVisibility.rectangle(scene(), **o).positions, options
    )
    yield Call("AreaLightVisibility.patterns_of", lambda **o: area_light().patterns_of(**o), {"count": 4})


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
    scan = {"time": 2.0, "slices": 1, "reflectance": 0.5, "seed": 1, "mask": 1, "environment": 1}
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
    yield Call("look_at", sensors.look_at, {"position": (0.0, -9.0, 4.0), "target": (0.0, 0.0, 1.0), "up": (0.0, 0.0, 1.0)})
    yield Call("Trajectory.at", lambda **o: trajectory().at(**o), {"times": [0.0, 4.0]})
    moving = {"times": [0.0, 8.0], "positions": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]}
    yield Call("Trajectory", lambda **o: sensors.Trajectory(**o).matrices, moving)


def drawn(made: wrt.sensors.LidarPattern) -> tuple[np.ndarray, ...]:
    return made.directions, made.times, made.rings, made.offsets


def other_calls() -> Iterator[Call]:
    yield Call("set_num_threads", with_threads, {"count": 2})
    yield Call("show_compiling", with_shown, {"show": False})
    yield Call("Job.run", run_job, {"most": 1})
    yield Call("Workers", lambda **o: wrt.cluster.Workers(executor(), **o), {"threads": 2, "window": 2, "retries": 1})
    yield Call("ProcessPool", pool, {"workers": 2, "threads": 2})
    yield Call("Histogram", wrt.batches.Histogram, {"edges": [0.0, 1.0, 2.0]})
    scenes = wrt.scenes
    yield Call("atrium", lambda **o: built_in(scenes.atrium(**o)), {"bays": (1, 1), "storeys": 1, "detail": 1})
    yield Call("cornell_box", lambda **o: built_in(scenes.cornell_box(**o)), {"blocks": False, "cells": 1})
    yield Call("random_triangles", lambda **o: built_in(scenes.random_triangles(**o)), {"count": 4, "size": 0.5, "seed": 1})
    yield Call("teapot", lambda **o: built_in(scenes.teapot(**o)), {"level": 1, "ground": False})
    yield Call("teapot_in_stadium", lambda **o: built_in(scenes.teapot_in_stadium(**o)), {"level": 1, "rows": 1, "segments": 8})
    yield Call("walking_figure", lambda **o: scenes.walking_figure(**o).frames, {"frames": 1, "detail": 3})
    yield Call("waving_cloth", lambda **o: scenes.waving_cloth(**o).frames, {"frames": 1, "cells": 1})
    yield Call("wood", lambda **o: built_in(scenes.wood(**o)), {"trees": 1, "leaves": 1, "seed": 1})
    yield Call("Animation.mesh", lambda **o: built_in(cloth().mesh(**o)), {"frame": 1})
    yield Call("Animation.moved", lambda **o: cloth().moved(**o).frames, {"offset": (1.0, 0.0, 0.0)})


def built_in(made: wrt.TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    return made.vertices, made.faces


FOR_THE_LIBRARY = {
    "answers and reports": (
        "AreaLight CameraImages JobStatus LidarScan OctreeAnalysis Plan TreeAnalysis Verification InfluenceAreas BuiltinScene "
        "Blocks Viewer PartitionedHits QueryTraffic AreaBreakEven BreakEven CountedWork BvhStatistics KdTreeStatistics Fault "
        "InsideCheck MeshMaterials.numbers SceneStatistics UpdateReport"
    ),
    "what trees and scenes ask of descriptions": (
        "Bvh.build Bvh.config Bvh.kernels KdTree.build KdTree.config KdTree.config_for KdTree.start ProjectedBvh.build "
        "ProjectedBvh.config RayAwareBvh.build RayAwareBvh.build_local RayAwareBvh.config Instance.moved GeneratedRays.rows"
    ),
    "what jobs, pictures and scans ask of their parts": (
        "Blocks.ranges Blocks.run_pieces Histogram.part Reduction.part Motion.move Wave Camera.beams Lidar.device_beams "
        "LidarPattern.cut LidarPattern.order_of_returns OrthographicCamera.rays_on PinholeCamera.rays_on Trajectory.at_rest "
        "Trajectory.check_covers ProcessPool.shutdown"
    ),
    "needs Dask": "map_points map_rays",
    "needs matplotlib": "draw_tree",
    "needs a browser": "view Viewer.play Viewer.add_points",
    "rows and columns of a finished analysis": "OctreeAnalysis.cut",
}
"""Public callables that are not tried, by the reason."""
