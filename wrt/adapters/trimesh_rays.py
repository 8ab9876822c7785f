"""trimesh's ray queries, method for method, answered by a `wrt.Scene`.

trimesh has two intersectors with the same methods: one in NumPy with an R-tree, one that asks Embree again from behind each
hit. This one takes the arguments of both and returns arrays of the same types in the same order. What differs is what they
leave open or get wrong: every crossing is listed exactly once, at edges and vertices too; there is no bound on the hits of a
ray; rows come ray by ray, nearest first.

The scene is built at the first query, and again at the first query after the mesh has changed: its hash says so.

References:
    M. Dawson-Haggerty et al.: trimesh, https://trimesh.org (the interface).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import Accelerator
from wrt.execution.query_kinds import AUTO
from wrt.kernels.runtime.launch import launch, use_threads

if TYPE_CHECKING:
    import trimesh

    from wrt.scene.scene import Scene


class RayMeshIntersector:
    """Ray queries of one mesh, with the methods of `trimesh.ray.ray_triangle.RayMeshIntersector` and its Embree twin.

    `mesh.ray = wrt.RayMeshIntersector(mesh)` makes the mesh, and what trimesh computes with rays, use it. It follows changes of
    the mesh, pickles without its tree, and a copy of it asks the same mesh, as trimesh's do. `mesh.copy()` makes a new mesh
    with trimesh's own intersector. Where trimesh takes the class, as in `trimesh.ray.ray_pyembree.RayMeshIntersector`, this one
    can take its place: then all meshes have it, primitives too.

    Rays: `ray_origins` and `ray_directions` are both (n, 3), directions of any length. Hits count from the origin on, that
    included; a ray with a NaN or an infinity, or with a direction of zero, misses. A mesh without faces is never hit.

    Args:
        mesh: a trimesh.Trimesh (or a `wrt.TriangleMesh`).
        accelerator, device, num_threads: as for `wrt.Scene`.
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        *,
        accelerator: str | Accelerator = AUTO,
        device: str | None = None,
        num_threads: int | None = None,
    ) -> None:
        # of its class: trimesh makes a mesh's intersector before a primitive can compute its faces
        if not all(hasattr(type(mesh), name) or hasattr(mesh, name) for name in ("vertices", "faces")):
            raise TypeError(f"mesh must be a trimesh.Trimesh, not {type(mesh).__name__}; make one of a scene with to_mesh()")
        self.mesh = mesh
        self._options = {"accelerator": accelerator, "device": device, "num_threads": num_threads}
        self._built: tuple[int, Scene | None] | None = None

    def __repr__(self) -> str:
        return f"RayMeshIntersector({self.mesh!r})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_built": None}

    def __copy__(self) -> RayMeshIntersector:
        return type(self)(self.mesh, **self._options)

    def __deepcopy__(self, memo: dict[int, Any]) -> RayMeshIntersector:
        return self.__copy__()

    @property
    def scene(self) -> Scene | None:
        """The `wrt.Scene` of the mesh as it is now; None if the mesh has no faces."""
        from wrt.meshes.mesh import TriangleMesh
        from wrt.scene.scene import Scene

        key = hash(self.mesh)
        built = self._built
        if built is None or built[0] != key:
            scene = None
            if len(self.mesh.faces):
                scene = Scene(TriangleMesh(self.mesh.vertices, self.mesh.faces), **self._options)
            built = self._built = (key, scene)
        return built[1]

    def intersects_id(
        self,
        ray_origins: Any,
        ray_directions: Any,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
    ) -> tuple[np.ndarray, ...]:
        """Triangles that rays hit.

        Args:
            ray_origins, ray_directions: (n, 3).
            multiple_hits: all hits of a ray, or only the first.
            max_hits: at most so many of the nearest hits of each ray, at least 1; None for all.
            return_locations: whether to return where they lie.

        Returns:
            index_tri: (h,) int64, indices of faces; ray by ray, nearest first.
            index_ray: (h,) int64, indices of rays, ascending.
            locations: (h, 3) float64, only if asked for.

        Raises:
            TypeError: an argument is of a wrong type.
            ValueError: the rays' shapes are not (n, 3) and equal, or max_hits is below 1.
        """
        from wrt.query.all_hits import check_max_hits

        check_max_hits(max_hits)
        origins, directions = _checked_rays(ray_origins, ray_directions)
        scene = self.scene
        if scene is None:
            empty = np.zeros(0, dtype=np.int64)
            return (empty, empty.copy(), np.zeros((0, 3)))[: 3 if return_locations else 2]
        if multiple_hits:
            lists = scene.intersect_all(origins, directions, max_hits=max_hits)
            index_tri, index_ray, uv = lists.primitive_id, lists.ray_id, lists.uv
        else:
            hits = scene.intersect(origins, directions)
            index_ray = np.flatnonzero(hits.is_hit)
            index_tri, uv = hits.primitive_id[index_ray], hits.uv[index_ray]
        found = index_tri.astype(np.int64), index_ray.astype(np.int64)
        return (*found, locate(scene, origins, directions, index_ray, index_tri, uv)) if return_locations else found

    def intersects_location(
        self, ray_origins: Any, ray_directions: Any, multiple_hits: bool = True, max_hits: int | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points where rays hit the mesh: (locations (h, 3) float64, index_ray (h,) int64, index_tri (h,) int64).

        Arguments, order of rows and errors as in `intersects_id`.
        """
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, max_hits=max_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_first(self, ray_origins: Any, ray_directions: Any) -> np.ndarray:
        """Index of the first face that each ray hits, -1 for a miss: (n,) int64. Errors as in `intersects_id`."""
        origins, directions = _checked_rays(ray_origins, ray_directions)
        scene = self.scene
        if scene is None:
            return np.full(len(origins), -1, dtype=np.int64)
        return scene.intersect(origins, directions).primitive_id.astype(np.int64)

    def intersects_any(self, ray_origins: Any, ray_directions: Any) -> np.ndarray:
        """Whether each ray hits anything: (n,) bool. Errors as in `intersects_id`."""
        origins, directions = _checked_rays(ray_origins, ray_directions)
        scene = self.scene
        if scene is None:
            return np.zeros(len(origins), dtype=bool)
        return scene.occluded(origins, directions)

    def contains_points(self, points: Any) -> np.ndarray:
        """Which points (n, 3) are inside the mesh: (n,) bool; see `wrt.Scene.contains`.

        Raises:
            TypeError: points are no array of real numbers.
            ValueError: points are not (n, 3).
        """
        points = _as_rows(points, "points")
        scene = self.scene
        return np.zeros(len(points), dtype=bool) if scene is None else scene.contains(points)


def locate(
    scene: Scene, origins: np.ndarray, directions: np.ndarray, ray: np.ndarray, primitive: np.ndarray, uv: np.ndarray
) -> np.ndarray:
    """Points (h, 3) float64 where the rays with these numbers meet these triangles of a scene of one mesh."""
    from wrt.kernels.query.hit_attributes import meet_planes

    (mesh,), device = scene.meshes, scene.device
    points = wp.empty(len(ray), dtype=wp.vec3d, device=device)
    vectors = [
        wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=wp.vec3d, device=device, copy=False)
        for values in (mesh.vertices, origins, directions)
    ]
    vertices, faces = vectors[0], scene.device_mesh.faces
    numbers = [wp.array(np.ascontiguousarray(ids, np.int32), dtype=int, device=device, copy=False) for ids in (ray, primitive)]
    weights = wp.array(np.ascontiguousarray(uv), dtype=wp.vec2, device=device, copy=False)
    with use_threads(scene.num_threads):
        launch(meet_planes, len(ray), [vertices, faces, *vectors[1:], *numbers, weights, points], device=device, chunk=4096)
    return points.numpy()


def _checked_rays(origins: Any, directions: Any) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = _as_rows(origins, "ray_origins"), _as_rows(directions, "ray_directions")
    if origins.shape != directions.shape:
        raise ValueError(
            f"ray_origins {origins.shape} and ray_directions {directions.shape} must have the same shape; "
            "repeat a single one with np.tile"
        )
    return origins, directions


def _as_rows(values: Any, name: str) -> np.ndarray:
    """`values` as (n, 3) float32 or float64."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} must be an array of shape (n, 3): {error}") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), not {array.shape}; reshape to one row for each")
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {array.dtype}; convert it to float64")
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)
