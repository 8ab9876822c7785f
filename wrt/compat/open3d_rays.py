"""Open3D's `t.geometry.RaycastingScene`, method for method, on NumPy arrays and a `wrt.Scene`.

Rays are one array (..., 6) of origin and direction; results are dictionaries with Open3D's keys, shapes and types.
Differences: arrays are NumPy's, which have `.numpy()` and little else of a tensor (`wrt.compat.open3d_distances`); each
crossing is counted exactly once, also at edges and vertices; each of several coincident triangles is hit; lists of hits are
sorted by t; float64 rays are not rounded to float32.

Distance queries are in `wrt.compat.open3d_distances`.

References: zhou-2018 (the interface).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.compat.open3d_distances import DistanceQueries, as_numpy, tensor_arrays
from wrt.kernels.runtime.launch import MAX_THREADS, as_device, use_threads
from wrt.kernels.validation import as_float, as_int, as_numbers, as_real_array
from wrt.meshes.mesh import TriangleMesh

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.scene.scene import Scene
FAR_CAMERA = 2.0**14
"""Coordinate beyond which rays of a camera are float64: float32 is spaced by more than 1/1024 there."""


class RaycastingScene(DistanceQueries):
    """Queries of several meshes, with the methods of Open3D's `t.geometry.RaycastingScene`.

    `rays` is a real array (..., 6) of origins and directions of any length; t is in units of that length. Any leading shape
    is kept. A ray with a NaN or an infinity, or with a zero direction, misses, as does every ray in an empty scene. The
    tree is built by the first query after triangles were added.

    Args:
        nthreads: CPU threads, 0 or None for `wrt.get_num_threads()`; every query may pass its own number.
        device: a Warp device, or its name as Warp or Open3D writes it, such as "cpu" or "CPU:0", or an
            `open3d.core.Device`; None for Warp's default device.

    Raises:
        TypeError: `nthreads` is not an int, or `device` no device.
        ValueError: `nthreads` is negative, or there is no such device.
    """

    def __init__(self, nthreads: int | None = 0, device: Any = None) -> None:
        self._nthreads = _as_threads(nthreads)
        self._device = None if device is None else as_device(device).alias
        self._meshes: list[TriangleMesh] = []

    def __repr__(self) -> str:
        return f"RaycastingScene({len(self._meshes)} geometries)"

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "scene"}

    @cached_property
    def scene(self) -> Scene | None:
        """The `wrt.Scene` of the triangles added so far; None if there are none."""
        from wrt.scene.scene import Scene

        return Scene(self._meshes, device=self._device) if self._meshes else None

    def add_triangles(self, *args: Any, **kwargs: Any) -> int:
        """Adds a mesh: `add_triangles(mesh)` or `add_triangles(vertex_positions, triangle_indices)`.

        Args:
            mesh: an Open3D tensor mesh, a `wrt.TriangleMesh`, or a trimesh.Trimesh.
            vertex_positions: (V, 3) real.
            triangle_indices: (F, 3) integer.

        Returns:
            The geometry id: 0 for the first mesh, then 1 ...

        Raises:
            TypeError: other arguments than these.
            ValueError: bad geometry, as for `wrt.TriangleMesh`.
        """
        given = len(args) + len(kwargs)
        if given not in (1, 2) or not set(kwargs) <= set(ARGUMENTS[given][len(args) :]):
            raise TypeError("pass add_triangles(mesh) or add_triangles(vertex_positions, triangle_indices)")
        mesh = _as_mesh(*args, **kwargs) if given == 1 else _mesh_of_arrays(*args, **kwargs)
        self._meshes.append(mesh)
        self.__dict__.pop("scene", None)
        return len(self._meshes) - 1

    @tensor_arrays
    def cast_rays(self, rays: ArrayLike, nthreads: int | None = 0) -> dict[str, np.ndarray]:
        """Closest hits.

        Args:
            rays: (..., 6) real.
            nthreads: CPU threads; 0 for the scene's number.

        Returns:
            `t_hit` (...) float32, inf for a miss; `geometry_ids` and `primitive_ids` (...) uint32, `INVALID_ID` for a miss;
            `primitive_uvs` (..., 2) float32, weights of the triangle's second and third vertex; `primitive_normals` (...,
            3) float32, unit vectors from the triangle's winding. The last two are 0 for a miss.

        Raises:
            TypeError: rays are not an array of real numbers, or nthreads is not an int.
            ValueError: wrong shape, or a negative nthreads.
        """
        origins, directions = _split(rays)
        shape = origins.shape[:-1]
        with self._threads(nthreads):
            if self.scene is None:
                return {
                    "t_hit": np.full(shape, np.inf, dtype=np.float32),
                    "geometry_ids": np.full(shape, self.INVALID_ID, dtype=np.uint32),
                    "primitive_ids": np.full(shape, self.INVALID_ID, dtype=np.uint32),
                    "primitive_uvs": np.zeros((*shape, 2), dtype=np.float32),
                    "primitive_normals": np.zeros((*shape, 3), dtype=np.float32),
                }
            hits = self.scene.intersect(origins, directions)
            return {
                "t_hit": hits.t,
                "geometry_ids": hits.geometry_id.view(np.uint32),  # -1 is INVALID_ID
                "primitive_ids": hits.primitive_id.view(np.uint32),
                "primitive_uvs": hits.uv,
                "primitive_normals": hits.normal.astype(np.float32, copy=False),
            }

    @tensor_arrays
    def test_occlusions(
        self, rays: ArrayLike, tnear: float = 0.0, tfar: float = float("inf"), nthreads: int | None = 0
    ) -> np.ndarray:
        """Whether anything is hit at tnear <= t <= tfar: (...) bool. Errors as in `cast_rays`, and for a negative or NaN
        range.
        """
        origins, directions = _split(rays)
        tnear, tfar = as_float("tnear", tnear), as_float("tfar", tfar)
        if tnear < 0.0:
            raise ValueError(f"tnear is {tnear}; rays start at 0, so pass 0 or more")
        with self._threads(nthreads):
            if self.scene is None:
                return np.zeros(origins.shape[:-1], dtype=bool)
            return self.scene.occluded(origins, directions, t_min=tnear, t_max=tfar)

    @tensor_arrays
    def count_intersections(self, rays: ArrayLike, nthreads: int | None = 0) -> np.ndarray:
        """Number of hits of each ray: (...) int32. Errors as in `cast_rays`."""
        origins, directions = _split(rays)
        with self._threads(nthreads):
            if self.scene is None:
                return np.zeros(origins.shape[:-1], dtype=np.int32)
            return self.scene.count(origins, directions)

    @tensor_arrays
    def list_intersections(self, rays: ArrayLike, nthreads: int | None = 0) -> dict[str, np.ndarray]:
        """All M hits of N rays, ray after ray, sorted by t for each ray.

        Returns:
            `ray_splits` (N + 1,) uint32, index of each ray's first hit; `ray_ids` (M,) uint32, index of the ray in the
            flattened batch; `t_hit` (M,) float32; `geometry_ids` and `primitive_ids` (M,) uint32; `primitive_uvs` (M, 2)
            float32. Errors as in `cast_rays`.
        """
        origins, directions = _split(rays)
        with self._threads(nthreads):
            if self.scene is None:
                none = np.zeros(0, dtype=np.uint32)
                ids = {name: none.copy() for name in ("ray_ids", "geometry_ids", "primitive_ids")}
                splits = np.zeros(int(np.prod(origins.shape[:-1])) + 1, dtype=np.uint32)
                none = np.zeros((0, 2), dtype=np.float32)
                return {"ray_splits": splits, **ids, "t_hit": none[:, 0], "primitive_uvs": none}
            lists = self.scene.intersect_all(origins, directions)
            return {
                "ray_splits": lists.offsets.astype(np.uint32),
                "ray_ids": lists.ray_id.view(np.uint32),
                "t_hit": lists.t,
                "geometry_ids": lists.geometry_id.view(np.uint32),
                "primitive_ids": lists.primitive_id.view(np.uint32),
                "primitive_uvs": lists.uv,
            }

    @staticmethod
    @tensor_arrays
    def create_rays_pinhole(*args: Any, **kwargs: Any) -> np.ndarray:
        """Rays through the pixel centres of a pinhole camera: (height_px, width_px, 6) float32, or float64 if a coordinate of
        the camera's position is beyond 16,384, where float32 would move it by half a millimetre, and in UTM by 0.25 m.

        Either `create_rays_pinhole(intrinsic_matrix, extrinsic_matrix, width_px, height_px)` or
        `create_rays_pinhole(fov_deg, center, eye, up, width_px, height_px)`, as in Open3D. Directions have length 1 along
        the optical axis; x grows from column to column, y from row to row. In the second form, rows grow towards `up`.

        Args:
            intrinsic_matrix: (3, 3), upper triangular, in pixels.
            extrinsic_matrix: (4, 4), rigid, from the world to the camera.
            fov_deg: horizontal field of view in degrees, in (0, 180).
            center, eye, up: (3,): the point at the image centre, the camera's position, the direction of growing rows.
            width_px, height_px: size of the image in pixels.

        Raises:
            TypeError: other arguments than these, or of another type.
            ValueError: wrong shapes, singular matrices, a zero view direction or one parallel to `up`, or an empty image.
        """
        if len(args) + len(kwargs) == 4:
            return _rays_of_matrices(*args, **kwargs)
        if len(args) + len(kwargs) == 6:
            return _rays_of_view(*args, **kwargs)
        raise TypeError(
            "pass create_rays_pinhole(intrinsic_matrix, extrinsic_matrix, width_px, height_px) or "
            "create_rays_pinhole(fov_deg, center, eye, up, width_px, height_px)"
        )

    def _threads(self, nthreads: int | None) -> Any:
        return use_threads(_as_threads(nthreads) or self._nthreads or None)


ARGUMENTS = {1: ("mesh",), 2: ("vertex_positions", "triangle_indices")}
"""Names of the arguments of `add_triangles`, by their number."""


def _as_threads(nthreads: int | None) -> int:
    return 0 if nthreads is None else as_int("nthreads", nthreads, 0, MAX_THREADS)


def _as_mesh(mesh: Any) -> TriangleMesh:
    if isinstance(mesh, TriangleMesh):
        return mesh
    if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
        if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
            raise ValueError("mesh has no vertex positions or no triangle indices: a mesh needs at least one triangle")
        return _mesh_of_arrays(mesh.vertex["positions"], mesh.triangle["indices"])
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        return _mesh_of_arrays(mesh.vertices, mesh.faces)
    raise TypeError(
        "mesh must be an open3d.t.geometry.TriangleMesh (of an older one, its from_legacy(mesh)), a wrt.TriangleMesh or a "
        f"trimesh.Trimesh, not {type(mesh).__module__}.{type(mesh).__name__}; pass arrays as "
        "add_triangles(vertex_positions, triangle_indices)"
    )


def _mesh_of_arrays(vertex_positions: Any, triangle_indices: Any) -> TriangleMesh:
    return TriangleMesh(as_numpy("vertex_positions", vertex_positions), as_numpy("triangle_indices", triangle_indices))


def _split(rays: Any) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions of rays (..., 6)."""
    rays = as_real_array("rays", as_numpy("rays", rays))
    if rays.ndim == 0 or rays.shape[-1] != 6:
        raise ValueError(f"rays must have shape (..., 6), origin and direction, not {rays.shape}")
    return rays[..., :3], rays[..., 3:]


