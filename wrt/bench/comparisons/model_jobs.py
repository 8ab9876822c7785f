"""Whole jobs around models: meshes before they are printed, a picture in glass, and thousands of environments that move.

As in `wrt.bench.comparisons.whole_jobs`, the first contender of a job traces its rays alone, and the others do the same with
what comes before and after.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from wrt import scenes, sensors
from wrt.bench.core.paired_timing import Contender
from wrt.meshes.instance import Instance
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

RAYS = "rays alone"
BODIES = 3
"""Of each environment."""

BEAMS = 64
"""Of each environment's scanner."""


class Print:
    """A closed vase with a wall, to be checked before it is printed.

    Args:
        size: 1 for 200,000 triangles and as many points.
        threads: of wrt and of peers; None for all cores.
    """

    def __init__(self, size: float, threads: int | None) -> None:
        count = max(24, round(450 * size**0.5))
        z = np.linspace(0.0, 100.0, max(8, count // 4))
        outside = 30.0 + 12.0 * np.sin(z / 9.0)
        inside = np.stack([outside - 2.0, z], axis=-1)[z > 2.0]
        profile = np.concatenate([[[0.0, 0.0]], np.stack([outside, z], axis=-1), inside[::-1], [[0.0, 2.0]]])
        self.mesh, self.threads = scenes.shapes.lathe(profile, count), threads
        low, high = self.mesh.bounds
        self.points = low + np.random.default_rng(0).random((self.mesh.triangle_count, 3)) * (high - low)
        self.scene = Scene(self.mesh, device="cpu", num_threads=threads)
        self.faces = self.scene.points_on(np.arange(self.mesh.triangle_count))
        inwards = -self.mesh.face_normals.astype(np.float32)
        self.inwards = np.asarray(self.faces.spawn(inwards)), inwards

    def rays(self, name: str) -> int:
        """Number of rays: through the wall from each triangle, and from each point to the outside."""
        return 2 * self.mesh.triangle_count


def print_contenders(place: Print) -> list[Contender]:
    """Checks of a mesh: closed, volume, wall, overhang, and which points are inside; from the arrays, with the tree's build."""
    from wrt.analysis import thickness

    up = np.array([0.0, 0.0, 1.0], dtype=np.float32)

    def rays() -> None:
        place.scene.intersect(*place.inwards)
        place.scene.count(place.points, up)

    def checks() -> list[Any]:
        mesh = TriangleMesh(place.mesh.vertices, place.mesh.faces)
        scene = Scene(mesh, device="cpu", num_threads=place.threads)
        wall = thickness(scene, scene.points_on(np.arange(mesh.triangle_count)))
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        return [mesh.is_closed, volume, wall, mesh.face_normals[:, 2] < -0.7, scene.contains(place.points)]

    def by_trimesh() -> list[Any]:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        mesh = trimesh.Trimesh(place.mesh.vertices, place.mesh.faces, process=False)
        tracer, normals = RayMeshIntersector(mesh), mesh.face_normals
        origins = mesh.triangles_center - 1e-4 * normals
        places, ray, _ = tracer.intersects_location(origins, -normals, multiple_hits=False)
        wall = np.full(len(normals), np.inf)
        wall[ray] = np.linalg.norm(places - origins[ray], axis=1)
        return [mesh.is_watertight, mesh.volume, wall, normals[:, 2] < -0.7, tracer.contains_points(place.points)]

    def by_open3d() -> list[Any]:
        from open3d import core, geometry, t, utility

        corners, faces = np.array(place.mesh.vertices), place.mesh.faces  # Open3D takes no arrays that cannot be written to
        plain = geometry.TriangleMesh(utility.Vector3dVector(corners), utility.Vector3iVector(faces.astype(np.int32)))
        plain.remove_duplicated_vertices()  # else edges are open
        tracer = t.geometry.RaycastingScene(nthreads=place.threads or 0)
        tracer.add_triangles(core.Tensor(corners.astype(np.float32)), core.Tensor(faces.astype(np.uint32)))  # type: ignore[call-overload]
        plain.compute_triangle_normals()
        normals = np.asarray(plain.triangle_normals)
        origins = corners[faces].mean(axis=1) - 1e-4 * normals
        wall = tracer.cast_rays(core.Tensor(np.float32(np.concatenate([origins, -normals], axis=1))))["t_hit"].numpy()  # type: ignore[call-overload]
        inside = tracer.compute_occupancy(core.Tensor(np.float32(place.points))).numpy()  # type: ignore[call-overload]
        return [plain.is_edge_manifold(False), plain.get_volume(), wall, normals[:, 2] < -0.7, inside]

    return [
        Contender(RAYS, rays),
        Contender("checks, with the build", checks),
        Contender("trimesh + embreex", by_trimesh),
        Contender("Open3D", by_open3d),
    ]


class Glass:
    """A teapot of glass on a ground, a lamp and a sky: a student's first picture, through a kd-tree or a BVH.

    Args:
        size: 1 for 320 x 240 pixels, 4 samples each.
        threads: as in `Print`.
    """

    samples, depth = 4, 6
    sky = 0.4, 0.5, 0.7
    lamp = 25.0

    def __init__(self, size: float, threads: int | None) -> None:
        from wrt.imaging.cameras import PinholeCamera
        from wrt.lights import AreaLight, Sky
        from wrt.materials.material import Material

        pot = scenes.build("teapot", level=8, ground=False, closed=True)
        low, high = pot.bounds
        ground = scenes.shapes.plane(low[:2] - 4 * pot.extent, high[:2] + 4 * pot.extent, z=low[2])
        self.threads, self.lamp_at, self.lamp_radius = threads, pot.center + pot.extent * np.array([1, -1, 2]), 0.4 * pot.extent
        self.meshes = [
            pot.with_materials(Material("dielectric", index=1.5, color=1.0)),
            ground.with_materials(Material(color=0.6)),
        ]
        self.camera = PinholeCamera.framing(pot, max(16, round(320 * size)), max(12, round(240 * size)), up=(0, 0, 1))
        self.lights = [AreaLight.sphere(self.lamp_at, self.lamp_radius, radiance=self.lamp), Sky(self.sky)]
        self.scene = Scene(self.meshes, device="cpu", num_threads=threads)

    def rays(self, name: str) -> int:
        """Number of camera rays."""
        return self.camera.width * self.camera.height * self.samples

    def mitsuba(self, variant: str) -> Any:
        """The same scene for Mitsuba 3.

        Raises:
            ImportError: it is not installed.
        """
        import tempfile
        from pathlib import Path

        import mitsuba as mi

        mi.set_variant(variant)
        camera = self.camera
        place = mi.ScalarTransform4f().look_at(list(camera.position), list(camera.look_at), list(camera.up))
        film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": "box"}}
        lamp = {"type": "area", "radiance": {"type": "rgb", "value": self.lamp}}
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": self.depth},
            "sensor": {"type": "perspective", "fov": float(camera.fov), "fov_axis": "y", "to_world": place, "film": film},
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": list(self.sky)}},
            "lamp": {"type": "sphere", "center": self.lamp_at.tolist(), "radius": float(self.lamp_radius), "emitter": lamp},
        }
        bsdfs = {"type": "dielectric", "int_ior": 1.5}, {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}
        with tempfile.TemporaryDirectory() as folder:
            for number, (mesh, bsdf) in enumerate(zip(self.meshes, bsdfs, strict=True)):
                path = Path(folder) / f"{number}.ply"
                mesh.save(path)
                scene[f"mesh{number}"] = {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf}
            return mi.load_dict(scene)


def picture_contenders(place: Glass) -> list[Contender]:
    """A path-traced picture with glass, from the meshes, with the tree's build.

    The camera rays are the same for each sample, and do not bounce: ratios to them say little."""
    from wrt.accelerators.tree_descriptions import KdTree
    from wrt.pictures import Rendering

    rays = place.camera.rays()

    def camera_rays() -> None:
        for _ in range(place.samples):
            place.scene.intersect(rays)

    def picture(tree: Any) -> np.ndarray:
        scene = Scene(place.meshes, tree, device="cpu", num_threads=place.threads)
        options: dict[str, Any] = {"lights": place.lights, "integrator": "path", "samples": place.samples, "depth": place.depth}
        return Rendering(scene, place.camera, smooth=False, **options).advance().linear

    def by_mitsuba() -> np.ndarray:
        import mitsuba as mi

        return np.array(mi.render(place.mitsuba("scalar_rgb"), spp=place.samples))

    return [
        Contender("camera rays alone", camera_rays),
        Contender("a picture", lambda: picture("auto")),
        Contender("a picture, kd-tree", lambda: picture(KdTree())),
        Contender("Mitsuba, scalar_rgb", by_mitsuba),
    ]


class Worlds:
    """Environments of a simulation, with bodies of their own that move, and a scanner in each.

    Args:
        size: 1 for 2,048 environments.
        threads: as in `Print`.
    """

    def __init__(self, size: float, threads: int | None) -> None:
        count, rng = max(4, round(2048 * size)), np.random.default_rng(0)
        self.box, self.count = scenes.shapes.boxes([[-0.5] * 3], [[0.5] * 3]), count
        self.places = np.tile(np.eye(4, dtype=np.float32), (count, BODIES, 1, 1))
        turn, far = rng.uniform(0, 2 * np.pi, (count, BODIES)), rng.uniform(1.5, 6.0, (count, BODIES))
        self.places[..., :2, 3] = far[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        self.owner, self.number = np.repeat(np.arange(count), BODIES), 0
        flat = self.places.reshape(-1, 4, 4)
        instances = [Instance(self.box, at, environment=int(k)) for k, at in zip(self.owner, flat, strict=True)]
        self.scene = Scene(instances, device="cpu", num_threads=threads)
        azimuth = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
        self.fan = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1).astype(np.float32)
        pattern = sensors.LidarPattern(self.fan, times=np.zeros(BEAMS))
        self.scanner = sensors.Lidar(pattern=pattern, min_range=0.0, max_range=10.0)
        self.poses = np.tile(np.eye(4), (count, 1, 1))

    def rays(self, name: str) -> int:
        """Number of rays of a step."""
        return self.count * BEAMS

    def move(self) -> np.ndarray:
        """(environments * bodies, 4, 4) where bodies are next."""
        self.number += 1
        self.places[..., 0, 3] += 0.01 if self.number % 2 else -0.01
        return self.places.reshape(-1, 4, 4)


def world_contenders(place: Worlds) -> list[Contender]:
    """A step: bodies move, and every scanner measures ranges."""
    worlds, index = np.arange(place.count), np.arange(len(place.owner))
    center = np.zeros((place.count, 1, 3), dtype=np.float32)

    def step() -> Any:
        place.scene.update(index, transform=place.move())
        return place.scanner.scan(place.scene, place.poses, environment=worlds).range

    return [
        Contender(RAYS, lambda: place.scene.intersect(center, place.fan, 0.0, 10.0, environment=worlds[:, None])),
        Contender("update and ranges", step),
        Contender("wp.Mesh, a loop over bodies", _by_warp(place)),
    ]


def _by_warp(place: Worlds) -> Callable[[], np.ndarray]:
    """Ranges by `wp.Mesh`: a kernel that takes a ray to the frame of each body of its environment."""
    import warp as wp

    from wrt.bench.peers.warp_mesh_kernels import nearest_of_bodies

    made: list[Any] = []

    def run() -> np.ndarray:
        if not made:
            points = wp.array(place.box.vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
            mesh = wp.Mesh(points, wp.array(place.box.faces.ravel(), dtype=int, device="cpu"), bvh_constructor="sah")
            made.extend([mesh, wp.array(place.fan, dtype=wp.vec3, device="cpu")])
        inverse = np.linalg.inv(place.move()).reshape(place.count, BODIES, 4, 4)
        found = wp.empty((place.count, BEAMS), dtype=float, device="cpu")
        inputs = [made[0].id, wp.array(inverse, dtype=wp.mat44, device="cpu"), made[1], 10.0, found]
        wp.launch(nearest_of_bodies, found.shape, inputs=inputs, device="cpu")
        return found.numpy()

    return run
