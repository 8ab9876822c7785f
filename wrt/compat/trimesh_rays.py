"""trimesh's ray queries, method for method, answered by a `wrt.Scene`.

trimesh has two intersectors with the same methods: one uses NumPy and an R-tree; the other calls Embree again from behind
each hit. This one takes the arguments of both and returns arrays of the same types in the same order. It differs where they
are undefined or wrong: every crossing is listed exactly once, also at edges and vertices; the number of hits of a ray is
not limited; rows are sorted by ray, then by distance.

The scene is built by the first query, and rebuilt by the first query after the mesh has changed, as detected by its hash.

References: dawson-haggerty (the interface).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.accelerators.accelerator import Accelerator
from wrt.engine.facts.query_kinds import AUTO
from wrt.kernels.runtime.launch import as_device, check_num_threads, launch, use_threads
from wrt.kernels.validation import as_bool, host_array

if TYPE_CHECKING:
    import trimesh

    from wrt.array_types import ArrayLike
    from wrt.scene.scene import Scene


class RayMeshIntersector:
    """Ray queries of one mesh, with the methods of `trimesh.ray.ray_triangle.RayMeshIntersector` and its Embree
    counterpart.

    `mesh.ray = wrt.compat.RayMeshIntersector(mesh)` makes the mesh, and trimesh's functions that use its rays, use this one. As
    with trimesh's intersectors, it follows changes of the mesh, pickles without its tree, and a copy of it refers to the
    same mesh. `mesh.copy()` makes a new mesh with trimesh's own intersector; `wrt.compat.for_all_meshes` gives all meshes this
    one, copies and primitives included.

    `ray_origins` and `ray_directions` are both (n, 3), directions of any length. Hits count if t >= 0. A ray with a NaN or
    an infinity, or with a zero direction, misses. A mesh without faces is never hit.

    Args:
        mesh: a trimesh.Trimesh (or a `wrt.TriangleMesh`).
        accelerator, device, num_threads: as in `wrt.Scene`.

    Raises:
        TypeError: mesh has no vertices or faces.
    """

    def __init__(
        self,
        mesh: trimesh.Trimesh,
        *,
        accelerator: str | Accelerator = AUTO,
        device: str | None = None,
        num_threads: int | None = None,
    ) -> None:
        # Tests the class: trimesh makes a mesh's intersector before a primitive can compute its faces.
        if not all(hasattr(type(mesh), name) or hasattr(mesh, name) for name in ("vertices", "faces")):
            raise TypeError(
                f"mesh must be a trimesh.Trimesh, not {type(mesh).__name__}; convert a trimesh.Scene with to_mesh()"
            )
        self.mesh = mesh
        device = None if device is None else as_device(device).alias
        threads = None if num_threads is None else check_num_threads(num_threads, "num_threads")
        self._options: dict[str, Any] = {"accelerator": accelerator, "device": device, "num_threads": threads}
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
        """The `wrt.Scene` of the mesh in its present state; None if the mesh has no faces."""
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
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
    ) -> tuple[np.ndarray, ...]:
        """Triangles that rays hit.

        Args:
            ray_origins, ray_directions: (n, 3).
            multiple_hits: whether to return all hits of a ray, or only the first.
            max_hits: largest number of hits of each ray, the nearest ones; at least 1, or None for all.
            return_locations: whether to return the hit points.

        Returns:
            index_tri: (h,) int64, indices of faces, sorted by ray, then by distance.
            index_ray: (h,) int64, indices of rays, ascending.
            locations: (h, 3) float64, only if requested.

        Raises:
            TypeError: an argument has a wrong type.
            ValueError: the rays' shapes are not (n, 3) and equal, or max_hits is below 1.
        """
        from wrt.query.all_hits import check_max_hits

        multiple_hits = as_bool("multiple_hits", multiple_hits)
        return_locations = as_bool("return_locations", return_locations)
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
        self, ray_origins: ArrayLike, ray_directions: ArrayLike, multiple_hits: bool = True, max_hits: int | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points where rays hit the mesh: (locations (h, 3) float64, index_ray (h,) int64, index_tri (h,) int64).

        Arguments, order of rows and errors as in `intersects_id`.
        """
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits=multiple_hits, max_hits=max_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> np.ndarray:
        """Index of the first face that each ray hits, -1 for a miss: (n,) int64. Errors as in `intersects_id`."""
        origins, directions = _checked_rays(ray_origins, ray_directions)
        scene = self.scene
        if scene is None:
            return np.full(len(origins), -1, dtype=np.int64)
        return scene.intersect(origins, directions).primitive_id.astype(np.int64)

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> np.ndarray:
        """Whether each ray hits anything: (n,) bool. Errors as in `intersects_id`."""
        origins, directions = _checked_rays(ray_origins, ray_directions)
        scene = self.scene
        if scene is None:
            return np.zeros(len(origins), dtype=bool)
        return scene.occluded(origins, directions)

    def contains_points(self, points: ArrayLike) -> np.ndarray:
        """Whether points (n, 3) are inside the mesh: (n,) bool; see `wrt.Scene.contains`.

        Raises:
            TypeError: points are not an array of real numbers.
            ValueError: points are not (n, 3).
        """
        points = as_rows(points, "points")
        scene = self.scene
        return np.zeros(len(points), dtype=bool) if scene is None else scene.contains(points)


def locate(
    scene: Scene, origins: np.ndarray, directions: np.ndarray, ray: np.ndarray, primitive: np.ndarray, uv: np.ndarray
) -> np.ndarray:
    """Points (h, 3) float64 where rays meet triangles, both given by index, of a scene of one mesh."""
    from wrt.kernels.query.hit_attributes import intersect_planes

    (mesh,), device = scene.meshes, scene.device
    points = wp.empty(len(ray), dtype=wp.vec3d, device=device)
    vectors = [
        wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=wp.vec3d, device=device, copy=False)
        for values in (mesh.vertices, origins, directions)
    ]
    vertices, faces = vectors[0], scene.state.device_mesh.faces
    numbers = [wp.array(np.ascontiguousarray(ids, np.int32), dtype=int, device=device, copy=False) for ids in (ray, primitive)]
    weights = wp.array(np.ascontiguousarray(uv), dtype=wp.vec2, device=device, copy=False)
    with use_threads(scene.num_threads):
        launch(
            intersect_planes, len(ray), [vertices, faces, *vectors[1:], *numbers, weights, points], device=device, chunk=4096
        )
    return points.numpy()


def _checked_rays(origins: Any, directions: Any) -> tuple[np.ndarray, np.ndarray]:
    origins, directions = as_rows(origins, "ray_origins"), as_rows(directions, "ray_directions")
    if origins.shape != directions.shape:
        raise ValueError(
            f"ray_origins {origins.shape} and ray_directions {directions.shape} must have the same shape; "
            "repeat a single one with np.tile"
        )
    return origins, directions


def as_rows(values: Any, name: str) -> np.ndarray:
    """`values` as (n, 3) float32 or float64."""
    try:
        array = host_array(name, values)
    except TypeError as error:
        if not isinstance(error.__cause__, ValueError):
            raise
        raise ValueError(f"{name} must be an array of shape (n, 3): {error}") from error  # rows of different lengths
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), not {array.shape}; reshape it to one row each")
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {array.dtype}; convert it to float64")
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)
