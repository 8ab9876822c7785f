"""trimesh's queries of nearest points, method for method, answered by a `wrt.Scene`; and a switch for all meshes.

It differs where trimesh is wrong: signs are by an exact rule (`wrt.analysis.sign_rule`) for all points, and not by the normal
of one triangle. Of triangles at the same distance, trimesh takes one that faces the point, and this one the first.

References: dawson-haggerty (the interface).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.accelerators.accelerator import Accelerator
from wrt.compat.trimesh_rays import RayMeshIntersector, as_rows
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.facts.scene_settings import as_settings
from wrt.kernels.validation import first_bad

if TYPE_CHECKING:
    import trimesh

    from wrt.array_types import ArrayLike
    from wrt.scene.scene import Scene


class ProximityQuery:
    """Nearest points of one mesh, with the methods of `trimesh.proximity.ProximityQuery`.

        mesh.nearest = wrt.compat.ProximityQuery(mesh)
        closest, distance, triangle = mesh.nearest.on_surface(points)
        mesh.nearest = trimesh.proximity.ProximityQuery(mesh)       # as it was

    It follows changes of the mesh, and pickles without its tree; `mesh.copy()` makes a new mesh with trimesh's own queries,
    unless it is called inside `wrt.compat.for_all_meshes`. Points are (n, 3).

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
        self._rays = RayMeshIntersector(mesh, accelerator=accelerator, device=device, num_threads=num_threads)

    def __repr__(self) -> str:
        return f"ProximityQuery({self._rays.mesh!r})"

    @property
    def scene(self) -> Scene | None:
        """The `wrt.Scene` of the mesh in its present state; None if the mesh has no faces."""
        return self._rays.scene

    def on_surface(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The closest point of any triangle to each point.

        Points are searched in float32: where several places are nearly as close, another one than trimesh's may be found, up to
        5e-4 of the distance from it. `scene.closest_point(points, precise=True)` searches in float64.

        Returns:
            closest: (n, 3) float64, on the surface; NaN for a point with a NaN or an infinity.
            distance: (n,) float64, inf for such a point.
            triangle_id: (n,) int64, -1 for such a point.

        Raises:
            TypeError: points are not an array of real numbers.
            ValueError: points are not (n, 3), or the mesh has no faces.
        """
        points, scene = as_rows(points, "points").astype(np.float64, copy=False), self._surface()
        found = scene.closest_point(points)
        closest = found.position
        distance = np.where(found.is_hit, np.linalg.norm(closest - points, axis=1), np.inf)
        return closest, distance, found.primitive_id.astype(np.int64)

    def vertex(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The closest vertex to each point, by the k-d tree of the mesh's vertices, which trimesh keeps: (n,) float64 distances
        and (n,) int64 vertices; for one point (3,), two numbers. Errors as in `on_surface`; ValueError for a point with a NaN
        or an infinity."""
        if is_one_point(points):
            distances, numbers = self.vertex(np.asarray(points)[None])
            return distances[0], numbers[0]
        points = as_rows(points, "points")
        if bad := first_bad(~np.isfinite(points).all(axis=1), points):
            raise ValueError(f"points{bad}, which is near no vertex; leave such points out")
        distance, number = self._rays.mesh.kdtree.query(points)
        return distance, number.astype(np.int64)

    def signed_distance(self, points: ArrayLike) -> np.ndarray:
        """Distances to the surface, positive inside, as trimesh has them: (n,) float64, NaN for a point with a NaN or an
        infinity. Errors as in `on_surface`."""
        from wrt.analysis.signed_distances import signed_distance

        points, scene = as_rows(points, "points").astype(np.float64, copy=False), self._surface()
        signed = signed_distance(scene, points)
        distance = np.linalg.norm(scene.closest_point(points).position - points, axis=1)
        return np.where(signed > 0.0, -distance, distance)

    def _surface(self) -> Scene:
        """The scene.

        Raises:
            ValueError: the mesh has no faces.
        """
        scene = self.scene
        if scene is None:
            raise ValueError("the mesh has no faces, so that nothing is nearest to a point; add some first")
        return scene


def is_one_point(points: Any) -> bool:
    """Whether the shape is (3,); False for what has none, of which `as_rows` says what is wrong."""
    try:
        return np.shape(points) == (3,)
    except (TypeError, ValueError):
        return False


@contextmanager
def for_all_meshes(
    *, accelerator: str | Accelerator = AUTO, device: str | None = None, num_threads: int | None = None
) -> Iterator[None]:
    """Gives all trimesh meshes that are made inside the `with` block, copies and subdivisions included, wrt's queries.

        with wrt.compat.for_all_meshes():
            mesh = trimesh.load("model.ply")            # mesh.ray and mesh.nearest are wrt's, and remain so
            finer = mesh.copy().subdivide()             # those of these, too
            trimesh.proximity.signed_distance(mesh, points)

    Until the block ends, the functions `closest_point` and `signed_distance` of `trimesh.proximity` are answered by wrt, too.
    Afterwards, trimesh is as it was. Threads that make meshes meanwhile get the same.

    Args:
        accelerator, device, num_threads: as in `wrt.Scene`.

    Raises:
        ImportError: trimesh is not installed.
        TypeError, ValueError: an argument is not what `wrt.Scene` accepts.
    """
    from importlib import import_module

    as_settings(accelerator, AUTO, device, num_threads)  # raises the errors here, not where meshes are made
    options: dict[str, Any] = {"accelerator": accelerator, "device": device, "num_threads": num_threads}
    proximity, trimesh_ray = import_module("trimesh.proximity"), import_module("trimesh.ray")
    modules = ["ray_triangle", *(["ray_pyembree"] if trimesh_ray.has_embree else [])]
    changed: list[tuple[Any, str, Any]] = [
        (import_module(f"trimesh.ray.{name}"), "RayMeshIntersector", lambda mesh, *_, **__: RayMeshIntersector(mesh, **options))
        for name in modules
    ]
    changed += [
        (proximity, "ProximityQuery", lambda mesh: ProximityQuery(mesh, **options)),
        (proximity, "closest_point", lambda mesh, points: nearest_of(mesh, options).on_surface(points)),
        (proximity, "signed_distance", lambda mesh, points: nearest_of(mesh, options).signed_distance(points)),
    ]
    before = [(module, name, getattr(module, name)) for module, name, _ in changed]
    try:
        for module, name, value in changed:
            setattr(module, name, value)
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def nearest_of(mesh: trimesh.Trimesh, options: dict[str, Any]) -> ProximityQuery:
    """The mesh's own queries if they are wrt's, with their tree; else new ones."""
    own = getattr(mesh, "nearest", None)
    return own if isinstance(own, ProximityQuery) else ProximityQuery(mesh, **options)