def _rays_of_matrices(intrinsic_matrix: Any, extrinsic_matrix: Any, width_px: int, height_px: int) -> np.ndarray:
    """Rays R^-1 K^-1 (x, y, 1) from the point that the camera matrix [R t] maps to 0."""
    inverses = []
    for name, matrix, size in (("intrinsic_matrix", intrinsic_matrix, 3), ("extrinsic_matrix", extrinsic_matrix, 4)):
        matrix = as_numbers(name, as_numpy(name, matrix), finite=False)
        if matrix.shape != (size, size) or not np.isfinite(matrix).all():
            raise ValueError(f"{name} must be a finite {size} x {size} matrix, not of shape {matrix.shape}")
        try:
            inverses.append(np.linalg.inv(matrix))
        except np.linalg.LinAlgError:
            raise ValueError(f"{name} has no inverse: {matrix.tolist()}") from None
    width_px, height_px = as_int("width_px", width_px, 1), as_int("height_px", height_px, 1)
    to_camera, to_world = inverses
    x, y = np.arange(width_px) + 0.5, np.arange(height_px) + 0.5
    across, down, corner = (to_world[:3, :3] @ to_camera).T
    rays = np.empty((height_px, width_px, 6), dtype=np.float64 if np.abs(to_world[:3, 3]).max() > FAR_CAMERA else np.float32)
    rays[..., :3] = to_world[:3, 3]
    rays[..., 3:] = x[None, :, None] * across + (y[:, None, None] * down + corner)
    return rays


def _rays_of_view(fov_deg: float, center: Any, eye: Any, up: Any, width_px: int, height_px: int) -> np.ndarray:
    """The matrices of a camera at `eye` that looks at `center`, and their rays."""
    given = {"center": center, "eye": eye, "up": up}
    center, eye, up = (as_numbers(name, as_numpy(name, vector), finite=False) for name, vector in given.items())
    width_px, height_px, fov_deg = (
        as_int("width_px", width_px, 1),
        as_int("height_px", height_px, 1),
        as_float("fov_deg", fov_deg),
    )
    for name, vector in (("center", center), ("eye", eye), ("up", up)):
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise ValueError(f"{name} must be three finite numbers, not {vector.tolist()}")
    if not 0.0 < fov_deg < 180.0:
        raise ValueError(f"fov_deg must lie between 0 and 180, not {fov_deg}")
    ahead, across = center - eye, np.cross(up, center - eye)
    if not across.any():
        raise ValueError(f"center - eye is {ahead.tolist()}, and up {up.tolist()}; they must be neither zero nor parallel")
    rows = [across, np.cross(ahead, across), ahead]
    rotation = np.stack([row / np.linalg.norm(row) for row in rows])
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = rotation, -rotation @ eye
    focal = 0.5 * width_px / np.tan(0.5 * np.radians(fov_deg))
    intrinsic = [[focal, 0.0, 0.5 * width_px], [0.0, focal, 0.5 * height_px], [0.0, 0.0, 1.0]]
    return _rays_of_matrices(intrinsic, extrinsic, width_px, height_px)
